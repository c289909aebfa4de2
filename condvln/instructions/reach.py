"""Decide whether "that bedroom" is near enough to the words that named the bedroom by a thing in it."""

from __future__ import annotations

from functools import cache
from typing import Final, NamedTuple

from condvln.instructions.language import Slot
from schemas.program import SHAPES, Category

__all__ = ["MOST_STEPS", "Mention", "within_reach"]

MOST_STEPS: Final = 2
"""Largest number of leaves, full stops, colons, semicolons and question marks between a room's name and "that
bedroom".
"""


class Mention(NamedTuple):
    """The place where a text names a room: the slot, and the number of leaves and marks before it."""

    slot: Slot
    steps: int


def within_reach(category: Category, earlier: Mention, later: Mention) -> bool:
    """Return whether `later` may refer to a room that `earlier` named: both are in the same leaf, or `earlier` is in a
    condition that is asked before the leaf or condition of `later` is reached, and few steps are between them.
    """
    if later.steps - earlier.steps > MOST_STEPS:
        return False
    if earlier.slot.form == "leaf":
        return later.slot == earlier.slot
    conditions, leaves = _paths(category)
    return earlier.slot.index in (leaves if later.slot.form == "leaf" else conditions)[later.slot.index]


@cache
def _paths(category: Category) -> tuple[tuple[frozenset[int], ...], tuple[frozenset[int], ...]]:
    """Return the conditions asked on the way to each condition (itself included), and to each leaf."""
    shape = SHAPES[category]
    conditions: dict[int, frozenset[int]] = {}
    leaves: dict[int, frozenset[int]] = {}
    ahead = [(0, frozenset[int]())]
    while ahead:
        at, asked = ahead.pop()
        if at < 0:
            leaves[-1 - at] = asked
            continue
        branch = shape.branches[at]
        asked |= {branch.condition}
        conditions[branch.condition] = asked
        ahead += [(branch.then, asked), (branch.otherwise, asked)]
    return tuple(conditions[k] for k in sorted(conditions)), tuple(leaves[k] for k in sorted(leaves))
