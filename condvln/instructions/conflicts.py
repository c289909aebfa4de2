"""Which statements about a scene can't be asked in a text, by the rules of ``degeneracy.clash``, for all statements at
once.

A set of statements is an integer: bit k is 1 if statement k is in it. So a text of a dozen phrases is compared with
hundreds of statements by a few operations on integers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Final

from condvln.instructions.degeneracy import Claim
from condvln.kept import kept
from condvln.labels import Vocabulary

__all__ = ["RULES", "Conflicts", "Phrase", "RuledOut", "members"]

RULES: Final = ("tautology", "circular", "names_stop", "given_away", "implied", "one_label", "two_things")
"""The rules of ``degeneracy.clash``, in the order in which they are checked."""

BySet = Mapping[str, int]
"""Sets of statements by the rule that excludes them."""


Phrase = tuple[str, str | None, str, tuple[str, ...]]
"""The phrase of a stop: its room, the label of the thing that names the room or None, its label, and those of the
anchors of its qualifier.
"""


def members(numbers: int) -> Iterator[int]:
    """Yield the members of a set, ascending."""
    while numbers:
        lowest = numbers & -numbers
        yield lowest.bit_length() - 1
        numbers ^= lowest


class Conflicts:
    """The statements of a scene, and what excludes them.

    Parameters
    ----------
    statements : what each statement claims; the name of its room is not known yet
    """

    def __init__(self, statements: Sequence[Claim], vocabulary: Vocabulary) -> None:
        self.statements, self.vocabulary = statements, vocabulary
        self.presence = self.placed = 0
        self._in_room: dict[str, int] = {}
        self._labelled: dict[str, int] = {}
        self._anchored: dict[str, int] = {}
        for k, claim in enumerate(statements):
            bit = 1 << k
            if claim.presence:
                self.presence |= bit
            if claim.placed:
                self.placed |= bit
            for sets, key in (
                (self._in_room, claim.room_id),
                (self._labelled, claim.label),
                *((self._anchored, anchor) for anchor in claim.anchors),
            ):
                sets[key] = sets.get(key, 0) | bit

    @cached_property
    def self_contradictory(self) -> int:
        """The statements with one word for the object and its anchor."""
        about = self.about
        return sum(1 << k for k, c in enumerate(self.statements) if any(about(x)[0] >> k & 1 for x in c.anchors))

    def in_room(self, room_id: str) -> int:
        """Return the statements about a room."""
        return self._in_room.get(room_id, 0)

    @kept
    def about(self, label: str) -> tuple[int, int]:
        """Return the statements whose object, and those one of whose anchors, a word for `label` might mean."""
        objects = anchors = 0
        for word in self.vocabulary.overlapping(label):
            objects |= self._labelled.get(word, 0)
            anchors |= self._anchored.get(word, 0)
        return objects, anchors

    @kept
    def by_stop(self, stop: Phrase) -> BySet:
        """Return the statements that the phrase of a stop excludes."""
        room_id, room_anchor, label, anchors = stop
        here = self.in_room(room_id)
        objects, related = self.about(label)
        given_away = two_things = 0
        for thing in (label, *anchors, *(() if room_anchor is None else (room_anchor,))):
            as_object, as_anchor = self.about(thing)
            given_away |= self.presence & as_object
            two_things |= ~here & (as_object | as_anchor)
        for anchor in anchors:
            as_object, as_anchor = self.about(anchor)
            given_away |= here & (objects & as_anchor | related & as_object)
        names_stop = objects & (self.presence | here)
        return {"names_stop": names_stop, "given_away": given_away, "two_things": two_things}

    def by_room_name(self, room_id: str, anchor: str) -> BySet:
        """Return the statements about a room that can't be asked since a thing names it ("the bedroom with the …")."""
        here, (objects, anchors) = self.in_room(room_id), self.about(anchor)
        return {"tautology": here & objects, "circular": here & anchors}

    @kept
    def by_claim(self, claim: Claim, room_anchor: str | None, search: bool) -> BySet:
        """Return the statements that another condition of the text excludes.

        room_anchor : the label of the thing that names its room, None for a plain name
        search : conditions may look for one thing in several places (``degeneracy.searches``)
        """
        here, (objects, anchors) = self.in_room(claim.room_id), self.about(claim.label)
        implied, two_things = here & objects, 0
        for anchor in claim.anchors:
            implied |= here & self.presence & self.about(anchor)[0]
        if claim.presence:
            implied |= here & anchors
        for label in (claim.label, *claim.anchors, *(() if room_anchor is None else (room_anchor,))):
            two_things |= ~here & (self.about(label)[0] | self.about(label)[1])
        elsewhere = self._elsewhere(claim) if search else 0
        return {"implied": implied & ~elsewhere, "one_label": objects & ~elsewhere, "two_things": two_things}

    def _elsewhere(self, claim: Claim) -> int:
        """Return the statements that look for the object of a claim elsewhere in its room."""
        if not claim.placed:
            return 0
        found = self.in_room(claim.room_id) & self._labelled.get(claim.label, 0) & self.placed
        for anchor in claim.anchors:
            found &= ~self.about(anchor)[1]
        return found


class RuledOut:
    """The statements that a text excludes: first by the phrases of its stops, then also by its conditions.

    Parameters
    ----------
    stops : the phrases of the text's stops
    rooms : the label of the thing that names each room of the text, None for a plain name, by room id
    search : conditions may look for one thing in several places (``degeneracy.searches``)

    Attributes
    ----------
    by_rule : the excluded statements by rule
    """

    def __init__(
        self, conflicts: Conflicts, stops: Iterable[Phrase], rooms: Mapping[str, str | None], *, search: bool = False
    ) -> None:
        self._conflicts, self._rooms, self._search = conflicts, rooms, search
        self.by_rule = dict.fromkeys(RULES, 0)
        self.by_rule["tautology"] = conflicts.self_contradictory
        self._linked: list[tuple[str, frozenset[str]]] = []
        for room_id, room_anchor, label, anchors in stops:
            self._exclude(conflicts.by_stop((room_id, room_anchor, label, anchors)))
            self._exclude_rooms(room_id, (label, *anchors, room_anchor))
        for room_id, anchor in rooms.items():
            if anchor is not None:
                self._exclude(conflicts.by_room_name(room_id, anchor))

    @property
    def union(self) -> int:
        """The statements that some rule excludes."""
        found = 0
        for statements in self.by_rule.values():
            found |= statements
        return found

    def add(self, claim: Claim) -> None:
        """Add a condition to the text."""
        anchor = self._rooms.get(claim.room_id)
        self._exclude(self._conflicts.by_claim(claim, anchor, self._search))
        self._exclude_rooms(claim.room_id, (claim.label, *claim.anchors, anchor))
        if claim.anchors:
            self._exclude_cycles(claim)

    def _exclude_cycles(self, claim: Claim) -> None:
        """Exclude the statements whose relation closes a cycle with those of the conditions: they relate two things
        that the conditions link already (see ``degeneracy``).
        """
        labels = frozenset((claim.label, *claim.anchors))
        words = frozenset().union(*map(self._conflicts.vocabulary.overlapping, labels))
        joined = [one for room_id, one in self._linked if room_id == claim.room_id and not words.isdisjoint(one)]
        labels = labels.union(*joined)
        self._linked = [
            (room_id, one) for room_id, one in self._linked if one not in joined or room_id != claim.room_id
        ]
        self._linked.append((claim.room_id, labels))
        objects = anchors = 0
        for label in labels:
            as_object, as_anchor = self._conflicts.about(label)
            objects |= as_object
            anchors |= as_anchor
        self.by_rule["implied"] |= self._conflicts.in_room(claim.room_id) & objects & anchors

    def _exclude_rooms(self, room_id: str, labels: Iterable[str | None]) -> None:
        """Exclude all statements about each other room whose name relies on a thing that a word for one of the `labels`
        might mean too.
        """
        for other, anchor in self._rooms.items():
            if anchor is not None and other != room_id:
                words = self._conflicts.vocabulary.overlapping(anchor)
                if any(label in words for label in labels):
                    self.by_rule["two_things"] |= self._conflicts.in_room(other)

    def _exclude(self, excluded: BySet) -> None:
        for rule, statements in excluded.items():
            self.by_rule[rule] |= statements
