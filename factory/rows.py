"""The canonical form of rows: sorted, with exactly their contract's columns, and hashed independently of the encoding.

The logical hash covers column names, types and values. It does not depend on chunks, dictionary encoding, the bytes
under nulls, offsets of slices, or the version of pyarrow (whose IPC padding and metadata may change), and so it names
the same rows in every store and across upgrades. NaNs count as one value; 0.0 and -0.0 as two.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from factory.pipeline import TableSpec
from schemas.errors import CorruptShardError, StageError

__all__ = [
    "ROW_GROUP_ROWS",
    "canonical_table",
    "concatenated",
    "logical_hash",
    "parquet_bytes",
    "parquet_table",
    "schema_hash",
]

ROW_GROUP_ROWS: Final = 122_880
"""Rows per row group: DuckDB's default, its unit of parallelism."""

ZSTD_LEVEL: Final = 3
"""Compression level of zstd. Level 9 gains less than 1 % on these tables and costs several times as much."""


def canonical_table(table: pa.Table, spec: TableSpec | None, name: str) -> pa.Table:
    """Return ``table`` in canonical form: columns, types and order of ``spec``; a table without a contract keeps its
    own columns, types and order.

    Raises ``StageError`` on missing or extra columns, values that do not fit, nulls where none may be, and rows that
    the sort keys do not tell apart.
    """
    if spec is None:
        return table.replace_schema_metadata(None).combine_chunks()
    if set(table.column_names) != set(spec.schema.names):
        missing = [c for c in spec.schema.names if c not in table.column_names]
        extra = [c for c in table.column_names if c not in spec.schema.names]
        raise StageError(f"table {name!r} does not have its columns: missing {missing}, extra {extra}")
    cast, wanted = table.select(spec.schema.names).replace_schema_metadata(None), spec.schema.remove_metadata()
    if not cast.schema.equals(wanted, check_metadata=True):  # a cast takes long even where it changes nothing
        try:
            cast = cast.cast(wanted)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError, ValueError) as error:
            raise StageError(f"table {name!r} does not fit its schema: {error}") from error
    cast = cast.combine_chunks()
    for field, column in zip(spec.schema, cast.columns, strict=True):
        _refuse_nulls(column, field, f"{name}.{field.name}")
    return _sorted(cast, spec.sort_keys, name)


def _sorted(table: pa.Table, keys: tuple[str, ...], name: str) -> pa.Table:
    """Return the rows in the order of their keys, in one chunk. Raises ``StageError`` on equal keys."""
    table = table.combine_chunks()
    if table.num_rows < 2 or not keys:
        return table
    table = table.take(pc.sort_indices(table, sort_keys=[(key, "ascending") for key in keys])).combine_chunks()
    same = np.ones(table.num_rows - 1, dtype=bool)
    for key in keys:
        column = table.column(key)
        one, two = column.slice(0, table.num_rows - 1), column.slice(1)
        equal = pc.or_(pc.fill_null(pc.equal(one, two), False), pc.and_(pc.is_null(one), pc.is_null(two)))
        same &= equal.to_numpy().astype(bool)
    if same.any():
        row = table.slice(int(np.argmax(same)), 1).select(list(keys)).to_pylist()[0]
        raise StageError(f"table {name!r} has two rows with the sort keys {row}; together they must be unique")
    return table


def _refuse_nulls(column: Any, field: pa.Field, where: str) -> None:
    """Raise ``StageError`` if the column called ``where``, or one nested in it, has nulls that it may not have."""
    if not field.nullable and column.null_count:
        raise StageError(f"{where} has {column.null_count} nulls, and its schema allows none")
    if not field.type.num_fields:
        return
    for array in column.chunks if isinstance(column, pa.ChunkedArray) else [column]:
        if pa.types.is_struct(field.type):
            # Fields of a null struct are null themselves, so only whole structs are looked into.
            whole = array.drop_null() if array.null_count else array
            for at, child in enumerate(field.type):
                _refuse_nulls(whole.field(at), child, f"{where}.{child.name}")
        elif pa.types.is_list(field.type) or pa.types.is_large_list(field.type):
            _refuse_nulls(array.flatten(), field.type.value_field, f"{where}[]")


def logical_hash(table: pa.Table) -> tuple[str, int]:
    """Return (128-bit hash in hexadecimal, size in bytes) of the rows of ``table`` in their order.

    Raises ``StageError`` on a column type that has no canonical form here (maps, unions).
    """
    rows = _RowHash()
    for field, column in zip(table.schema, table.columns, strict=True):
        rows.data(f"{field.name}:{_type_name(field.type)}".encode())
        rows.array(pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], field.type))
    return rows.state.hexdigest()[:32], rows.size


class _RowHash:
    """Hashes arrays. Data is preceded by its length, so that different tables feed different bytes.

    size : bytes of all data so far
    """

    def __init__(self) -> None:
        self.state = hashlib.sha256()
        self.size = 0

    def data(self, data: Any) -> None:
        """Add bytes, or the bytes of an (n,) array."""
        view = memoryview(data).cast("B") if len(data) else b""
        self.state.update(len(view).to_bytes(8, "little"))
        self.state.update(view)
        self.size += len(view)

    def array(self, array: Any) -> None:
        """Add the length of an array, which of its values are null, and the values, those of nested arrays too."""
        kind = array.type
        if pa.types.is_dictionary(kind):
            self.array(array.dictionary_decode())
            return
        self.state.update(len(array).to_bytes(8, "little"))
        valid = array.is_valid().to_numpy(zero_copy_only=False) if array.null_count else None
        self.data(b"" if valid is None else np.packbits(valid))
        if pa.types.is_struct(kind):
            for child in array.flatten():
                self.array(child)
        elif pa.types.is_list(kind) or pa.types.is_large_list(kind):
            self.data(pc.fill_null(pc.list_value_length(array), 0).to_numpy().astype("<i8"))
            self.array(array.flatten())
        elif pa.types.is_fixed_size_list(kind):
            self.array(array.flatten())
        elif pa.types.is_boolean(kind):
            self.data(np.packbits(pc.fill_null(array, False).to_numpy(zero_copy_only=False)))
        elif _type_name(kind) in ("string", "binary"):
            self._texts(array.cast(pa.large_binary()))
        elif pa.types.is_primitive(kind) or pa.types.is_decimal(kind) or pa.types.is_fixed_size_binary(kind):
            self._fixed(array, valid)
        elif not pa.types.is_null(kind):
            raise StageError(f"columns of type {kind} have no canonical form; use structs and lists")

    def _texts(self, array: Any) -> None:
        """Add the lengths of texts, then the texts one after the other."""
        if array.null_count:
            array = pc.fill_null(array, b"")
        _, offsets, data = array.buffers()
        ends = np.frombuffer(offsets, "<i8", len(array) + 1, 8 * array.offset) if len(array) else np.zeros(1, "<i8")
        self.data(np.diff(ends))
        self.data(memoryview(data)[int(ends[0]) : int(ends[-1])] if ends[-1] > ends[0] else b"")

    def _fixed(self, array: Any, valid: Any) -> None:
        """Add values of a fixed width. NaNs count as one value, and what is under a null as 0."""
        width = array.type.bit_width // 8
        buffer = array.buffers()[1]
        if buffer is None or not len(array):
            self.data(b"")
            return
        raw = np.frombuffer(buffer, np.uint8, len(array) * width, array.offset * width).reshape(-1, width)
        if pa.types.is_floating(array.type):
            values = raw.view(f"<f{width}")
            raw = np.where(np.isnan(values), values.dtype.type(np.nan), values).view(np.uint8)
        self.data(np.ascontiguousarray(raw if valid is None else np.where(valid[:, None], raw, 0)).reshape(-1))


def schema_hash(schema: pa.Schema) -> str:
    """Return a 128-bit hash of names, types and nullability of the columns, in their order."""
    text = ";".join(f"{f.name}:{_type_name(f.type)}{'?' if f.nullable else ''}" for f in schema)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


@lru_cache(maxsize=1024)
def _type_name(kind: pa.DataType) -> str:
    """Return the name of a column type. The name does not depend on the version of pyarrow, nor on how the values are
    encoded.
    """
    if pa.types.is_dictionary(kind):
        return _type_name(kind.value_type)
    if pa.types.is_struct(kind):
        return "struct(" + ",".join(f"{f.name}:{_type_name(f.type)}{'?' if f.nullable else ''}" for f in kind) + ")"
    if pa.types.is_fixed_size_list(kind):
        return f"list[{kind.list_size}]({_type_name(kind.value_type)})"
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        return f"list({_type_name(kind.value_type)}{'?' if kind.value_field.nullable else ''})"
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return "string"
    if pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
        return "binary"
    return str(kind)


def parquet_bytes(
    table: pa.Table, *, sort_keys: tuple[str, ...] = (), metadata: Mapping[str, str] | None = None
) -> bytes:
    """Encode ``table`` as one Parquet file, with a single call of ``write_table``, so that equal tables in equal chunks
    give equal bytes.
    """
    sink = pa.BufferOutputStream()
    pq.write_table(
        table.replace_schema_metadata(dict(metadata) if metadata else None),
        sink,
        compression="zstd",
        compression_level=ZSTD_LEVEL,
        row_group_size=ROW_GROUP_ROWS,
        write_page_index=True,
        sorting_columns=pq.SortingColumn.from_ordering(table.schema, [(key, "ascending") for key in sort_keys])
        if sort_keys
        else None,
    )
    data: bytes = sink.getvalue().to_pybytes()
    return data


def parquet_table(data: Any, where: str, columns: Iterable[str] | None = None) -> pa.Table:
    """Decode the table in ``data``, with the column types that it had when it was written.

    Raises ``CorruptShardError`` when it is not a Parquet file.
    """
    try:
        # Not read_table, which goes by way of Arrow's datasets and their threads even for a buffer.
        table = pq.ParquetFile(pa.BufferReader(data)).read(
            columns=None if columns is None else list(columns), use_threads=False
        )
    except (pa.ArrowException, OSError, ValueError) as error:
        raise CorruptShardError(
            f"not a readable Parquet file: {error}",
            where=where,
            remedy="Run condvln generate CONFIG --verify, which rebuilds damaged files.",
        ) from error
    return pa.table(table.columns, schema=pa.schema([field.remove_metadata() for field in table.schema]))


def concatenated(tables: Iterable[pa.Table], spec: TableSpec, name: str) -> pa.Table:
    """Concatenate canonical tables of one contract, in canonical order."""
    # The cast gives the elements of lists the names of the contract, whatever a table called them.
    schema = spec.schema.remove_metadata()
    whole = [table.cast(schema) for table in tables]
    return _sorted(pa.concat_tables(whole), spec.sort_keys, name) if whole else schema.empty_table()
