"""Properties of a program alone: its ids, its composition class, its gold branch."""

from __future__ import annotations

import hashlib
from typing import Any, Final

import orjson

from schemas.episode import Composition
from schemas.program import Branch, Condition, ObjectRef, Program, Qualifier, RoomRef

__all__ = [
    "ID_LENGTH",
    "composition",
    "instruction_id",
    "leaves_below",
    "oracle_linear",
    "program_document",
    "program_key",
]

ID_LENGTH = 20
"""Hexadecimal digits kept of a SHA-256: 80 bits, so that a million instructions collide with probability 4e-13."""


def program_document(program: Program) -> dict[str, Any]:
    """Return a program as plain data, equal to what pydantic makes of it.

    It is written field by field, since pydantic takes several times as long, and there are hundreds in a scene.
    """
    return {
        "category": program.category,
        "conditions": [_condition(condition) for condition in program.conditions],
        "branches": [{name: getattr(branch, name) for name in _BRANCH} for branch in program.branches],
        "leaves": [{"moves": [_move(move) for move in leaf.moves]} for leaf in program.leaves],
    }


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


def program_key(program: Program) -> str:
    """Return the SHA-256 of the program's canonical JSON, truths and witnesses included: equal keys mean equal
    programs.

    Whether a condition is definite follows from the scene, and is left out.
    """
    document = program_document(program)
    for condition in document["conditions"]:
        del condition["definite"]
    text = orjson.dumps(document, option=orjson.OPT_SORT_KEYS)
    return hashlib.sha256(text).hexdigest()


def instruction_id(family: str, scene_id: str, program: Program) -> str:
    """Return the id of one program in one scene."""
    key = f"{family}\x1f{scene_id}\x1f{program_key(program)}"
    return hashlib.sha256(key.encode()).hexdigest()[:ID_LENGTH]


def leaves_below(program: Program, target: int) -> tuple[int, ...]:
    """Return the indices of the leaves below `target`, the target of a branch. A `target` ≥ 0 is the index of a branch;
    else `target` is ``-1 - leaf``.
    """
    if target < 0:
        return (-1 - target,)
    branch = program.branches[target]
    return leaves_below(program, branch.then) + leaves_below(program, branch.otherwise)


def composition(program: Program) -> Composition:
    """Return the composition class of a program: C0, C1 or C2.

    C0: only one room is named. C2: for some branch, the room of its condition, the rooms of the goals below THEN and
    those below ELSE are disjoint. C1: everything else.
    """
    if len(program.rooms) == 1:
        return "C0"
    for branch in program.branches:
        asked = {program.conditions[branch.condition].room.room_id}
        then, otherwise = (
            {program.leaves[leaf].goal.room.room_id for leaf in leaves_below(program, target)}
            for target in (branch.then, branch.otherwise)
        )
        if not (asked & then or asked & otherwise or then & otherwise):
            return "C2"
    return "C1"


def oracle_linear(program: Program) -> tuple[ObjectRef, ...]:
    """Return the moves of the gold leaf only: its waypoints in order, then its goal."""
    return program.leaves[program.gold_leaf()].moves
