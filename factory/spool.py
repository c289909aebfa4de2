"""Lists that are too long for memory: objects pickled into a temporary file, and read back in any order."""

from __future__ import annotations

import os
import pickle
import struct
import tempfile
import weakref
from array import array
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Any, Final, Generic, TypeVar

from factory.temporary import close_files, temporary_space

__all__ = ["Spool"]

T = TypeVar("T")
Self = TypeVar("Self", bound="Spool[Any]")

_AT_ONCE: Final = 256
"""Number of items that are read at a time where all are wanted."""

_PLACE: Final = struct.Struct("=QQ")
"""Where an item begins and ends."""

_BUFFER: Final = 1 << 16
"""Bytes that are written at a time."""


class Spool(Generic[T]):
    """An append-only list on disk, which takes no memory per item.

    Holds what this process wrote itself and removes it with the process, so unpickling it is safe.
    """

    def __init__(self, items: Iterable[T] = ()) -> None:
        # Small spools never touch the disk.
        self._file: Any = tempfile.SpooledTemporaryFile(max_size=1 << 18)  # noqa: SIM115 - closed by close()
        # Where each item ends.
        self._ends: Any = tempfile.SpooledTemporaryFile(max_size=1 << 16)  # noqa: SIM115 - closed by close()
        # What was appended last, and is not in the files yet.
        self._data = bytearray()
        self._places = array("Q")
        self._count = 0
        self._end = 0
        self._closing = weakref.finalize(self, close_files, self._file, self._ends)
        for item in items:
            self.append(item)

    def append(self, item: T) -> int:
        """Append one item; return its position."""
        data = pickle.dumps(item, protocol=pickle.HIGHEST_PROTOCOL)
        self._end += len(data)
        self._data += data
        self._places.append(self._end)
        self._count += 1
        if len(self._data) >= _BUFFER:
            self._flush()
        return self._count - 1

    def _flush(self) -> None:
        with temporary_space():
            for file, data in ((self._file, self._data), (self._ends, self._places)):
                file.seek(0, os.SEEK_END)
                file.write(data)
        self._data = bytearray()
        self._places = array("Q")

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, at: int) -> T:
        if not 0 <= at < self._count:
            raise IndexError(at)
        if self._data:
            self._flush()
        with temporary_space():  # seeking writes what is buffered
            self._ends.seek(8 * (at - 1) if at else 0)
            start, end = _PLACE.unpack(self._ends.read(16) if at else bytes(8) + self._ends.read(8))
            self._file.seek(start)
            item: T = pickle.loads(self._file.read(end - start))
        return item

    def __iter__(self) -> Iterator[T]:
        for at in range(0, self._count, _AT_ONCE):
            yield from self._read(at, min(at + _AT_ONCE, self._count))

    def _read(self, first: int, stop: int) -> Iterator[T]:
        if self._data:
            self._flush()
        before = min(first, 1)
        with temporary_space():  # seeking writes what is buffered
            self._ends.seek(8 * (first - before))
            ends = array("Q", self._ends.read(8 * (stop - first + before)))
            start = ends.pop(0) if before else 0
            self._file.seek(start)
            data = memoryview(self._file.read(ends[-1] - start))
        at = 0
        for end in ends:
            yield pickle.loads(data[at : end - start])
            at = end - start

    def close(self) -> None:
        """Free the disk space."""
        self._closing()

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
