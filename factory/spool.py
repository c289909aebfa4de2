"""Lists that are too long for memory: objects pickled into a temporary file, and read back in any order."""

from __future__ import annotations

import pickle
import tempfile
from array import array
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Generic, TypeVar

__all__ = ["Spool"]

T = TypeVar("T")


class Spool(Generic[T]):
    """An append-only list on disk, with eight bytes of memory per item.

    Holds what this process wrote itself and removes it with the process, so unpickling it is safe.
    """

    def __init__(self, items: Iterable[T] = ()) -> None:
        # Small spools never touch the disk.
        self._file = tempfile.SpooledTemporaryFile(max_size=1 << 24)  # noqa: SIM115 - closed by close()
        self._starts = array("Q")
        self._end = 0
        for item in items:
            self.append(item)

    def append(self, item: T) -> int:
        """Append one item; return its position."""
        data = pickle.dumps(item, protocol=pickle.HIGHEST_PROTOCOL)
        self._file.seek(self._end)
        self._file.write(data)
        self._starts.append(self._end)
        self._end += len(data)
        return len(self._starts) - 1

    def __len__(self) -> int:
        return len(self._starts)

    def __getitem__(self, at: int) -> T:
        start = self._starts[at]
        stop = self._starts[at + 1] if at + 1 < len(self._starts) else self._end
        self._file.seek(start)
        item: T = pickle.loads(self._file.read(stop - start))
        return item

    def __iter__(self) -> Iterator[T]:
        for at in range(len(self)):
            yield self[at]

    def close(self) -> None:
        """Free the disk space."""
        self._file.close()

    def __enter__(self) -> Spool[T]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
