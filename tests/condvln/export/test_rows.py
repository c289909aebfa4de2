"""Decoding Arrow: equal to pyarrow's own, points as lists."""

from __future__ import annotations

from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.export.rows import Points, rows_of
from condvln.export.tables import MemoryTables
from condvln.export.vlnce import EncodedEpisode, encode, ground_truth


def with_lists(value: Any) -> Any:
    if isinstance(value, dict):
        if set(value) in ({"x", "y", "z"}, {"x", "y", "z", "w"}):
            return list(value.values())
        return {key: with_lists(inner) for key, inner in value.items()}
    return [with_lists(inner) for inner in value] if isinstance(value, list) else value


@pytest.mark.parametrize("name", ["episodes", "instructions", "scenes"])
@pytest.mark.parametrize("span", [(0, None), (3, 7), (5, 0), (0, 1)])
def test_rows_equal_those_of_pyarrow(tables: MemoryTables, name: str, span: tuple[int, int | None]) -> None:
    table = tables.tables["replicacad"][name].slice(*span)
    assert rows_of(table) == with_lists(table.to_pylist())
    for batch in table.to_batches():
        assert rows_of(batch) == with_lists(batch.to_pylist())


def test_nulls_at_every_depth() -> None:
    point = pa.struct([("x", pa.float64()), ("y", pa.float64()), ("z", pa.float64())])
    table = pa.table(
        {
            "p": pa.array([None, {"x": 1.0, "y": 2.0, "z": 3.0}], point),
            "l": pa.array([[1], None], pa.list_(pa.int32())),
            "s": pa.array([{"a": None}, None], pa.struct([("a", pa.list_(pa.string()))])),
        }
    )
    assert rows_of(table) == [
        {"p": None, "l": [1], "s": {"a": None}},
        {"p": [1.0, 2.0, 3.0], "l": None, "s": None},
    ]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 9])
@pytest.mark.parametrize("kinds", [1, 3, 400])
def test_structs_of_texts_are_as_pyarrow_says(count: int, kinds: int) -> None:
    """Whether many of them are equal or all differ, with texts and structs that are null."""
    draws = Random(count * kinds)
    names = [f"t{k}" for k in range(count)]
    kind = pa.struct([(name, pa.string()) for name in names])

    def one() -> dict[str, str | None]:
        return {name: draws.choice([None, "", *(f"é{k}" for k in range(kinds))]) for name in names}

    values = [[one() if draws.random() < 0.9 else None for _ in range(draws.randrange(4))] for _ in range(300)]
    table = pa.table({"s": pa.array(values, pa.list_(kind))})
    assert rows_of(table) == table.to_pylist()
    assert rows_of(table.slice(100, 50)) == table.slice(100, 50).to_pylist()


POINT = pa.struct([("x", pa.float64()), ("y", pa.float64()), ("z", pa.float64())])
number = st.floats(width=64) | st.integers(-9999, 9999).map(lambda k: k / 1000)
point = st.fixed_dictionaries({"x": number, "y": number, "z": number})


@given(st.lists(st.none() | st.lists(point, max_size=4), max_size=9), st.integers(0, 4), st.integers(0, 9))
def test_encoded_points_say_the_same(lists: list[list[dict[str, float]] | None], begin: int, length: int) -> None:
    """Any floats, empty lists, lists that are null, and parts of a column."""
    table = pa.table({"p": pa.array(lists, pa.list_(POINT))}).slice(begin, length)
    plain, encoded = rows_of(table), rows_of(table, encoded=True)
    assert encode(encoded) == encode(plain)
    for one, other in zip(plain, encoded, strict=True):
        if one["p"] is None:
            assert other["p"] is None
            continue
        assert isinstance(other["p"], Points)
        assert len(other["p"]) == len(one["p"])
        np.testing.assert_array_equal(np.asarray(other["p"]), np.array(one["p"], dtype=np.float64).reshape(-1, 3))
        for k, found in enumerate(other["p"]):
            np.testing.assert_array_equal([found, other["p"][k]], [one["p"][k]] * 2)


def test_points_that_are_null_are_not_encoded() -> None:
    table = pa.table({"p": pa.array([[None, {"x": 1.0, "y": 2.0, "z": 3.0}]], pa.list_(POINT))})
    assert rows_of(table, encoded=True) == [{"p": [None, [1.0, 2.0, 3.0]]}]


def test_an_encoded_row_gives_the_same_files(tables: MemoryTables) -> None:
    table = tables.tables["replicacad"]["episodes"]
    for plain, encoded in zip(rows_of(table), rows_of(table, encoded=True), strict=True):
        assert EncodedEpisode.of(encoded, "a.glb") == EncodedEpisode.of(plain, "a.glb")
        for change in ({}, {"actions": None}, {"actions": None, "locations": None}):
            assert encode(ground_truth({**encoded, **change})) == encode(ground_truth({**plain, **change}))
        assert encode(encoded) == encode(plain)
