"""What the text of a program names: its rooms, and which labels occur in one place only."""

from __future__ import annotations

from dataclasses import dataclass

from schemas.program import Condition, ObjectRef, Program, RoomRef

__all__ = ["Naming", "labels_of"]


@dataclass(frozen=True, slots=True)
class Naming:
    """The rooms and labels that a text names.

    rooms : the rooms
    shared : labels that are named in several rooms
    asked_once : labels that one condition asks about
    asked_only : those of them that are named nowhere else, so that their noun alone stands for the condition
    """

    rooms: tuple[RoomRef, ...] = ()
    shared: frozenset[str] = frozenset()
    asked_once: frozenset[str] = frozenset()
    asked_only: frozenset[str] = frozenset()

    @classmethod
    def of(cls, program: Program) -> Naming:
        """Return what the text of a program names."""
        moves = [move for leaf in program.leaves for move in leaf.moves]
        named_things: list[Condition | ObjectRef] = [*program.conditions, *moves]
        rooms = {named.room.room_id: named.room for named in named_things}
        asked = [condition.label for condition in program.conditions]
        once = frozenset([label for label in asked if asked.count(label) == 1])
        elsewhere: set[str] = set()
        for move in moves:
            elsewhere.update(labels_of(move))
        for condition in program.conditions:
            elsewhere.update(labels_of(condition)[1:])
        shared = _shared(named_things) if len(rooms) > 1 else frozenset()
        return cls(tuple(rooms.values()), shared, once, once - elsewhere)

    def is_shared(self, named: Condition | ObjectRef) -> bool:
        """Return whether objects with one of the labels of `named` are also named in another room, so that the room
        must be said.
        """
        return bool(self.shared) and not self.shared.isdisjoint(labels_of(named))

    def has_article(self, condition: Condition) -> bool:
        """Return whether a condition can be repeated by its noun alone, with the indefinite article."""
        return not condition.definite and condition.label in self.asked_only


def labels_of(named: Condition | ObjectRef) -> tuple[str, ...]:
    """Return the labels of an object and of its anchors."""
    return (named.label, *(named.qualifier.anchor_labels if named.qualifier is not None else ()))


def _shared(named_things: list[Condition | ObjectRef]) -> frozenset[str]:
    """Return the labels that are named in several rooms."""
    room_of: dict[str, str] = {}
    shared = set()
    for named in named_things:
        for label in labels_of(named):
            if room_of.setdefault(label, named.room.room_id) != named.room.room_id:
                shared.add(label)
    return frozenset(shared)
