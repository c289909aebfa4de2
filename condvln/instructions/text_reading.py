"""The meaning of a text in words only: the program without ids, truths and witnesses.

Text and program agree if ``reading_of(program, …) == parse(text, …)``.
"""

from __future__ import annotations

from dataclasses import dataclass

from condvln.instructions.language import language
from schemas.program import Category, Condition, ObjectRef, Predicate, Program, RoomRef

__all__ = ["Phrase", "Place", "Reading", "reading_of"]


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


def reading_of(program: Program, heading: str | None = None) -> Reading:
    """Return the reading that every rendering of `program` must have.

    Rooms that text does not name (an apartment as a single room) are None, as the parser returns them.
    """
    return Reading(
        category=program.category,
        conditions=tuple(_phrase(condition) for condition in program.conditions),
        leaves=tuple(tuple(_phrase(move) for move in leaf.moves) for leaf in program.leaves),
        heading=heading,
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
