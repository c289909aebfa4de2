"""Lists that are too long for memory: objects pickled into a temporary file, and read back in any order."""

from __future__ import annotations

import pickle
import struct
import tempfile
import weakref
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Any, Final, Generic, TypeVar

__all__ = ["Spool"]

T = TypeVar("T")
Self = TypeVar("Self", bound="Spool[Any]")

_AT_ONCE: Final = 256
"""Number of items that are read at a time where all are wanted."""

_PLACE: Final = struct.Struct("<Q")


class Spool(Generic[T]):
    """An append-only list on disk, which takes no memory per item.

    Holds what this process wrote itself and removes it with the process, so unpickling it is safe.
    """

    def __init__(self, items: Iterable[T] = ()) -> None:
        # Small spools never touch the disk.
        self._file: Any = tempfile.SpooledTemporaryFile(max_size=1 << 20)  # noqa: SIM115 - closed by close()
        # Where each item ends.
        self._ends: Any = tempfile.SpooledTemporaryFile(max_size=1 << 16)  # noqa: SIM115 - closed by close()
        self._count = 0
        self._end = 0
        self._writing = True
        self._closing = weakref.finalize(self, _close, self._file, self._ends)
        for item in items:
            self.append(item)

    def append(self, item: T) -> int:
        """Append one item; return its position."""
        data = pickle.dumps(item, protocol=pickle.HIGHEST_PROTOCOL)
        if not self._writing:
            self._file.seek(self._end)
            self._ends.seek(_PLACE.size * self._count)
            self._writing = True
        self._end += len(data)
        self._file.write(data)
        self._ends.write(_PLACE.pack(self._end))
        self._count += 1
        return self._count - 1

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, at: int) -> T:
        if not 0 <= at < self._count:
            raise IndexError(at)
        return next(self._read(at, at + 1))

    def __iter__(self) -> Iterator[T]:
        for at in range(0, self._count, _AT_ONCE):
            yield from self._read(at, min(at + _AT_ONCE, self._count))

    def _read(self, first: int, stop: int) -> Iterator[T]:
        self._writing = False
        before = min(first, 1)
        self._ends.seek(_PLACE.size * (first - before))
        ends = [end for (end,) in _PLACE.iter_unpack(self._ends.read(_PLACE.size * (stop - first + before)))]
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


def _close(*files: Any) -> None:
    for file in files:
        file.close()
