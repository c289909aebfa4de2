"""Arrays of integers that are too many for memory, in a temporary file."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["I32", "ArrayFile"]

IN_MEMORY: Final = 1 << 22
"""Bytes up to which nothing is written to the disk."""

I32 = NDArray[np.int32]


class ArrayFile:
    """A list of tuples of arrays, which are read in the order in which they were appended, as often as wanted.

    width : number of arrays of a tuple
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self._file: Any = tempfile.SpooledTemporaryFile(max_size=IN_MEMORY)  # noqa: SIM115 - closed with this object
        weakref.finalize(self, _close, self._file)

    def append(self, *arrays: NDArray[np.integer[Any]]) -> None:
        """Append a tuple of (n,) arrays, each of its own length, whose values fit in 32 bits."""
        if len(arrays) != self._width:
            raise ValueError(f"{len(arrays)} arrays instead of {self._width}")
        self._file.seek(0, 2)
        self._file.write(np.array([len(one) for one in arrays], np.int64).tobytes())
        for one in arrays:
            self._file.write(one.astype(np.int32).tobytes())

    def __iter__(self) -> Iterator[tuple[I32, ...]]:
        """Yield each tuple."""
        at = 0
        while True:
            self._file.seek(at)
            lengths = np.frombuffer(self._file.read(8 * self._width), np.int64)
            if not len(lengths):
                return
            data = np.frombuffer(self._file.read(4 * int(lengths.sum())), np.int32)
            at = self._file.tell()
            yield tuple(np.split(data, np.cumsum(lengths)[:-1]))


def _close(file: Any) -> None:
    """Close a file. What could not be written to it is lost with it."""
    with suppress(OSError):
        file.close()
