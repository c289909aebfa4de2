"""Counterfactual groups: four programs of one skeleton, with a condition's truth flipped and two leaves exchanged.

A guesser that ignores the condition gets at most half of the four right, and so does one that always prefers some
object. All four share one start. Each has the stops of all others, so if one can be placed, all can.
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
"""The program; with the condition flipped; with the leaves exchanged; with both."""


def counterfactual_group(
    program: Program, condition_sampler: ConditionSampler, draws: Draws, vocabulary: Vocabulary
) -> Group | None:
    """Return the group of `program`; None if no condition on its gold path has a twin.

    The flipped condition is on the gold path, and its flip changes the gold leaf. The last such condition is preferred,
    since it decides between the fewest leaves. The exchanged leaves are the gold ones before and after the flip.
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
    """Yield (condition, leaf) for each condition on the gold path whose flip leads to another leaf: the index of the
    condition, and that other leaf. The last condition comes first.
    """
    truths = [condition.truth for condition in program.conditions]
    for index in reversed(program.route()[0]):
        turned = [*truths[:index], not truths[index], *truths[index + 1 :]]
        leaf = program.gold_leaf(turned)
        if leaf != program.gold_leaf():
            yield index, leaf


def flipped(program: Program, index: int, twin: Condition) -> Program:
    """Return `program` with condition `index` replaced by `twin`, which has the opposite truth."""
    conditions = (*program.conditions[:index], twin, *program.conditions[index + 1 :])
    return Program(category=program.category, conditions=conditions, branches=program.branches, leaves=program.leaves)


def swapped(program: Program, one: int, other: int) -> Program:
    """Return `program` with the leaves at the indices `one` and `other` exchanged."""
    leaves = list(program.leaves)
    leaves[one], leaves[other] = leaves[other], leaves[one]
    return Program(
        category=program.category,
        conditions=program.conditions,
        branches=program.branches,
        leaves=tuple(leaves),
    )


def group_id(family: str, scene_id: str, group: Group) -> str:
    """Return the id of a group; all programs of the group share the id."""
    keys = "\x1f".join(sorted(program_key(program) for program in group))
    return hashlib.sha256(f"{family}\x1f{scene_id}\x1f{keys}".encode()).hexdigest()[:ID_LENGTH]
