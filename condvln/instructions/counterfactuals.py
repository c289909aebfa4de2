"""Counterfactual groups: one skeleton, a condition's truth flipped, two leaves' stops exchanged.

Of the four programs of a group, a reader who ignores the condition gets at most half right, and one who always prefers
some object too. They share one start: each has the stops of all the others, so that where one can be placed, all can.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

from condvln.instructions.condition_sampler import ConditionSampler
from condvln.instructions.degeneracy import degeneracies
from condvln.instructions.programs import ID_LENGTH, program_key
from condvln.labels import Vocabulary
from condvln.seeding import Draws
from schemas.program import Condition, Program

__all__ = ["Group", "counterfactual_group", "flipped", "group_id", "swapped"]

Group = tuple[Program, Program, Program, Program]
"""The program; its condition flipped; its leaves exchanged; both."""


def counterfactual_group(
    program: Program, condition_sampler: ConditionSampler, draws: Draws, vocabulary: Vocabulary
) -> Group | None:
    """The group of `program`; None where no condition on its route has a twin.

    The condition is one that the gold route asks and whose flip changes the gold leaf, the last such first: it decides
    between the fewest leaves. The leaves exchanged are the gold ones before and after the flip.
    """
    for index, leaf in _decisive(program):
        twin = condition_sampler.twin(program, index, draws)
        if twin is not None:
            other = flipped(program, index, twin)
            group = (
                program,
                other,
                swapped(program, program.gold_leaf(), leaf),
                swapped(other, program.gold_leaf(), leaf),
            )
            if not any(degeneracies(member, vocabulary) for member in group):
                return group
    return None


def _decisive(program: Program) -> Iterator[tuple[int, int]]:
    """Conditions on the gold route, last first, with the leaf that their flip leads to."""
    truths = [condition.truth for condition in program.conditions]
    for index in reversed(program.route()[0]):
        turned = [*truths[:index], not truths[index], *truths[index + 1 :]]
        leaf = program.gold_leaf(turned)
        if leaf != program.gold_leaf():
            yield index, leaf


def flipped(program: Program, index: int, twin: Condition) -> Program:
    """`program` with one condition replaced by its twin of the opposite truth."""
    conditions = (*program.conditions[:index], twin, *program.conditions[index + 1 :])
    return Program(category=program.category, conditions=conditions, branches=program.branches, leaves=program.leaves)


def swapped(program: Program, one: int, other: int) -> Program:
    """`program` with two leaves exchanged."""
    leaves = list(program.leaves)
    leaves[one], leaves[other] = leaves[other], leaves[one]
    return Program(
        category=program.category,
        conditions=program.conditions,
        branches=program.branches,
        leaves=tuple(leaves),
    )


def group_id(family: str, scene_id: str, group: Group) -> str:
    """Id of a group; the same whichever of its programs it was made from in this order."""
    keys = "\x1f".join(sorted(program_key(program) for program in group))
    return hashlib.sha256(f"{family}\x1f{scene_id}\x1f{keys}".encode()).hexdigest()[:ID_LENGTH]
