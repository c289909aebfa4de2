"""Messages about units that take long, so that a slow run does not look like one that hangs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Final

__all__ = ["BUSY_SECONDS", "Busy", "Heartbeat", "Place", "busy_message"]

BUSY_SECONDS: Final = 30.0
"""Seconds at one stage of one unit before the first message; the next comes after twice as many, and so on."""

LONGEST_SILENCE: Final = 600.0
"""Longest time in seconds between two messages about a unit that is still at the same stage."""

_PAUSE: Final = 1.0
"""Seconds between two checks."""


@dataclass(frozen=True, slots=True)
class Busy:
    """A unit under way, the stage that the unit is at, and the seconds since this stage began.

    endable : its process may be ended when it is late (a worker, not the driver)
    """

    unit_id: str
    stage: str
    seconds: float
    endable: bool = False


def busy_message(busy: Busy, deadline: float | None = None) -> str:
    """Format one line about a unit that takes long. If the unit runs in this process and is past its deadline, the line
    adds that the unit is in compiled code, which no signal interrupts.
    """
    line = f"{busy.unit_id}: at stage {busy.stage} for {busy.seconds:.0f} s"
    if deadline is not None and busy.seconds > deadline and not busy.endable:
        line += (
            f"; its deadline of {deadline:g} s is over, but it is in compiled code, which can't be interrupted in this "
            "process (with ray.workers: 1 it would be ended)"
        )
    return line


class Heartbeat:
    """A thread that checks which units are under way and calls `say` for those that take long; a context manager.

    look : the units under way
    say : called from the thread
    """

    def __init__(
        self,
        look: Callable[[], Iterable[Busy]],
        say: Callable[[Busy], None],
        *,
        after: float = BUSY_SECONDS,
        pause: float = _PAUSE,
    ) -> None:
        self._look = look
        self._say = say
        self._after = after
        self._pause = pause
        self._due: dict[tuple[str, str], float] = {}
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)

    def _run(self) -> None:
        while not self._end.wait(self._pause):
            self.beat()

    def beat(self) -> None:
        """Check once."""
        due = {}
        for busy in self._look():
            name = (busy.unit_id, busy.stage)
            next_one = self._due.get(name, self._after)
            if busy.seconds >= next_one:
                self._say(busy)
                next_one = busy.seconds + min(busy.seconds, LONGEST_SILENCE)
            due[name] = next_one
        self._due = due

    def __enter__(self) -> Heartbeat:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join(timeout=5.0)


class Place:
    """The unit and stage that a worker is at, written by the working thread and read by other threads."""

    __slots__ = ("_at",)

    def __init__(self) -> None:
        self._at: tuple[str, str, float] | None = None

    def enter(self, unit_id: str, stage: str) -> None:
        """Record that a stage of a unit begins."""
        self._at = (unit_id, stage, time.monotonic())

    def leave(self) -> None:
        """Record that the stage has ended."""
        self._at = None

    def busy(self) -> Busy | None:
        """Return the unit and stage under way, if any."""
        at = self._at
        return None if at is None else Busy(at[0], at[1], time.monotonic() - at[2])
