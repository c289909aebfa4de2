"""Fault injection for tests: at a named point the process dies or an error is raised.

Points are named where the store's state changes (``POINTS``). A plan is text, ``point[@n][=action]`` separated by
commas: at the n-th time (default first) that the point is reached in a process, do the action: ``kill`` (SIGKILL to
itself, the default), ``transient`` (``TransientIOError``), ``full`` (no space left), ``error``, or ``memory``. It is
given to a run as a parameter, or by the environment variable ``FACTORY_FAULTS`` to a whole process.
"""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass, field
from typing import Final

from schemas.errors import StoreError, TransientIOError, UsageError

__all__ = ["POINTS", "FaultPlan"]

POINTS: Final = (
    "unit-before-run",
    "unit-before-data",
    "unit-between-data",
    "unit-before-commit",
    "unit-after-commit",
    "quarantine-before-record",
    "pin-before-table",
    "pin-before-pin",
    "pin-after-pin",
    "snapshot-before-parts",
    "snapshot-between-parts",
    "snapshot-before-manifest",
    "snapshot-before-index",
    "snapshot-before-ref",
    "snapshot-after-ref",
)

ENVIRONMENT: Final = "FACTORY_FAULTS"


@dataclass
class FaultPlan:
    """The faults to inject, by point; an empty plan injects none."""

    actions: dict[str, tuple[int, str]] = field(default_factory=dict)
    reached: dict[str, int] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> FaultPlan:
        """Read ``point[@n][=action],…``; raises ``UsageError`` on a point that does not exist."""
        actions = {}
        for item in filter(None, (part.strip() for part in text.split(","))):
            place, _, action = item.partition("=")
            point, _, count = place.partition("@")
            if point not in POINTS:
                raise UsageError(f"no fault point is called {point!r}", remedy=f"Choose one of: {', '.join(POINTS)}.")
            actions[point] = (int(count or 1), action or "kill")
        return cls(actions)

    @classmethod
    def from_environment(cls) -> FaultPlan:
        """Read the plan in the environment variable ``FACTORY_FAULTS``; an empty plan if the variable is not set."""
        return cls.parse(os.environ.get(ENVIRONMENT, ""))

    def reach(self, point: str) -> None:
        """Inject the fault that is planned at ``point``, if any."""
        if point not in self.actions:
            return
        count = self.reached[point] = self.reached.get(point, 0) + 1
        at, action = self.actions[point]
        if count != at:
            return
        if action == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        elif action == "transient":
            raise TransientIOError(f"injected at {point}")
        elif action == "full":
            raise StoreError(f"no space left (injected at {point})")
        elif action == "memory":
            raise MemoryError(f"injected at {point}")
        else:
            raise RuntimeError(f"injected at {point}")
