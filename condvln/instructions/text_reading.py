"""What a text says, by words alone: the program without ids, truths and witnesses.

A text and its program agree when ``reading_of(program, …) == parse(text, …)``.
"""

from __future__ import annotations

from dataclasses import dataclass

from condvln.instructions.language import language
from schemas.program import Category, Condition, ObjectRef, Predicate, Program, RoomRef

__all__ = ["Phrase", "Place", "Reading", "reading_of"]


@dataclass(frozen=True, slots=True)
class Place:
    """A room as named: its label, and the label of the object that distinguishes it."""

    label: str
    anchor: str | None = None


@dataclass(frozen=True, slots=True)
class Phrase:
    """A noun phrase: label, qualifier as (predicate, anchors' labels), and the room; None where the text names none.

    definite : of a condition, whether it is about one definite thing ("the lamp is near the bed")
    """

    label: str
    qualifier: tuple[Predicate, tuple[str, ...]] | None = None
    room: Place | None = None
    definite: bool = False


@dataclass(frozen=True, slots=True)
class Reading:
    """The tree of a text: conditions in program order and leaves as sequences of stops."""

    category: Category
    conditions: tuple[Phrase, ...]
    leaves: tuple[tuple[Phrase, ...], ...]
    heading: str | None = None


def reading_of(program: Program, heading: str | None = None) -> Reading:
    """The reading that every rendering of `program` must have.

    Rooms that text doesn't name (a whole apartment as one room) are None, as the parser leaves them.
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
    # A stop that goes by its bearing is in the room of the start, which text does not name.
    place = None if isinstance(named, ObjectRef) and named.is_bearing else _place(named.room)
    return Phrase(named.label, stated, place, isinstance(named, Condition) and named.definite)


def _place(room: RoomRef) -> Place | None:
    # Whether a room has a name fit for text doesn't depend on the language.
    return Place(room.label, room.anchor_label) if room.label in language().rooms else None
