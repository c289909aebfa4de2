"""Numbers that are too many for memory, in order: sorted runs in a temporary file, merged as they are read."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factory.temporary import close_files, temporary_space

__all__ = ["SORTED_AT_ONCE", "SortedNumbers"]

SORTED_AT_ONCE: Final = 1 << 15
"""Numbers of a run, and the most that are in memory while runs are merged."""

_BYTES: Final = 8

Numbers = npt.NDArray[np.uint64]


class SortedNumbers:
    """Gives back in ascending order what was added. Up to ``SORTED_AT_ONCE`` numbers never touch the disk."""

    def __init__(self) -> None:
        self._held: list[Numbers] = []
        self._count = 0
        self._ends: list[int] = []
        """Where each run in the file ends, in numbers."""
        self._file: Any = tempfile.SpooledTemporaryFile(max_size=1 << 16)  # noqa: SIM115 - closed with this object
        weakref.finalize(self, close_files, self._file)

    def add(self, numbers: Numbers) -> None:
        """Add (n,) uint64."""
        if len(numbers):
            self._held.append(numbers)
            self._count += len(numbers)
        if self._count > SORTED_AT_ONCE:
            self._end_run()

    def _end_run(self) -> None:
        run = np.concatenate(self._held)
        run.sort()
        with temporary_space():
            self._file.write(run.tobytes())
        self._ends.append((self._ends[-1] if self._ends else 0) + len(run))
        self._held.clear()
        self._count = 0

    def __iter__(self) -> Iterator[Numbers]:
        """Yield all numbers, piece by piece; nothing can be added after that."""
        if not self._ends:
            if self._held:
                yield np.sort(np.concatenate(self._held))
            return
        if self._held:
            self._end_run()
        yield from self._merged()

    def _merged(self) -> Iterator[Numbers]:
        # Of each run a window is looked at; what is not above the end of any window is next.
        most = max(SORTED_AT_ONCE // len(self._ends), 1)
        runs = [_Run(self._file, begin, end, most) for begin, end in pairwise([0, *self._ends])]
        firsts = np.array([run.window[0] for run in runs])
        lasts = np.array([run.window[-1] for run in runs])
        while runs:
            bound = lasts.min()
            due = np.flatnonzero(firsts <= bound).tolist()
            yield np.sort(np.concatenate([runs[at].take(bound) for at in due]))
            for at in reversed(due):
                if len(runs[at].window):
                    firsts[at], lasts[at] = runs[at].window[0], runs[at].window[-1]
                else:
                    del runs[at]
                    firsts, lasts = np.delete(firsts, at), np.delete(lasts, at)


class _Run:
    """A sorted run that is being merged, of which up to ``most`` numbers are in memory."""

    def __init__(self, file: Any, begin: int, end: int, most: int) -> None:
        self._file = file
        self._at = begin
        self._end = end
        self._most = most
        self.window: Numbers = np.empty(0, np.uint64)
        self._fill()

    def _fill(self) -> None:
        count = min(self._most - len(self.window), self._end - self._at)
        if count > 0:
            with temporary_space():  # seeking writes what is buffered
                self._file.seek(_BYTES * self._at)
                more = np.frombuffer(self._file.read(_BYTES * count), np.uint64)
            self._at += count
            self.window = np.concatenate((self.window, more))

    def take(self, bound: np.uint64) -> Numbers:
        """Remove and return the numbers of the window that are not above ``bound``."""
        cut = int(np.searchsorted(self.window, bound, "right"))
        taken, self.window = self.window[:cut], self.window[cut:]
        self._fill()
        return taken
