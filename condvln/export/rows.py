"""Convert Arrow batches to plain rows, with points as ``[x, y, z]`` lists.

``RecordBatch.to_pylist`` makes a dictionary of every point, and episodes have a hundred points each. Here a whole
column of points is first converted to one (n, 3) array.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa

from condvln.collector import no_collection

__all__ = ["Row", "rows_of"]

Row = dict[str, Any]

_POINT_FIELDS = (["x", "y", "z"], ["x", "y", "z", "w"])


def rows_of(batch: pa.RecordBatch | pa.Table) -> list[Row]:
    """Return the rows of ``batch``; structs of x, y, z (w) become lists, other structs dictionaries, nulls None."""
    if isinstance(batch, pa.Table):
        return [row for part in batch.to_batches() for row in rows_of(part)]
    # Garbage collection during the conversion would cost more than the conversion.
    with no_collection():
        columns = [_values(batch.column(index)) for index in range(batch.num_columns)]
        return _records(batch.schema.names, columns)


def _records(names: list[str], columns: list[list[Any]]) -> list[Row]:
    return [dict(zip(names, values, strict=True)) for values in zip(*columns, strict=True)]


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
    listed: list[Any] = array.to_pylist()
    return listed


def _structs(array: pa.StructArray) -> list[Any]:
    names = [array.type.field(i).name for i in range(array.type.num_fields)]
    fields = array.flatten()
    if names in _POINT_FIELDS:
        stacked = np.stack([field.to_numpy(zero_copy_only=False) for field in fields], axis=1)
        points: list[Any] = stacked.tolist()
        return points
    return list(_records(names, [_values(field) for field in fields]))


def _with_nulls(array: pa.Array, values: list[Any]) -> list[Any]:
    if array.null_count == 0:
        return values
    valid = array.is_valid().to_pylist()
    return [value if ok else None for value, ok in zip(values, valid, strict=True)]
