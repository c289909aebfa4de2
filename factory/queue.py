"""The order of work: the largest units first, so that no large unit is left to run alone at the end. Tiny units share a
task.

One worker alone takes the smallest first.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from factory.executor import Task
from factory.spool import Spool
from factory.unit import Work

__all__ = ["Queue", "WorkSpool", "tasks"]

TASK_SECONDS: Final = 2.0
"""Expected CPU seconds up to which units share a task, so that handing out a task costs below 1 %."""

SORTED_AT_ONCE: Final = 1 << 16
"""Number of costs whose keys are made at a time."""

POSITION: Final = (1 << 32) - 1
"""Mask of the position of a unit in a key."""

TASK_UNITS: Final = 64
"""Most units of a task, so that their receipts (2 kB each at most) can be returned directly."""


class WorkSpool(Spool[Work]):
    """Units of work on disk, of which only the expected seconds stay in memory, in single precision."""

    def __init__(self, items: Iterable[Work] = ()) -> None:
        self.seconds = array("f")
        super().__init__(items)

    def append(self, item: Work) -> int:
        self.seconds.append(item.seconds)
        return super().append(item)

    def close(self) -> None:
        self.seconds = array("f")
        super().close()


class Queue:
    """A queue of work units spooled to disk. Tasks are created from it on demand; only each unit's cost and its place
    in the order stay in memory, twelve bytes a unit.
    """

    def __init__(self, work: WorkSpool, until: int, workers: int) -> None:
        self._work = work
        self._until = until
        self._costs = np.frombuffer(work.seconds, np.float32)
        self.seconds = float(self._costs.sum(dtype=np.float64))
        # Towards the end all workers should stay busy, so no task takes more than a small part of one worker's share.
        self._target = min(TASK_SECONDS, self.seconds / (4 * max(workers, 1)))

    def __iter__(self) -> Iterator[Task]:
        """Yield tasks, the largest units first."""
        return self._tasks(self._order(largest_first=True))

    def smallest_first(self) -> Iterator[Task]:
        """Yield tasks for a single worker, the smallest units first, so that a unit that never ends blocks no other."""
        return self._tasks(self._order(largest_first=False))

    def _order(self, *, largest_first: bool) -> npt.NDArray[np.uint64]:
        """Return the positions of the units in their order, in the low half of each number. Equal costs keep the order
        they came in.
        """
        # A cost and a position are one number, which is sorted in place: a sort of positions by costs takes twice the
        # memory. The bits of floats that are not negative ascend as they do.
        keys = np.arange(len(self._costs), dtype=np.uint64)
        for begin in range(0, len(keys), SORTED_AT_ONCE):
            part = slice(begin, begin + SORTED_AT_ONCE)
            bits = np.abs(self._costs[part]).view(np.uint32)
            keys[part] |= (~bits if largest_first else bits).astype(np.uint64) << np.uint64(32)
        keys.sort()
        return keys

    def _tasks(self, order: npt.NDArray[np.uint64]) -> Iterator[Task]:
        held: list[Work] = []
        seconds = 0.0
        for key in order:
            item = self._work[int(key) & POSITION]
            held.append(item)
            seconds += item.seconds
            if seconds >= self._target or len(held) >= TASK_UNITS:
                yield self._task(held)
                held, seconds = [], 0.0
        if held:
            yield self._task(held)

    def _task(self, held: list[Work]) -> Task:
        return Task(tuple(held), self._until, memory=max(item.memory for item in held))


def tasks(work: WorkSpool, until: int, workers: int) -> Queue:
    """Return a queue that yields the tasks of ``work``, the largest units first."""
    return Queue(work, until, workers)
