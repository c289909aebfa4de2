"""Convert programs to rows of the ``instructions`` table and back, without loss."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import pyarrow as pa

from condvln.instructions.programs import composition, program_document
from schemas.program import Program
from schemas.tables import INSTRUCTIONS

__all__ = ["instruction_table", "programs_from_table"]


def instruction_table(
    scene_id: str,
    programs: Iterable[tuple[str, Program]],
    texts: Mapping[str, str] | None = None,
    groups: Mapping[str, str | None] | None = None,
) -> pa.Table:
    """Return `programs` as INSTRUCTIONS rows, in the given order.

    Parameters
    ----------
    programs : (instruction id, program)
    texts, groups : text and counterfactual group by instruction id; null if missing
    """
    rows = [
        _row(scene_id, name, program, (texts or {}).get(name), (groups or {}).get(name)) for name, program in programs
    ]
    return pa.Table.from_pylist(rows, schema=INSTRUCTIONS)


def _row(scene_id: str, name: str, program: Program, text: str | None, group: str | None) -> dict[str, Any]:
    gold = program.gold_leaf()
    return {
        "scene_id": scene_id,
        "instruction_id": name,
        "group_id": group,
        "depth": program.depth,
        "chain": program.chain,
        "composition": composition(program),
        "n_conditions": len(program.conditions),
        "n_relational": sum(condition.kind == "relation" for condition in program.conditions),
        "n_leaves": len(program.leaves),
        "gold_leaf": gold,
        "moves": len(program.leaves[gold].moves),
        **program_document(program),
        "text": text,
        "words": None if text is None else len(text.split()),
    }


def programs_from_table(table: pa.Table) -> list[tuple[str, Program]]:
    """Return (instruction id, program) of each row, in the table's order."""
    columns = ["instruction_id", "category", "conditions", "branches", "leaves"]
    return [
        (row["instruction_id"], Program.model_validate({name: row[name] for name in columns[1:]}))
        for row in table.select(columns).to_pylist()
    ]
