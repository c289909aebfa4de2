"""Convert Arrow batches to plain rows, with points as ``[x, y, z]`` lists.

``RecordBatch.to_pylist`` makes a dictionary of every point, and episodes have a hundred points each. Here a whole
column of points is first converted to one (n, 3) array. Texts and structs of texts, such as rooms, are mostly the same
few: each is made once for a column, so that rows share them.
"""

from __future__ import annotations

from itertools import pairwise, repeat
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from condvln.collector import no_collection

__all__ = ["Row", "rows_of"]

Row = dict[str, Any]

_MOST_COMBINED: Final = 1 << 62
_POINT_FIELDS = (["x", "y", "z"], ["x", "y", "z", "w"])


def rows_of(batch: pa.RecordBatch | pa.Table) -> list[Row]:
    """Return the rows of ``batch``; structs of x, y, z (w) become lists, other structs dictionaries, nulls None.

    Equal structs of texts may be one dictionary, which must not be changed.
    """
    if isinstance(batch, pa.Table):
        return [row for part in batch.to_batches() for row in rows_of(part)]
    # Garbage collection during the conversion would cost more than the conversion.
    with no_collection():
        columns = [_values(batch.column(index)) for index in range(batch.num_columns)]
        return _records(batch.schema.names, columns)


def _records(names: list[str], columns: list[list[Any]]) -> list[Row]:
    # Written out, a dictionary takes half of the time.
    match names:
        case [a, b]:
            return [{a: one, b: two} for one, two in zip(*columns, strict=True)]
        case [a, b, c]:
            return [{a: one, b: two, c: three} for one, two, three in zip(*columns, strict=True)]
        case [a, b, c, d]:
            return [{a: one, b: two, c: three, d: four} for one, two, three, four in zip(*columns, strict=True)]
    return [*map(dict, map(zip, repeat(names), zip(*columns, strict=True)))]


def _values(array: pa.Array) -> list[Any]:
    kind = array.type
    if len(array) == 0:
        return []
    if pa.types.is_struct(kind):
        return _with_nulls(array, _structs(array))
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        offsets = array.offsets.to_numpy()
        # A slice shares the values of the whole array; only the slice's own are decoded.
        values = _values(array.values.slice(offsets[0], offsets[-1] - offsets[0]))
        return _with_nulls(array, [values[a:b] for a, b in pairwise((offsets - offsets[0]).tolist())])
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
    return encoded.indices.fill_null(len(texts)).to_numpy(zero_copy_only=False).astype(np.int64), [*texts, None]


def _structs(array: pa.StructArray) -> list[Any]:
    names = [array.type.field(i).name for i in range(array.type.num_fields)]
    fields = array.flatten()
    if names in _POINT_FIELDS:
        stacked = np.stack([field.to_numpy(zero_copy_only=False) for field in fields], axis=1)
        points: list[Any] = stacked.tolist()
        return points
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
    return _records(names, [_values(field) for field in fields])


def _with_nulls(array: pa.Array, values: list[Any]) -> list[Any]:
    if array.null_count == 0:
        return values
    valid = array.is_valid().to_pylist()
    return [value if ok else None for value, ok in zip(values, valid, strict=True)]
