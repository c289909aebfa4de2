"""Decoding Arrow: equal to pyarrow's own, points as lists."""

from __future__ import annotations

from random import Random
from typing import Any

import pyarrow as pa
import pytest

from condvln.export.tables import rows_of
from tests.made_snapshot import MemoryTables


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
