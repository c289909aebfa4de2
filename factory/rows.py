"""The canonical form of rows: sorted, with exactly their contract's columns, and hashed independently of the encoding.

The logical hash covers column names, types and values. It does not depend on chunks, dictionary or run-end encoding,
the bytes under nulls, offsets of slices, or the version of pyarrow (whose IPC padding and metadata may change), and so
it names the same rows in every store and across upgrades. NaNs count as one value; 0.0 and -0.0 as two.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from factory.pipeline import TableSpec
from factory.row_buffers import Layout, UnreadableBuffersError, layout_of, row_bytes
from schemas.errors import CorruptShardError, StageError

__all__ = ["ROW_GROUP_ROWS", "canonical_table", "logical_hash", "parquet_bytes", "parquet_table", "schema_hash"]

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
    if table.num_rows < 2 or not keys or _ascends(table, keys):
        return table
    table = table.combine_chunks()
    order = pc.sort_indices(table, sort_keys=[(key, "ascending") for key in keys])
    if not np.array_equal(order.to_numpy(), np.arange(table.num_rows, dtype=np.uint64)):
        table = table.take(order).combine_chunks()
        if _ascends(table, keys):
            return table
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


def _ascends(table: pa.Table, keys: tuple[str, ...]) -> bool:
    """Return whether each row comes after the one before it and differs from it in the sort keys; False, too, where a
    key is null or not a number. To see this takes a fraction of the time of sorting.
    """
    behind = np.zeros(table.num_rows - 1, dtype=bool)
    equal = ~behind
    for key in keys:
        column = table.column(key)
        if column.null_count:
            return False
        one, two = column.slice(0, table.num_rows - 1), column.slice(1)
        behind |= equal & pc.less(one, two).to_numpy()
        equal &= pc.equal(one, two).to_numpy()
    return bool(behind.all())


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
    batches = table.to_batches()
    plan = _plan(table.schema.serialize().to_pybytes()) if len(batches) == 1 else None
    if plan is not None:
        with contextlib.suppress(UnreadableBuffersError):
            pieces, size = row_bytes(batches[0], *plan)
            return hashlib.sha256(b"".join(pieces)).hexdigest()[:32], size
    return _hash_of_arrays(table)


def _hash_of_arrays(table: pa.Table) -> tuple[str, int]:
    """Return what `logical_hash` returns, found array by array."""
    feed = _Feed()
    for field, column in zip(table.schema, table.columns, strict=True):
        feed.add(f"{field.name}:{_type_name(field.type)}".encode())
        chunks = column.chunks
        feed.array(chunks[0] if len(chunks) == 1 else pa.concat_arrays(chunks) if chunks else _empty(field.type))
    return feed.hash.hexdigest()[:32], feed.size


@lru_cache(maxsize=256)
def _plan(schema: bytes) -> tuple[tuple[Layout, ...], tuple[bytes, ...]] | None:
    """Return how the columns of an encoded schema are read from their buffers, and what is fed before each; None if
    some column can't be read so.
    """
    fields = [*pa.ipc.read_schema(pa.py_buffer(schema))]
    layouts = [layout_of(field.type) for field in fields]
    known = tuple(layout for layout in layouts if layout is not None)
    headers = tuple(f"{field.name}:{_type_name(field.type)}".encode() for field in fields)
    return (known, headers) if len(known) == len(fields) else None


def schema_hash(schema: pa.Schema) -> str:
    """Return a 128-bit hash of names, types and nullability of the columns, in their order."""
    text = ";".join(f"{f.name}:{_type_name(f.type)}{'?' if f.nullable else ''}" for f in schema)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _empty(kind: pa.DataType) -> Any:
    return pa.array([], type=kind)


@lru_cache(maxsize=1024)
def _type_name(kind: pa.DataType) -> str:
    """Return the name of a column type. The name does not depend on the version of pyarrow, nor on how the values are
    encoded.
    """
    if pa.types.is_dictionary(kind) or pa.types.is_run_end_encoded(kind):
        return _type_name(kind.value_type)
    if isinstance(kind, pa.BaseExtensionType):
        return _type_name(kind.storage_type)
    if pa.types.is_struct(kind):
        return "struct(" + ",".join(f"{f.name}:{_type_name(f.type)}{'?' if f.nullable else ''}" for f in kind) + ")"
    if pa.types.is_fixed_size_list(kind):
        return f"list[{kind.list_size}]({_type_name(kind.value_type)})"
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        return f"list({_type_name(kind.value_type)}{'?' if kind.value_field.nullable else ''})"
    if pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind):
        return "string"
    if pa.types.is_binary(kind) or pa.types.is_large_binary(kind) or pa.types.is_binary_view(kind):
        return "binary"
    return str(kind)


_NOTHING: Final = (0).to_bytes(8, "little")
_LISTS: Final = frozenset({pa.lib.Type_LIST, pa.lib.Type_LARGE_LIST})
_OFFSETS: Final = {
    pa.lib.Type_STRING: "<i4",
    pa.lib.Type_BINARY: "<i4",
    pa.lib.Type_LARGE_STRING: "<i8",
    pa.lib.Type_LARGE_BINARY: "<i8",
}
"""Types of the offsets of columns of text and bytes. Any other encoding of these is cast to the last two."""
_NUMBERS: Final = frozenset(
    getattr(pa.lib, f"Type_{name}")
    for name in ("INT8", "INT16", "INT32", "INT64", "UINT8", "UINT16", "UINT32", "UINT64", "FLOAT", "DOUBLE")
)


class _Feed:
    """Feeds arrays to a hash. Every value is preceded by its length, so that different tables feed different bytes."""

    def __init__(self) -> None:
        self.hash = hashlib.sha256()
        self.size = 0

    def add(self, data: Any) -> None:
        if not len(data):
            self.hash.update(_NOTHING)
            return
        view = memoryview(data).cast("B")
        self.hash.update(len(view).to_bytes(8, "little"))
        self.hash.update(view)
        self.size += len(view)

    def array(self, array: Any) -> None:
        # By the number of the type where most columns are: asking pa.types takes longer than hashing a short column.
        kind = array.type
        if kind.id == pa.lib.Type_DICTIONARY:
            self.array(array.dictionary_decode())
            return
        if kind.id == pa.lib.Type_RUN_END_ENCODED:
            self.array(pc.run_end_decode(array))
            return
        if isinstance(kind, pa.BaseExtensionType):
            self.array(array.storage)
            return
        self.hash.update(len(array).to_bytes(8, "little"))
        valid = None
        if array.null_count:
            valid = array.is_valid().to_numpy(zero_copy_only=False)
            self.add(np.packbits(valid))
        else:
            self.hash.update(_NOTHING)
        if kind.id == pa.lib.Type_STRUCT:
            for child in array.flatten():
                self.array(child)
        elif kind.id in _LISTS:
            self._lengths(array, valid)
            self.array(array.flatten())
        elif kind.id in _NUMBERS:
            self._fixed(array, valid)
        elif kind.id in _OFFSETS:
            self._variable(array, valid)
        elif kind.id == pa.lib.Type_BOOL:
            whole = array if valid is None else pc.fill_null(array, False)
            self.add(np.packbits(whole.to_numpy(zero_copy_only=False)))
        else:
            self._rare(array, valid)

    def _rare(self, array: Any, valid: Any) -> None:
        kind = array.type
        if pa.types.is_null(kind):
            return
        if pa.types.is_fixed_size_list(kind):
            self.array(array.flatten())
        elif _type_name(kind) in ("string", "binary"):
            self._variable(array, valid)
        elif pa.types.is_primitive(kind) or pa.types.is_decimal(kind) or pa.types.is_fixed_size_binary(kind):
            self._fixed(array, valid)
        else:
            raise StageError(f"columns of type {kind} have no canonical form; use structs and lists")

    def _lengths(self, array: Any, valid: Any) -> None:
        if valid is None and len(array):
            self.add(np.diff(array.offsets.to_numpy()).astype("<i8"))
        else:
            self.add(pc.fill_null(pc.list_value_length(array), 0).to_numpy().astype("<i8"))

    def _variable(self, array: Any, valid: Any) -> None:
        if valid is not None:
            array = pc.fill_null(array, "" if _type_name(array.type) == "string" else b"")
        if array.type.id not in _OFFSETS:
            array = array.cast(pa.large_string() if _type_name(array.type) == "string" else pa.large_binary())
        width = np.dtype(_OFFSETS[array.type.id])
        _, offsets, data = array.buffers()
        start = array.offset * width.itemsize
        ends = np.frombuffer(offsets, width, count=len(array) + 1, offset=start) if len(array) else np.zeros(1)
        self.add(np.diff(ends).astype("<i8"))
        first, last = int(ends[0]), int(ends[-1])
        self.add(memoryview(data)[first:last] if data is not None and last > first else b"")

    def _fixed(self, array: Any, valid: Any) -> None:
        width = array.type.bit_width // 8
        buffer = array.buffers()[1]
        if buffer is None or len(array) == 0:
            self.add(b"")
            return
        raw = np.frombuffer(buffer, np.uint8, count=len(array) * width, offset=array.offset * width)
        if pa.types.is_floating(array.type):
            values = raw.view(f"<f{width}")
            missing = np.isnan(values)
            if missing.any():
                values = values.copy()
                values[missing] = np.nan
                raw = values.view(np.uint8)
        if valid is not None:
            raw = raw.reshape(-1, width).copy()
            raw[~valid] = 0
        self.add(np.ascontiguousarray(raw).reshape(-1))


def parquet_bytes(
    table: pa.Table, *, sort_keys: tuple[str, ...] = (), metadata: Mapping[str, str] | None = None
) -> Any:
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
        # A dictionary of numbers takes long to make, and seldom makes the file smaller.
        use_dictionary=[path for field in table.schema for path in _text_paths(field.name, field.type)],
        sorting_columns=pq.SortingColumn.from_ordering(table.schema, [(key, "ascending") for key in sort_keys])
        if sort_keys
        else None,
    )
    return sink.getvalue()


def _text_paths(name: str, kind: pa.DataType) -> Iterator[str]:
    """Yield the paths in a Parquet file of the columns of text in a column, nested ones included."""
    if pa.types.is_struct(kind):
        for field in kind:
            yield from _text_paths(f"{name}.{field.name}", field.type)
    elif pa.types.is_list(kind) or pa.types.is_large_list(kind):
        yield from _text_paths(f"{name}.list.element", kind.value_type)
    elif _type_name(kind) == "string":
        yield name


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
            remedy="Run condvln rebuild CONFIG --verify, which rebuilds damaged files.",
        ) from error
    return pa.table(table.columns, schema=_plain(table.schema))


def _plain(schema: pa.Schema) -> pa.Schema:
    return pa.schema([field.remove_metadata() for field in schema])


def concatenated(tables: Iterator[pa.Table], spec: TableSpec, name: str) -> pa.Table:
    """Concatenate canonical tables of one contract, in canonical order."""
    # One chunk a unit, however its table was stored: the bytes of a Parquet file depend on the chunks.
    whole = [
        table if all(column.num_chunks <= 1 for column in table.columns) else table.combine_chunks() for table in tables
    ]
    if not whole:
        return spec.schema.remove_metadata().empty_table()
    # The names of the elements of lists are in the file too: they are those that Parquet gives, whatever they were.
    joined = pa.concat_tables(whole).cast(_of_parquet(spec.schema))
    # The tables of units mostly follow each other as they are, and are then not copied into one.
    return _sorted(joined, spec.sort_keys, name)


@lru_cache(maxsize=64)
def _of_parquet(schema: pa.Schema) -> pa.Schema:
    """Return the schema with which a table of schema ``schema`` comes back from a Parquet file."""
    return parquet_table(parquet_bytes(schema.empty_table()), "").schema
