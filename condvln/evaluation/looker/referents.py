"""What the looker agent knows of the rooms and objects that a text names, and how it answers the text's conditions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from condvln.evaluation.looker.judging import gap, holds
from condvln.evaluation.looker.memory import Memory, Thing
from condvln.instructions.text_reading import Phrase, Place
from schemas.config import Thresholds
from schemas.program import BEARINGS

__all__ = ["Referents"]

BY_SURFACES: Final = frozenset(("near", "on", "in", "above", "below", "between"))
"""Relations that may become true when more is seen of the same things."""
APART: Final = 1.5
"""Distance in metres between what is seen of two things at which neither touches or is near the other."""


class Referents:
    """The rooms and objects in the agent's memory that phrases of the text may mean.

    Parameters
    ----------
    north : direction of north in degrees, None if the text does not tell
    close : metres from which a thing must have been seen to be judged

    Attributes
    ----------
    start_room : number of the room of the start, -1 before the first view
    """

    def __init__(self, memory: Memory, north: float | None, close: float) -> None:
        self.memory = memory
        self.start_room = -1
        self._north, self._close = north, close
        self._t = Thresholds()

    def rooms(self, phrase: Phrase) -> set[int] | None:
        """Return the numbers of the known rooms that a phrase may mean; None if it may mean every room."""
        if phrase.room is None:
            at_start = phrase.qualifier is not None and phrase.qualifier[0] in BEARINGS
            return {self.start_room} if at_start and self.start_room >= 0 else None
        return self._rooms_of(phrase.room)

    def _rooms_of(self, place: Place) -> set[int]:
        rooms = {number for number, label in self.memory.rooms.items() if label == place.label}
        if place.anchor is not None:
            held = {thing.room for thing in self.memory if thing.label == place.anchor}
            rooms = rooms & held or rooms
        return rooms

    def room_is_sure(self, phrase: Phrase) -> bool:
        """Return whether it is certain which room a phrase means. A phrase may tell the room by an object in it; then
        that object must have been seen in a room of the type that the phrase names.
        """
        place = phrase.room
        if place is None or place.anchor is None:
            return True
        return any(
            thing.label == place.anchor and self.memory.rooms.get(thing.room) == place.label for thing in self.memory
        )

    def known(self, label: str, rooms: set[int] | None) -> list[Thing]:
        """Return the known objects with a label in some rooms; in any room if `rooms` is None."""
        return [thing for thing in self.memory if thing.label == label and (rooms is None or thing.room in rooms)]

    def anchors(self, labels: Sequence[str], rooms: set[int] | None) -> tuple[Thing, ...] | None:
        """Return, for each label, the known object of which most was seen; None if no object is known for one of the
        labels.
        """
        found: list[Thing] = []
        for label in labels:
            known = [thing for thing in self.known(label, rooms) if thing not in found]
            if not known:
                return None
            found.append(max(known, key=lambda thing: len(thing.cubes)))
        return tuple(found)

    def is_close(self, thing: Thing) -> bool:
        """Return whether an object was seen from near enough to be judged."""
        return thing.nearest <= self._close

    def lacks(self, phrase: Phrase) -> bool:
        """Return whether a thing that a condition takes for granted, such as "the lamp" in "if the lamp is near the
        bed", has not been seen from near enough to be judged.
        """
        if not phrase.definite:
            return False
        labels = (phrase.label, *(phrase.qualifier[1] if phrase.qualifier else ()))
        rooms = self.rooms(phrase)
        return any(not any(map(self.is_close, self.known(label, rooms))) for label in labels)

    def scores(self, phrase: Phrase, things: Sequence[Thing], anchors: Sequence[Thing]) -> list[tuple[float, Thing]]:
        """Return the objects that are not anchors themselves, each with a number that is positive if the relation of
        `phrase` holds for it.
        """
        assert phrase.qualifier is not None
        predicate = phrase.qualifier[0]
        return [(holds(predicate, thing, anchors, self._north, self._t), thing) for thing in things
                if thing not in anchors]  # fmt: skip

    def judge(self, phrase: Phrase) -> tuple[bool | None, bool]:
        """Return two answers to the condition in `phrase`: the certain one (None if what was seen so far is not
        enough), and the one to give if nothing more can be seen.
        """
        rooms = self.rooms(phrase)
        things = self.known(phrase.label, rooms)
        if phrase.qualifier is None:
            return (True, True) if things and rooms is not None and self.room_is_sure(phrase) else (None, bool(things))
        predicate, labels = phrase.qualifier
        if predicate in BEARINGS:
            if not things:
                return None, False
            best = max(score for score, _ in self.scores(phrase, things, ()))
            return (best > 0 if self.is_close(things[0]) else None), best > 0
        anchors = self.anchors(labels, rooms)
        if anchors is None or not things:
            return None, False
        scores = [score for score, _ in self.scores(phrase, things, anchors)]
        if not scores:
            return None, False
        sure = all(self.is_close(thing) for thing in (*anchors, *things)) and self.room_is_sure(phrase)
        if max(scores) > 0:
            return (True if sure else None), True
        # More of the same things may be seen, but not so much more.
        settled = predicate not in BY_SURFACES or min(gap(thing, anchors[0]) for thing in things) > APART
        return (False if sure and settled and phrase.definite else None), False
