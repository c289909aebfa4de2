"""Convert programs to rows of the ``instructions`` table and back, without loss."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import pyarrow as pa

from condvln.instructions.programs import composition
from schemas.program import Branch, Condition, ObjectRef, Program, Qualifier, RoomRef
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
        "category": program.category,
        "depth": program.depth,
        "chain": program.chain,
        "composition": composition(program),
        "n_conditions": len(program.conditions),
        "n_relational": sum(condition.kind == "relation" for condition in program.conditions),
        "n_leaves": len(program.leaves),
        "gold_leaf": gold,
        "moves": len(program.leaves[gold].moves),
        "conditions": [_condition(condition) for condition in program.conditions],
        "branches": [{name: getattr(branch, name) for name in _BRANCH} for branch in program.branches],
        "leaves": [{"moves": [_move(move) for move in leaf.moves]} for leaf in program.leaves],
        "text": text,
        "words": None if text is None else len(text.split()),
    }


# A program is written field by field: pydantic takes several times as long, and there are hundreds in a scene.
_BRANCH: Final = tuple(Branch.model_fields)


def _condition(condition: Condition) -> dict[str, Any]:
    return {
        "label": condition.label,
        "room": _room(condition.room),
        "qualifier": _qualifier(condition.qualifier),
        "definite": condition.definite,
        "truth": condition.truth,
        "witnesses": condition.witnesses,
    }


def _move(move: ObjectRef) -> dict[str, Any]:
    return {
        "object_id": move.object_id,
        "label": move.label,
        "room": _room(move.room),
        "qualifier": _qualifier(move.qualifier),
    }


def _room(room: RoomRef) -> dict[str, Any]:
    return {
        "room_id": room.room_id,
        "label": room.label,
        "anchor_id": room.anchor_id,
        "anchor_label": room.anchor_label,
    }


def _qualifier(qualifier: Qualifier | None) -> dict[str, Any] | None:
    if qualifier is None:
        return None
    anchors = [{"object_id": anchor.object_id, "label": anchor.label} for anchor in qualifier.anchors]
    return {"predicate": qualifier.predicate, "anchors": anchors}


def programs_from_table(table: pa.Table) -> list[tuple[str, Program]]:
    """Return (instruction id, program) of each row, in the table's order."""
    columns = ["instruction_id", "category", "conditions", "branches", "leaves"]
    return [
        (row["instruction_id"], Program.model_validate({name: row[name] for name in columns[1:]}))
        for row in table.select(columns).to_pylist()
    ]
