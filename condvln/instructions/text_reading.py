"""The meaning of a text in words only: the program without ids, truths and witnesses; and whether "that bedroom" is
near enough to the words that named the bedroom by a thing in it.

Text and program agree if ``reading_of(program, …) == parse(text, …)``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

from condvln.instructions.language import Slot, language
from schemas.program import Category, Condition, ObjectRef, Predicate, Program, RoomRef, leaf_truths

__all__ = ["MOST_STEPS", "Mention", "Phrase", "Place", "Reading", "last_lead", "reading_of", "within_reach"]


@dataclass(frozen=True, slots=True)
class Place:
    """A room as a text names it: the room's label, and the label of the object that distinguishes the room."""

    label: str
    anchor: str | None = None


@dataclass(frozen=True, slots=True)
class Phrase:
    """A noun phrase: the label, the qualifier as (predicate, labels of the anchors), and the room. Qualifier and room
    are None if the text does not state them.

    definite : for a condition, whether it is about one definite object ("the lamp is near the bed")
    """

    label: str
    qualifier: tuple[Predicate, tuple[str, ...]] | None = None
    room: Place | None = None
    definite: bool = False


@dataclass(frozen=True, slots=True)
class Reading:
    """The meaning of a text: conditions in program order and leaves as sequences of stops."""

    category: Category
    conditions: tuple[Phrase, ...]
    leaves: tuple[tuple[Phrase, ...], ...]
    heading: str | None = None
    leads: tuple[Place | None, ...] = ()
    """by condition, the room to go to before it is decided"""


def reading_of(program: Program, heading: str | None = None) -> Reading:
    """Return the reading that every rendering of `program` must have.

    Rooms that text does not name (an apartment as a single room) are None, as the parser returns them.
    """
    return Reading(
        category=program.category,
        conditions=tuple(_phrase(condition) for condition in program.conditions),
        leaves=tuple(tuple(_phrase(move) for move in leaf.moves) for leaf in program.leaves),
        heading=heading,
        leads=tuple(None if branch.lead is None else _place(branch.lead) for branch in program.branches),
    )


def _phrase(named: Condition | ObjectRef) -> Phrase:
    qualifier = named.qualifier
    stated = None if qualifier is None else (qualifier.predicate, qualifier.anchor_labels)
    # A stop with an egocentric direction is in the room of the start, which text does not name.
    place = None if isinstance(named, ObjectRef) and named.is_bearing else _place(named.room)
    return Phrase(named.label, stated, place, isinstance(named, Condition) and named.definite)


def _place(room: RoomRef) -> Place | None:
    # Whether a room's name is fit for text does not depend on the language.
    return Place(room.label, room.anchor_label) if room.label in language().rooms else None


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


def last_lead(category: Category, condition: int, leads: Mapping[int, Place]) -> Place | None:
    """Return the room to which the last of the leads sends one before a condition is decided; None if none does."""
    led = _paths(category)[0][condition] & leads.keys()
    return leads[max(led)] if led else None


@cache
def _paths(category: Category) -> tuple[tuple[frozenset[int], ...], tuple[frozenset[int], ...]]:
    """Return the conditions asked on the way to each condition (itself included), and to each leaf."""
    ways = [[condition for condition, _ in way] for way in leaf_truths(category)]
    conditions = {way[k]: frozenset(way[: k + 1]) for way in ways for k in range(len(way))}
    return tuple(conditions[k] for k in sorted(conditions)), tuple(map(frozenset, ways))
