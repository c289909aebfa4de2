"""Flags of many rows, eight in a byte: what is known of each of a million units takes an eighth of a megabyte."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, overload

import numpy as np
import numpy.typing as npt

__all__ = ["Flags"]

_AT_ONCE: Final = 1 << 16
"""Number of flags that are looked at together."""


class Flags:
    """(n,) booleans, all of them `value` at first. They are read and written by row, by rows, and read by slice."""

    def __init__(self, count: int, value: bool = False) -> None:
        self._count = count
        self._bytes = bytearray((b"\xff" if value else b"\0") * ((count + 7) // 8))
        self._view = np.frombuffer(self._bytes, np.uint8)
        if value and count % 8:
            self._bytes[-1] >>= 8 - count % 8

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, at: int) -> bool: ...

    @overload
    def __getitem__(self, at: slice | npt.NDArray[Any]) -> npt.NDArray[np.bool_]: ...

    def __getitem__(self, at: int | slice | npt.NDArray[Any]) -> bool | npt.NDArray[np.bool_]:
        if isinstance(at, slice):
            start, stop, step = at.indices(self._count)
            bits = np.unpackbits(self._view[start // 8 : (stop + 7) // 8], bitorder="little")
            return bits[start % 8 : start % 8 + max(stop - start, 0) : step].view(np.bool_)
        if isinstance(at, np.ndarray):
            found: npt.NDArray[np.uint8] = self._view[at >> 3] >> (at & 7).astype(np.uint8) & np.uint8(1)
            return found.view(np.bool_)
        return bool(self._bytes[at >> 3] >> (at & 7) & 1)

    def __setitem__(self, at: int | npt.NDArray[Any], value: bool) -> None:
        if not isinstance(at, np.ndarray):
            bit = 1 << (at & 7)
            self._bytes[at >> 3] = self._bytes[at >> 3] | bit if value else self._bytes[at >> 3] & ~bit
            return
        bits = np.left_shift(np.uint8(1), (at & 7).astype(np.uint8))
        if value:
            np.bitwise_or.at(self._view, at >> 3, bits)
        else:
            np.bitwise_and.at(self._view, at >> 3, ~bits)

    def count(self) -> int:
        """Return how many are true."""
        return int(np.bitwise_count(self._view).sum())

    def without(self, others: Flags) -> None:
        """Make those false that are true in `others`, which has as many."""
        self._view &= ~others._view

    def both(self, others: Flags) -> Iterator[int]:
        """Yield the rows that are true here and in `others`, which has as many."""
        for start in range(0, self._count, _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            yield from (start + np.flatnonzero(self[part] & others[part])).tolist()
