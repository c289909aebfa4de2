"""Properties of a program alone: its ids, its composition class, its gold branch."""

from __future__ import annotations

import hashlib

import orjson

from schemas.episode import Composition
from schemas.program import ObjectRef, Program

__all__ = ["ID_LENGTH", "composition", "instruction_id", "leaves_below", "oracle_linear", "program_key"]

ID_LENGTH = 20
"""Hexadecimal digits kept of a SHA-256: 80 bits, so that a million instructions collide with probability 4e-13."""


def program_key(program: Program) -> str:
    """Return the SHA-256 of the program's canonical JSON, truths and witnesses included: equal keys mean equal
    programs.

    Whether a condition is definite follows from the scene, and is left out.
    """
    document = program.model_dump(mode="json", exclude={"conditions": {"__all__": {"definite"}}})
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
