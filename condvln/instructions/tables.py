"""Convert programs to rows of the ``instructions`` table and back, without loss."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import accumulate
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa

from condvln.instructions.programs import branch_documents, composition, condition_document, move_document
from schemas.program import Condition, Leaf, Program
from schemas.tables import INSTRUCTIONS

__all__ = ["instruction_table", "instructions_with_text", "programs_from_table"]

T = TypeVar("T")


def instruction_table(
    scene_id: str,
    programs: Iterable[tuple[str, Program]],
) -> pa.Table:
    """Return `programs`, pairs of instruction id and program, as INSTRUCTIONS rows in the given order, without text and
    counterfactual group.
    """
    given = list(programs)
    names, found = [name for name, _ in given], [program for _, program in given]
    golds = [program.gold_leaf() for program in found]
    columns: dict[str, Any] = {
        "scene_id": [scene_id] * len(names),
        "instruction_id": names,
        "group_id": [None] * len(names),
        "category": [program.category for program in found],
        "depth": [program.depth for program in found],
        "chain": [program.chain for program in found],
        "composition": [composition(program) for program in found],
        "n_conditions": [len(program.conditions) for program in found],
        "n_relational": [sum([one.kind == "relation" for one in program.conditions]) for program in found],
        "n_leaves": [len(program.leaves) for program in found],
        "gold_leaf": golds,
        "moves": [len(program.leaves[gold].moves) for program, gold in zip(found, golds, strict=True)],
        "conditions": _conditions([program.conditions for program in found]),
        "branches": _shared(
            [program.branches for program in found], branch_documents, INSTRUCTIONS.field("branches").type
        ),
        "leaves": _leaves([program.leaves for program in found]),
        "text": [None] * len(names),
        "words": [None] * len(names),
    }
    arrays = [
        column if isinstance(column, pa.Array) else pa.array(column, field.type)
        for field, column in zip(INSTRUCTIONS, (columns[name] for name in INSTRUCTIONS.names), strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=INSTRUCTIONS)


def instructions_with_text(table: pa.Table, texts: Mapping[str, str], groups: Mapping[str, str | None]) -> pa.Table:
    """Return INSTRUCTIONS rows with their text, number of words, and counterfactual group, by instruction id; null if
    missing.
    """
    names = table["instruction_id"].to_pylist()
    said = [texts.get(name) for name in names]
    new: dict[str, list[Any]] = {
        "group_id": [groups.get(name) for name in names],
        "text": said,
        "words": [None if text is None else len(text.split()) for text in said],
    }
    arrays = [
        pa.array(new[field.name], field.type) if field.name in new else table[field.name] for field in INSTRUCTIONS
    ]
    return pa.table(arrays, schema=INSTRUCTIONS)


def _conditions(rows: Sequence[Sequence[Condition]]) -> pa.Array:
    kind = INSTRUCTIONS.field("conditions").type
    values = _shared([condition for row in rows for condition in row], condition_document, kind.value_type)
    return pa.ListArray.from_arrays(_offsets(rows), values)


def _leaves(rows: Sequence[Sequence[Leaf]]) -> pa.Array:
    leaf = INSTRUCTIONS.field("leaves").type.value_type
    stops = [one.moves for row in rows for one in row]
    values = _shared([move for moves in stops for move in moves], move_document, leaf.field("moves").type.value_type)
    moves = pa.ListArray.from_arrays(_offsets(stops), values)
    return pa.ListArray.from_arrays(_offsets(rows), pa.StructArray.from_arrays([moves], fields=[leaf.field("moves")]))


def _shared(parts: Sequence[T], document: Callable[[T], Any], kind: pa.DataType) -> pa.Array:
    """Return `parts` as an array. What occurs several times is written once: programs of a scene share most
    of their parts.
    """
    identities = np.fromiter(map(id, parts), np.uint64, len(parts))
    _, first, numbers = np.unique(identities, return_index=True, return_inverse=True)
    return pa.array([document(parts[k]) for k in first.tolist()], kind).take(pa.array(numbers))


def _offsets(rows: Sequence[Sequence[object]]) -> pa.Array:
    return pa.array(accumulate(map(len, rows), initial=0), pa.int32())


def programs_from_table(table: pa.Table) -> list[tuple[str, Program]]:
    """Return (instruction id, program) of each row, in the table's order."""
    columns = ["instruction_id", "category", "conditions", "branches", "leaves"]
    return [
        (row["instruction_id"], Program.model_validate({name: row[name] for name in columns[1:]}))
        for row in table.select(columns).to_pylist()
    ]
