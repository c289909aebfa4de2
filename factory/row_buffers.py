"""The bytes that the hash of rows covers, read from the buffers of a record batch that Arrow encoded and decoded again.

Encoding cuts every array to its own rows, so that offsets begin at 0 and buffers are found one after the other. Python
sees one list of buffers a column, not an object for each nested array, so that hashing takes half the time. What is fed
is what ``factory.rows`` feeds array by array; columns that this module can't read are left to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

__all__ = ["Layout", "UnreadableBuffersError", "layout_of", "row_bytes"]

NOTHING: Final = (0).to_bytes(8, "little")
"""What is fed for empty data, and for the nulls of an array without any."""

_NUMBERS: Final = {
    pa.lib.Type_INT8: "<i1",
    pa.lib.Type_INT16: "<i2",
    pa.lib.Type_INT32: "<i4",
    pa.lib.Type_INT64: "<i8",
    pa.lib.Type_UINT8: "<u1",
    pa.lib.Type_UINT16: "<u2",
    pa.lib.Type_UINT32: "<u4",
    pa.lib.Type_UINT64: "<u8",
    pa.lib.Type_FLOAT: "<f4",
    pa.lib.Type_DOUBLE: "<f8",
}
_TEXTS: Final = {
    pa.lib.Type_STRING: "<i4",
    pa.lib.Type_BINARY: "<i4",
    pa.lib.Type_LARGE_STRING: "<i8",
    pa.lib.Type_LARGE_BINARY: "<i8",
}
_LISTS: Final = {pa.lib.Type_LIST: "<i4", pa.lib.Type_LARGE_LIST: "<i8"}

Flags = npt.NDArray[np.bool_]


class UnreadableBuffersError(Exception):
    """Rows that can't be read from their buffers, such as nulls with values behind them."""


@dataclass(frozen=True, slots=True)
class Layout:
    """How the buffers of a column are read.

    kind : struct, list, number, text or bool
    dtype : of the numbers, or of the offsets
    children : the layouts of the fields of a struct, or of the elements of a list
    """

    kind: str
    dtype: np.dtype[Any]
    children: tuple[Layout, ...] = ()


def layout_of(kind: pa.DataType) -> Layout | None:
    """Return how columns of a type are read; None if this module can't."""
    if kind.id in _NUMBERS:
        return Layout("number", np.dtype(_NUMBERS[kind.id]))
    if kind.id in _TEXTS:
        return Layout("text", np.dtype(_TEXTS[kind.id]))
    if kind.id == pa.lib.Type_BOOL:
        return Layout("bool", np.dtype(bool))
    nested = [kind.value_type] if kind.id in _LISTS else [*kind.fields] if kind.id == pa.lib.Type_STRUCT else []
    children = [layout_of(child if kind.id in _LISTS else child.type) for child in nested]
    if not nested or None in children:
        return None
    name = "list" if kind.id in _LISTS else "struct"
    return Layout(name, np.dtype(_LISTS.get(kind.id, bool)), tuple(child for child in children if child is not None))


def row_bytes(batch: pa.RecordBatch, layouts: tuple[Layout, ...], headers: tuple[bytes, ...]) -> tuple[list[Any], int]:
    """Return (the pieces of bytes that the hash of a batch covers, the size of its values in bytes).

    headers : what is fed before each column

    Raises ``UnreadableBuffersError`` where the buffers are not enough.
    """
    # Without its schema, which would take most of the time.
    plain = pa.ipc.read_record_batch(batch.serialize(), batch.schema)
    feed = _Feed()
    for column, layout, header in zip(plain.columns, layouts, headers, strict=True):
        feed.data(header)
        feed.array(layout, iter(column.buffers()), len(column), None)
    return feed.pieces, feed.size


class _Feed:
    """Collects pieces of bytes. Data is preceded by its length."""

    def __init__(self) -> None:
        self.pieces: list[Any] = []
        self.size = 0

    def data(self, data: Any) -> None:
        size = len(data) if isinstance(data, bytes) else data.nbytes
        if size:
            self.pieces += (size.to_bytes(8, "little"), data)
            self.size += size
        else:
            self.pieces.append(NOTHING)

    def array(self, layout: Layout, buffers: Iterator[Any], n: int, valid: Flags | None) -> None:
        """Add an array of n values.

        valid : (n,) which of the structs that hold them are not null; None for all
        """
        own = next(buffers)
        if own is not None and n:
            flags = np.unpackbits(np.frombuffer(own, np.uint8), count=n, bitorder="little").view(bool)
            valid = flags if valid is None else flags & valid
        if valid is not None and valid.all():
            valid = None
        self.pieces.append(n.to_bytes(8, "little"))
        self.data(b"" if valid is None else np.packbits(valid))
        if layout.kind == "struct":
            for child in layout.children:
                self.array(child, buffers, n, valid)
        elif layout.kind == "list":
            self.array(layout.children[0], buffers, self._lengths(layout, next(buffers), n, valid), None)
        elif layout.kind == "text":
            size = self._lengths(layout, next(buffers), n, valid)
            data = next(buffers)
            self.data(memoryview(data)[:size] if size else b"")
        elif layout.kind == "bool":
            self._bits(next(buffers), n, valid)
        else:
            self._numbers(layout, next(buffers), n, valid)

    def _lengths(self, layout: Layout, offsets: Any, n: int, valid: Flags | None) -> int:
        """Add the lengths of lists or texts; return their sum."""
        if not n:
            self.data(b"")
            return 0
        ends = np.frombuffer(offsets, layout.dtype, count=n + 1)
        lengths = np.subtract(ends[1:], ends[:-1], dtype=np.int64).astype("<i8", copy=False)  # np.diff takes long
        if ends[0] or (valid is not None and lengths[~valid].any()):
            raise UnreadableBuffersError
        self.data(lengths)
        return int(ends[-1])

    def _bits(self, buffer: Any, n: int, valid: Flags | None) -> None:
        if not n:
            self.data(b"")
            return
        values = np.unpackbits(np.frombuffer(buffer, np.uint8), count=n, bitorder="little")
        self.data(np.packbits(values if valid is None else values & valid))

    def _numbers(self, layout: Layout, buffer: Any, n: int, valid: Flags | None) -> None:
        if buffer is None or not n:
            self.data(b"")
            return
        values = np.frombuffer(buffer, layout.dtype, count=n)
        if layout.dtype.kind == "f":
            missing = np.isnan(values)
            if missing.any():
                values = values.copy()
                values[missing] = np.nan
        self.data(values if valid is None else np.where(valid, values, layout.dtype.type(0)))
