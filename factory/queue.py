"""The order of work: the largest units first, so that no large unit is left to run alone at the end. Tiny units share a
task.

One worker alone takes the smallest first.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from factory.executor import Task
from factory.spool import Spool
from factory.unit import Work

__all__ = ["Queue", "tasks"]

TASK_SECONDS: Final = 2.0
"""Expected CPU seconds up to which units share a task, so that handing out a task costs below 1 %."""

TASK_UNITS: Final = 64
"""Most units of a task, so that their receipts (2 kB each at most) can be returned directly."""


class Queue:
    """A queue of work units spooled to disk. Tasks are created from it on demand; only each unit's cost and file offset
    stay in memory.
    """

    def __init__(self, work: Spool[Work], until: int, workers: int) -> None:
        self._work = work
        self._until = until
        costs = array("d", (item.seconds for item in work))
        self._costs: Any = np.frombuffer(costs, dtype=np.float64) if len(costs) else np.zeros(0)
        self.seconds = float(self._costs.sum())
        # Towards the end all workers should stay busy, so no task takes more than a small part of one worker's share.
        self._target = min(TASK_SECONDS, self.seconds / (4 * max(workers, 1)))

    def __iter__(self) -> Iterator[Task]:
        """Yield tasks, the largest units first."""
        return self._tasks(-self._costs)

    def smallest_first(self) -> Iterator[Task]:
        """Yield tasks for a single worker, the smallest units first, so that a unit that never ends blocks no other."""
        return self._tasks(self._costs)

    def _tasks(self, ranks: Any) -> Iterator[Task]:
        held: list[Work] = []
        seconds = 0.0
        # Equal costs keep the order they came in.
        for at in np.argsort(ranks, kind="stable").tolist():
            item = self._work[at]
            held.append(item)
            seconds += item.seconds
            if seconds >= self._target or len(held) >= TASK_UNITS:
                yield self._task(held)
                held, seconds = [], 0.0
        if held:
            yield self._task(held)

    def _task(self, held: list[Work]) -> Task:
        return Task(tuple(held), self._until, memory=max(item.memory for item in held))


def tasks(work: Spool[Work], until: int, workers: int) -> Queue:
    """Return a queue that yields the tasks of ``work``, the largest units first."""
    return Queue(work, until, workers)
