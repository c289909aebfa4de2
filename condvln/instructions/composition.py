"""The composition axis: how far condition and targets of a program are spread over rooms."""

from __future__ import annotations

from schemas.episode import Composition
from schemas.program import Program

__all__ = ["composition", "leaves_below"]


def leaves_below(program: Program, target: int) -> tuple[int, ...]:
    """Indices of the leaves under a branch's target (a branch if ≥ 0, else the leaf ``-1 - target``)."""
    if target < 0:
        return (-1 - target,)
    branch = program.branches[target]
    return leaves_below(program, branch.then) + leaves_below(program, branch.otherwise)


def composition(program: Program) -> Composition:
    """C0: every room named is the same. C2: for some branch, the room of its condition, the rooms of the goals below
    its THEN and those below its ELSE are disjoint. C1: all else."""
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
