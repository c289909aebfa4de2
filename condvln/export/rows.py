"""Convert Arrow batches to plain rows, with points as ``[x, y, z]`` lists.

``RecordBatch.to_pylist`` makes a dictionary of every point, and episodes have a hundred points each. Here a whole
column of points is first converted to one (n, 3) array. Texts and structs of texts, such as rooms, are mostly the same
few: each is made once for a column, so that rows share them.

Most lists of points are only written again. With `encoded`, each is a :class:`Points`, which has the JSON of the list:
it is cut from the JSON of the whole column, so that no float and no list is ever made of the points.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, repeat
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import orjson
import pyarrow as pa

from condvln.collector import no_collection

__all__ = ["Points", "Row", "rows_of"]

Row = dict[str, Any]

F64 = npt.NDArray[np.float64]

_MOST_COMBINED: Final = 1 << 62
_POINT_FIELDS = (["x", "y", "z"], ["x", "y", "z", "w"])
_CLOSING: Final = ord("]")


class Points:
    """A list of points that is to be written: its JSON, and the points as a part of a column.

    fragment : the JSON, in the form in which orjson copies it into that of a document
    """

    __slots__ = ("_begin", "_column", "_end", "fragment", "json")

    def __init__(self, json: bytes, column: F64, begin: int, end: int) -> None:
        """The points are ``column[begin:end]``, each a row."""
        self.json, self.fragment = json, orjson.Fragment(json)
        self._column, self._begin, self._end = column, begin, end

    def __len__(self) -> int:
        return self._end - self._begin

    def __getitem__(self, index: int) -> list[float]:
        point: list[float] = self.array[index].tolist()
        return point

    def __iter__(self) -> Iterator[list[float]]:
        return iter(self.array.tolist())

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.array(self.array, dtype=dtype, copy=copy)

    @property
    def array(self) -> F64:
        """The points as rows of an array, which must not be changed."""
        return self._column[self._begin : self._end]


def rows_of(batch: pa.RecordBatch | pa.Table, *, encoded: bool = False) -> list[Row]:
    """Return the rows of ``batch``; structs of x, y, z (w) become lists, other structs dictionaries, nulls None.

    Equal structs of texts may be one dictionary, which must not be changed.

    encoded : whether lists of points become :class:`Points`
    """
    if isinstance(batch, pa.Table):
        return [row for part in batch.to_batches() for row in rows_of(part, encoded=encoded)]
    # Garbage collection during the conversion would cost more than the conversion.
    with no_collection():
        columns = [_values(batch.column(index), encoded) for index in range(batch.num_columns)]
        return _records(batch.schema.names, columns)


def _records(names: list[str], columns: list[list[Any]]) -> list[Row]:
    # Written out, a dictionary takes half of the time; structs in lists have up to seven fields.
    match names:
        case [a]:
            return [{a: one} for one in columns[0]]
        case [a, b]:
            return [{a: one, b: two} for one, two in zip(*columns, strict=True)]
        case [a, b, c]:
            return [{a: one, b: two, c: three} for one, two, three in zip(*columns, strict=True)]
        case [a, b, c, d]:
            return [{a: one, b: two, c: three, d: four} for one, two, three, four in zip(*columns, strict=True)]
        case [a, b, c, d, e, f]:
            return [{a: u, b: v, c: w, d: x, e: y, f: z} for u, v, w, x, y, z in zip(*columns, strict=True)]
        case [a, b, c, d, e, f, g]:
            return [{a: t, b: u, c: v, d: w, e: x, f: y, g: z} for t, u, v, w, x, y, z in zip(*columns, strict=True)]
    return [*map(dict, map(zip, repeat(names), zip(*columns, strict=True)))]


def _values(array: pa.Array, encoded: bool) -> list[Any]:
    kind = array.type
    if len(array) == 0:
        return []
    if pa.types.is_struct(kind):
        return _with_nulls(array, _structs(array, encoded))
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        offsets = array.offsets.to_numpy()
        # A slice shares the values of the whole array; only the slice's own are decoded.
        inner = array.values.slice(offsets[0], offsets[-1] - offsets[0])
        bounds = (offsets - offsets[0]).tolist()
        if encoded and pa.types.is_struct(inner.type) and inner.null_count == 0 and _are_points(inner):
            return _with_nulls(array, _points(_stacked(inner), bounds))
        values = _values(inner, encoded)
        return _with_nulls(array, [values[a:b] for a, b in pairwise(bounds)])
    if array.null_count == 0 and (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        plain: list[Any] = array.to_numpy(zero_copy_only=False).tolist()
        return plain
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        number, texts = _numbered(array)
        return [*map(texts.__getitem__, number.tolist())]
    listed: list[Any] = array.to_pylist()
    return listed


def _numbered(array: pa.Array) -> tuple[npt.NDArray[np.int64], list[Any]]:
    """Return the number of each text in a column, and the different texts with None at the end."""
    encoded = array.dictionary_encode()
    texts = encoded.dictionary.to_pylist()
    number = encoded.indices.fill_null(len(texts)) if array.null_count else encoded.indices
    return number.to_numpy(zero_copy_only=False).astype(np.int64), [*texts, None]


def _names(array: pa.StructArray) -> list[str]:
    return [array.type.field(i).name for i in range(array.type.num_fields)]


def _are_points(array: pa.StructArray) -> bool:
    """Return whether the structs of a column are points of three floats, as all tables have them."""
    return _names(array) == _POINT_FIELDS[0] and all(array.type.field(i).type == pa.float64() for i in range(3))


def _stacked(array: pa.StructArray) -> npt.NDArray[Any]:
    """Return points or rotations as rows of an array."""
    return np.stack([field.to_numpy(zero_copy_only=False) for field in array.flatten()], axis=1)


def _points(column: F64, bounds: list[int]) -> list[Points]:
    """Return the lists of points ``column[bounds[i]:bounds[i + 1]]``."""
    text = orjson.dumps(column, option=orjson.OPT_SERIALIZE_NUMPY)
    # Where each point begins: after the bracket that opens the whole, then behind the comma after each point. The last
    # one is where a further point would begin.
    begins = np.append(1, np.flatnonzero(np.frombuffer(text, dtype=np.uint8) == _CLOSING)[: len(column)] + 2)
    cuts = begins[bounds].tolist()
    told = [b"[" + text[a : b - 1] + b"]" for a, b in pairwise(cuts)]
    return [*map(Points, told, repeat(column), bounds, bounds[1:])]


def _structs(array: pa.StructArray, encoded: bool) -> list[Any]:
    names = _names(array)
    if names in _POINT_FIELDS:
        points: list[Any] = _stacked(array).tolist()
        return points
    fields = array.flatten()
    if fields and all(pa.types.is_string(field.type) for field in fields):
        number, most = np.zeros(len(array), dtype=np.int64), 1
        for field in fields:
            own, texts = _numbered(field)
            if most * len(texts) > _MOST_COMBINED:
                number, most = np.unique(number, return_inverse=True)[1], len(array)
            number, most = number * len(texts) + own, most * len(texts)
        _, firsts, number = np.unique(number, return_index=True, return_inverse=True)
        records = _records(names, [field.take(pa.array(firsts)).to_pylist() for field in fields])
        return [*map(records.__getitem__, number.tolist())]
    return _records(names, [_values(field, encoded) for field in fields])


def _with_nulls(array: pa.Array, values: list[Any]) -> list[Any]:
    if array.null_count == 0:
        return values
    valid = array.is_valid().to_pylist()
    return [value if ok else None for value, ok in zip(values, valid, strict=True)]
