"""One form for equal rows, and one hash."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factory.pipeline import TableSpec
from factory.rows import (
    canonical_table,
    concatenated,
    logical_hash,
    parquet_bytes,
    parquet_table,
    schema_hash,
)
from schemas.errors import CorruptShardError, StageError
from schemas.tables import SORT_KEYS, TABLES

POINT = pa.struct([pa.field("x", pa.float64(), nullable=False), pa.field("tag", pa.string())])
SCHEMA = pa.schema(
    [
        pa.field("k", pa.int64(), nullable=False),
        pa.field("f", pa.float64()),
        pa.field("s", pa.string()),
        pa.field("b", pa.bool_()),
        pa.field("l", pa.list_(pa.int32())),
        pa.field("p", POINT),
        pa.field("ps", pa.list_(POINT)),
        pa.field("t", pa.timestamp("us")),
        pa.field("fixed", pa.list_(pa.int8(), 2)),
        pa.field("y", pa.binary()),
    ]
)
SPEC = TableSpec(SCHEMA, ("k",))

floats = st.floats(width=64)
points = st.fixed_dictionaries({"x": floats, "tag": st.none() | st.text(max_size=3)})
row = st.fixed_dictionaries(
    {
        "f": st.none() | floats,
        "s": st.none() | st.text(max_size=4),
        "b": st.none() | st.booleans(),
        "l": st.none() | st.lists(st.none() | st.integers(-5, 5), max_size=3),
        "p": st.none() | points,
        "ps": st.none() | st.lists(st.none() | points, max_size=2),
        "t": st.none() | st.datetimes(),
        "fixed": st.none() | st.lists(st.integers(-3, 3), min_size=2, max_size=2),
        "y": st.none() | st.binary(max_size=3),
    }
)


def table(rows: list[dict[str, Any]]) -> pa.Table:
    return pa.Table.from_pylist([{"k": k, **values} for k, values in enumerate(rows)], schema=SCHEMA)


@given(st.lists(row, max_size=8), st.randoms(), st.integers(1, 4))
def test_order_chunks_and_encoding_make_no_difference(rows: list[dict[str, Any]], random: Any, size: int) -> None:
    whole = table(rows)
    expected = logical_hash(canonical_table(whole, SPEC, "t"))
    order = [*range(len(rows))]
    random.shuffle(order)
    shuffled = whole.take(pa.array(order, pa.int64()))
    chunked = pa.concat_tables([shuffled.slice(at, size) for at in range(0, len(rows), size)] or [shuffled])
    at = chunked.schema.get_field_index("s")
    encoded = chunked.set_column(at, "s", chunked.column("s").dictionary_encode())
    assert logical_hash(canonical_table(encoded, SPEC, "t")) == expected
    written = parquet_table(parquet_bytes(canonical_table(chunked, SPEC, "t"), sort_keys=("k",)), "file")
    assert logical_hash(written) == expected
    assert written.schema == SCHEMA


@given(st.lists(row, min_size=1, max_size=5), st.data())
def test_every_value_counts(rows: list[dict[str, Any]], data: st.DataObject) -> None:
    before = table(rows)
    at = data.draw(st.integers(0, len(rows) - 1))
    name = data.draw(st.sampled_from([*rows[0]]))
    changed = [*rows]
    changed[at] = {**rows[at], name: data.draw(row)[name]}
    after = table(changed)
    # repr tells 0.0 from -0.0 and has one NaN, as the hash does.
    same = repr(before.to_pylist()) == repr(after.to_pylist())
    assert (logical_hash(before) == logical_hash(after)) == same


@given(st.lists(row, min_size=1, max_size=8), st.data())
def test_slices_and_values_under_nulls_are_not_hashed(rows: list[dict[str, Any]], data: st.DataObject) -> None:
    whole = table(rows)
    pieces = pa.StructArray.from_arrays([whole.column("s").chunk(0), whole.column("l").chunk(0)], ["s", "l"])
    # Nulls of a struct whose fields have values all the same.
    hiding = data.draw(st.lists(st.booleans(), min_size=len(rows), max_size=len(rows)))
    hidden = pa.StructArray.from_arrays([*pieces.flatten()], ["s", "l"], mask=pa.array(hiding))
    whole = whole.append_column("pieces", pieces).append_column("hidden", hidden)
    start = data.draw(st.integers(0, len(rows) - 1))
    for one in (whole, whole.slice(start), whole.slice(0, start), whole.slice(start, 1)):
        assert logical_hash(one) == logical_hash(pa.Table.from_pylist(one.to_pylist(), schema=one.schema))


def test_rows_moved_between_columns_or_cells_hash_differently() -> None:
    tables = [
        pa.table({"a": ["xy", "z"]}),
        pa.table({"a": ["x", "yz"]}),
        pa.table({"b": ["xy", "z"]}),
        pa.table({"a": [["x", "y"], ["z"]]}),
        pa.table({"a": [["x"], ["y", "z"]]}),
        pa.table({"a": [b"xy", b"z"]}),
        pa.table({"a": ["xy", None]}),
        pa.table({"a": ["xy", ""]}),
        pa.table({"a": [1, 2]}),
        pa.table({"a": pa.array([1, 2], pa.int32())}),
        pa.table({"a": [1.0, 2.0]}),
        pa.table({"a": [[1.0], [2.0]]}),
        pa.table({"a": pa.array([[1.0], [2.0]], pa.list_(pa.float64(), 1))}),
    ]
    assert len({logical_hash(one)[0] for one in tables}) == len(tables)


@pytest.mark.parametrize("name", [*TABLES])
def test_the_published_schemas_have_a_form(name: str) -> None:
    spec = TableSpec(TABLES[name], SORT_KEYS[name])
    empty = canonical_table(TABLES[name].empty_table(), spec, name)
    read = parquet_table(parquet_bytes(empty, sort_keys=spec.sort_keys), name)
    assert read.schema == TABLES[name].remove_metadata()
    assert logical_hash(read) == logical_hash(empty)


@pytest.mark.parametrize(
    ("columns", "what"),
    [
        ({"k": [1]}, "missing"),
        ({"k": [1], "v": [1.0], "w": [2]}, "extra"),
        ({"k": [1, 1], "v": [1.0, 2.0]}, "unique"),
        ({"k": [1, None], "v": [1.0, 2.0]}, "null"),
        ({"k": ["one"], "v": [1.0]}, "fit"),
        ({"k": [2**40], "v": [1.0]}, "fit"),
    ],
)
def test_rows_that_break_the_contract_are_refused(columns: dict[str, Any], what: str) -> None:
    spec = TableSpec(pa.schema([pa.field("k", pa.int32(), nullable=False), pa.field("v", pa.float64())]), ("k",))
    with pytest.raises(StageError, match=what):
        canonical_table(pa.table(columns), spec, "t")


def test_nulls_inside_structs_and_lists_are_refused() -> None:
    schema = pa.schema([pa.field("k", pa.int64()), pa.field("ps", pa.list_(POINT))])
    # Arrow lets a null be forged into a column that may have none; it is found all the same.
    loose = pa.list_(pa.struct([("x", pa.float64()), ("tag", pa.string())]))
    for kind in (loose, schema.field("ps").type):
        bad = pa.table({"k": [1], "ps": pa.array([[{"x": None, "tag": "a"}]], kind)})
        with pytest.raises(StageError, match=r"ps\[\]\.x|fit"):
            canonical_table(bad, TableSpec(schema, ("k",)), "t")


def test_equal_tables_give_equal_files_and_damage_is_named() -> None:
    whole = table([{"f": float(n), "s": str(n % 3)} for n in range(1000)])
    chunked = pa.concat_tables([whole.slice(0, 333), whole.slice(333)])
    one, two = (parquet_bytes(canonical_table(t, SPEC, "t"), sort_keys=("k",)) for t in (whole, chunked))
    assert one == two
    with pytest.raises(CorruptShardError, match=r"x\.parquet"):
        parquet_table(one[:-9], "x.parquet")


def test_a_unit_stored_in_several_chunks_gives_the_file_of_one() -> None:
    # So long that the columns have several pages: those of several chunks end at other rows.
    spec = TableSpec(pa.schema([pa.field("k", pa.int64(), nullable=False), pa.field("s", pa.string())]), ("k",))
    letters = np.random.default_rng(3).integers(97, 123, (5000, 400), dtype=np.uint8)
    whole = pa.table({"k": range(5000), "s": [own.tobytes().decode() for own in letters]}, schema=spec.schema)
    units = [whole.slice(0, 2000), whole.slice(2000)]
    stored = [units[0], pa.concat_tables([units[1].slice(0, 700), units[1].slice(700)])]
    one, two = (parquet_bytes(concatenated(iter(tables), spec, "t")) for tables in (units, stored))
    assert one == two


def test_the_schema_hash_sees_names_types_and_nullability() -> None:
    base = pa.schema([pa.field("a", pa.int32()), pa.field("b", POINT)])
    others = [
        pa.schema([pa.field("b", POINT), pa.field("a", pa.int32())]),
        pa.schema([pa.field("a", pa.int64()), pa.field("b", POINT)]),
        pa.schema([pa.field("a", pa.int32(), nullable=False), pa.field("b", POINT)]),
        pa.schema([pa.field("a", pa.int32()), pa.field("b", pa.struct([("x", pa.float64()), ("tag", pa.string())]))]),
    ]
    assert len({schema_hash(schema) for schema in (base, *others)}) == 5
    assert schema_hash(base.with_metadata({"k": "v"})) == schema_hash(base)
