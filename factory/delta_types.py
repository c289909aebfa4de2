"""Arrow types as Delta names them, in the JSON form that Spark gives a schema.

What Parquet stores alike is one type in Delta: long and short offsets, dictionaries, lists of a fixed size. What Delta
has no type for is refused and never widened: the files stay as they are, and the log can't say otherwise.
Source: the Delta transaction log protocol, "Schema Serialization Format".
"""

from __future__ import annotations

import re
from typing import Any, Final

import pyarrow as pa
from pyarrow import types

from schemas.errors import UsageError

__all__ = ["delta_schema"]

_PLAIN: Final[dict[pa.DataType, str]] = {
    pa.string(): "string",
    pa.large_string(): "string",
    pa.string_view(): "string",
    pa.binary(): "binary",
    pa.large_binary(): "binary",
    pa.binary_view(): "binary",
    pa.bool_(): "boolean",
    pa.int8(): "byte",
    pa.int16(): "short",
    pa.int32(): "integer",
    pa.int64(): "long",
    pa.float32(): "float",
    pa.float64(): "double",
    pa.date32(): "date",
}

_FORBIDDEN: Final = re.compile(r"[ ,;{}()\n\t=]")
"""Characters that no column's name may have in a table without column mapping."""


def delta_schema(schema: pa.Schema, partition: str) -> dict[str, Any]:
    """The columns of ``schema``, and after them the text column ``partition`` that the folders' names hold.

    Raises ``UsageError`` on a type or a name that Delta doesn't have.
    """
    if partition in schema.names:
        raise UsageError("the partition is a column of the files too", place=partition, remedy="Rename the column.")
    names = [name.lower() for name in schema.names]
    if len({*names}) != len(names):
        raise UsageError("names of columns differ in case alone, which Delta can't tell", remedy="Rename one.")
    return _struct([*schema, pa.field(partition, pa.string())], "")


def _struct(fields: list[pa.Field], where: str) -> dict[str, Any]:
    described = []
    for field in fields:
        place = f"{where}.{field.name}" if where else field.name
        if _FORBIDDEN.search(field.name):
            raise UsageError("Delta has no column of this name", place=place, remedy="Rename the column.")
        kind = _type(field.type, place)
        described.append({"name": field.name, "type": kind, "nullable": field.nullable, "metadata": {}})
    return {"type": "struct", "fields": described}


def _type(kind: pa.DataType, where: str) -> Any:
    if kind in _PLAIN:
        return _PLAIN[kind]
    if types.is_dictionary(kind):
        return _type(kind.value_type, where)
    if types.is_struct(kind):
        return _struct([*kind], where)
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        item = kind.value_field
        return {"type": "array", "elementType": _type(item.type, f"{where}[]"), "containsNull": item.nullable}
    if types.is_map(kind):
        return {
            "type": "map",
            "keyType": _type(kind.key_type, f"{where}.key"),
            "valueType": _type(kind.item_type, f"{where}.value"),
            "valueContainsNull": kind.item_field.nullable,
        }
    if types.is_decimal128(kind) and 0 <= kind.scale <= kind.precision:
        return f"decimal({kind.precision},{kind.scale})"
    if types.is_timestamp(kind) and kind.unit == "us" and kind.tz is not None:
        return "timestamp"
    raise UsageError(f"Delta has no type for {kind}", place=where, remedy="Read the Parquet files themselves.")
