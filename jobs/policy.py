"""Users' own agents in ``condvln walk``: functions that load an agent by name, run the agent, and tell the agent which
objects are visible.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import cast

from condvln.evaluation.predictions import Prediction
from condvln.evaluation.task import Task
from condvln.evaluation.walker import Eyes, Policy, SeenObject, labels_in_view, walk
from condvln.export.rows import rows_of
from condvln.navigation.pathfinder import Pathfinder
from jobs.workspace import published
from schemas.config import Config
from schemas.errors import UsageError

__all__ = ["eyes_of", "is_policy", "policy_named", "walk_policy"]

_COLUMNS = ["scene_id", "label", "center"]


def is_policy(agent: str) -> bool:
    """Whether `agent` is the name of a user's agent (``module:Class``), and not of a reference agent."""
    return ":" in agent


def policy_named(name: str) -> Policy:
    """Create the agent ``module:Class``; modules in the current folder are found too.

    Raises
    ------
    UsageError : there is no such module or class, or it makes something that neither begins nor acts
    """
    module, _, factory = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        found = getattr(importlib.import_module(module), factory)
    except (ImportError, AttributeError, ValueError) as error:
        raise UsageError(
            f"no agent {name!r} ({error})", remedy="Give module:Class; Python must find the module from this folder."
        ) from error
    policy = found() if callable(found) else found
    lacking = [method for method in ("begin", "act") if not callable(getattr(policy, method, None))]
    if lacking:
        raise UsageError(
            f"{name} has no {lacking[0]}()", remedy="An agent needs begin(observation) and act(observation)."
        )
    return cast(Policy, policy)


def eyes_of(config: Config, pathfinder_of: Callable[[Task], Pathfinder]) -> Eyes:
    """Return the function that tells an agent which objects of the published snapshot are in view.

    Raises
    ------
    StoreError : nothing is published
    """
    table = published(config).table("objects", [*_COLUMNS])
    seen: dict[str, list[SeenObject]] = {}
    for row, source in zip(rows_of(table.select(_COLUMNS)), table.column("source").to_pylist(), strict=True):
        x, y, z = row["center"]
        seen.setdefault(f"{source}/{row['scene_id']}", []).append(SeenObject(row["label"], (x, y, z)))
    objects: Mapping[str, Sequence[SeenObject]] = seen
    return labels_in_view(objects, pathfinder_of)


def walk_policy(
    policy: Policy, tasks: Sequence[Task], pathfinder_of: Callable[[Task], Pathfinder], eyes: Eyes | None = None
) -> Iterator[Prediction]:
    """Yield the predictions of a user's agent, one episode at a time."""
    for task in tasks:
        yield walk(task, policy, pathfinder_of(task), eyes=eyes)
