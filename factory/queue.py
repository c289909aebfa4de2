"""The order of work: the largest units first, so that no large unit is left to run alone at the end. Tiny units share a
task.

One worker alone takes the smallest first.
"""

from __future__ import annotations

import os
import tempfile
import weakref
from array import array
from collections.abc import Iterable, Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factory.executor import Task
from factory.sorting import SORTED_AT_ONCE, SortedNumbers
from factory.spool import Spool
from factory.temporary import close_files, temporary_space
from factory.unit import Work

__all__ = ["Queue", "WorkSpool", "tasks"]

TASK_SECONDS: Final = 2.0
"""Expected CPU seconds up to which units share a task, so that handing out a task costs below 1 %."""

POSITION: Final = (1 << 32) - 1
"""Mask of the position of a unit in a key."""

_COST_BYTES: Final = 4

TASK_UNITS: Final = 64
"""Most units of a task, so that their receipts (2 kB each at most) can be returned directly."""


class WorkSpool(Spool[Work]):
    """Units of work on disk, and beside them their expected seconds, in single precision.

    seconds : the sum of them all
    """

    def __init__(self, items: Iterable[Work] = ()) -> None:
        self.seconds = 0.0
        self._new = array("f")
        self._costs: Any = tempfile.SpooledTemporaryFile(max_size=1 << 16)  # noqa: SIM115 - closed by close()
        self._closing_costs = weakref.finalize(self, close_files, self._costs)
        super().__init__(items)

    def append(self, item: Work) -> int:
        self._new.append(item.seconds)
        self.seconds += self._new[-1]
        if len(self._new) >= SORTED_AT_ONCE:
            self._flush_costs()
        return super().append(item)

    def _flush_costs(self) -> None:
        with temporary_space():
            self._costs.seek(0, os.SEEK_END)
            self._costs.write(self._new)
        self._new = array("f")

    def costs(self) -> Iterator[npt.NDArray[np.float32]]:
        """Yield the expected seconds of the units, in the order they came in, piece by piece."""
        self._flush_costs()
        for begin in range(0, len(self), SORTED_AT_ONCE):
            with temporary_space():  # seeking writes what is buffered
                self._costs.seek(_COST_BYTES * begin)
                data = self._costs.read(_COST_BYTES * SORTED_AT_ONCE)
            yield np.frombuffer(data, np.float32)

    def close(self) -> None:
        self._closing_costs()
        super().close()


class Queue:
    """A queue of work units spooled to disk. Tasks are created from it on demand; the order is on disk too.

    seconds : expected CPU seconds of all units
    """

    def __init__(self, work: WorkSpool, until: int, workers: int) -> None:
        self._work = work
        self._until = until
        self.seconds = work.seconds
        # Towards the end all workers should stay busy, so no task takes more than a small part of one worker's share.
        self._target = min(TASK_SECONDS, self.seconds / (4 * max(workers, 1)))

    def __iter__(self) -> Iterator[Task]:
        """Yield tasks, the largest units first."""
        return self._tasks(self._order(largest_first=True))

    def smallest_first(self) -> Iterator[Task]:
        """Yield tasks for a single worker, the smallest units first, so that a unit that never ends blocks no other."""
        return self._tasks(self._order(largest_first=False))

    def _order(self, *, largest_first: bool) -> Iterator[int]:
        """Yield the positions of the units in their order. Equal costs keep the order they came in."""
        # A cost and a position are one number. The bits of floats that are not negative ascend as they do.
        keys = SortedNumbers()
        begin = 0
        for costs in self._work.costs():
            bits = np.abs(costs).view(np.uint32)
            places = np.arange(begin, begin + len(costs), dtype=np.uint64)
            keys.add((~bits if largest_first else bits).astype(np.uint64) << np.uint64(32) | places)
            begin += len(costs)
        for piece in keys:
            yield from (piece & np.uint64(POSITION)).tolist()

    def _tasks(self, order: Iterable[int]) -> Iterator[Task]:
        held: list[Work] = []
        seconds = 0.0
        for place in order:
            item = self._work[place]
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
