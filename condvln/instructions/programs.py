"""Properties of a program alone: its ids, its composition class, its gold branch."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Final, TypeVar, get_args

import numpy as np
import orjson
from numpy.typing import NDArray

from schemas.episode import Composition
from schemas.program import SHAPES, Branch, Category, Condition, ObjectRef, Program, Qualifier, RoomRef

__all__ = [
    "COMPOSITIONS",
    "ID_LENGTH",
    "ProgramParts",
    "branch_documents",
    "composition",
    "condition_document",
    "instruction_id",
    "move_document",
    "oracle_linear",
    "program_document",
    "program_key",
    "side_masks",
]

T = TypeVar("T")

COMPOSITIONS: Final = get_args(Composition)
"""The composition classes, by number."""

ID_LENGTH = 20
"""Hexadecimal digits kept of a SHA-256: 80 bits, so that a million instructions collide with probability 4e-13."""


def program_document(program: Program) -> dict[str, Any]:
    """Return a program as plain data, equal to what pydantic makes of it.

    It is written field by field, since pydantic takes several times as long, and there are hundreds in a scene.
    """
    return {
        "category": program.category,
        "conditions": [condition_document(condition) for condition in program.conditions],
        "branches": branch_documents(program.branches),
        "leaves": [{"moves": [move_document(move) for move in leaf.moves]} for leaf in program.leaves],
    }


_BRANCH: Final = tuple(Branch.model_fields)


def condition_document(condition: Condition) -> dict[str, Any]:
    """Return a condition as plain data; see `program_document`."""
    return {
        "label": condition.label,
        "room": _room(condition.room),
        "qualifier": _qualifier(condition.qualifier),
        "definite": condition.definite,
        "truth": condition.truth,
        "witnesses": condition.witnesses,
    }


def move_document(move: ObjectRef) -> dict[str, Any]:
    """Return a stop as plain data; see `program_document`."""
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


class ProgramParts:
    """The canonical JSON of the parts of programs. A sampler makes each condition and each name of a stop once, and
    hundreds of programs share them. Parts are kept, so that the identity of each stays its own.
    """

    def __init__(self) -> None:
        self._known: dict[int, tuple[object, bytes]] = {}

    def text(self, part: T, document: Callable[[T], Any]) -> bytes:
        """Return the JSON of what `document` makes of a part."""
        found = self._known.get(id(part))
        if found is None:
            found = self._known[id(part)] = (part, orjson.dumps(document(part), option=orjson.OPT_SORT_KEYS))
        return found[1]

    def texts(self, parts: Sequence[T], document: Callable[[T], Any]) -> list[bytes]:
        """Return `text` of each part."""
        known = self._known
        try:
            return [known[id(part)][1] for part in parts]
        except KeyError:
            return [self.text(part, document) for part in parts]


def program_key(program: Program, parts: ProgramParts | None = None) -> str:
    """Return the SHA-256 of the program's canonical JSON, truths and witnesses included: equal keys mean equal
    programs.

    Whether a condition is definite follows from the scene, and is left out. `parts` has the parts of other programs.
    """
    known = ProgramParts() if parts is None else parts
    leaves = [b'{"moves":[%b]}' % b",".join(known.texts(leaf.moves, move_document)) for leaf in program.leaves]
    whole = b'{"branches":%b,"category":%b,"conditions":[%b],"leaves":[%b]}' % (
        known.text(program.branches, branch_documents),
        orjson.dumps(program.category),
        b",".join(known.texts(program.conditions, _told)),
        b",".join(leaves),
    )
    return hashlib.sha256(whole).hexdigest()


def branch_documents(branches: tuple[Branch, ...]) -> list[dict[str, Any]]:
    """Return branches as plain data; see `program_document`."""
    return [{name: getattr(branch, name) for name in _BRANCH} for branch in branches]


def _told(condition: Condition) -> dict[str, Any]:
    document = condition_document(condition)
    del document["definite"]
    return document


def instruction_id(family: str, scene_id: str, program: Program, parts: ProgramParts | None = None) -> str:
    """Return the id of one program in one scene."""
    key = f"{family}\x1f{scene_id}\x1f{program_key(program, parts)}"
    return hashlib.sha256(key.encode()).hexdigest()[:ID_LENGTH]


def composition(program: Program) -> Composition:
    """Return the composition class of a program: C0, C1 or C2.

    C0: only one room is named. C2: for some branch, the room of its condition, the rooms of the goals below THEN and
    those below ELSE are disjoint. C1: everything else.
    """
    goals = [leaf.moves[-1].room.room_id for leaf in program.leaves]
    asked = [condition.room.room_id for condition in program.conditions]
    named = {*goals, *asked}
    named.update([move.room.room_id for leaf in program.leaves for move in leaf.moves])
    if len(named) == 1:
        return "C0"
    for condition, below_then, below_else in _sides(program.branches):
        room = asked[condition]
        then, otherwise = {goals[k] for k in below_then}, {goals[k] for k in below_else}
        if room not in then and room not in otherwise and then.isdisjoint(otherwise):
            return "C2"
    return "C1"


def _leaves_below(branches: tuple[Branch, ...], target: int) -> tuple[int, ...]:
    """Return the indices of the leaves below `target`, the target of a branch. A `target` ≥ 0 is the index of a branch;
    else `target` is ``-1 - leaf``.
    """
    if target < 0:
        return (-1 - target,)
    branch = branches[target]
    return _leaves_below(branches, branch.then) + _leaves_below(branches, branch.otherwise)


@cache
def _sides(branches: tuple[Branch, ...]) -> tuple[tuple[int, tuple[int, ...], tuple[int, ...]], ...]:
    """Return for each branch its condition and the leaves below THEN and below ELSE."""
    below = [tuple(_leaves_below(branches, to) for to in (one.then, one.otherwise)) for one in branches]
    return tuple((one.condition, then, otherwise) for one, (then, otherwise) in zip(branches, below, strict=True))


@cache
def side_masks(category: Category) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the condition of each of the b branches of a category, (b,), and a mask (b, 2, leaves) of the leaves below
    THEN and below ELSE.
    """
    shape = SHAPES[category]
    sides = _sides(shape.branches)
    below = [[[leaf in side for leaf in range(shape.leaves)] for side in two] for _, *two in sides]
    return np.array([condition for condition, *_ in sides]), np.array(below)


def oracle_linear(program: Program) -> tuple[ObjectRef, ...]:
    """Return the moves of the gold leaf only: its waypoints in order, then its goal."""
    return program.leaves[program.gold_leaf()].moves
