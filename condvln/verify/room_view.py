"""One room with its objects, and what words may mean there: which objects a label might mean, which of them are
visible, and which labels are known to be absent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Set
from functools import cached_property

from condvln.kept import kept
from condvln.scene import Room, SceneObject
from condvln.verify.containment import FROM_SCANS
from condvln.verify.likeness import (
    has_fallen,
    is_odd_sized,
    is_part,
    looks_like,
    may_be_one,
    may_be_twins,
    may_be_two,
    passes_for_a_counter,
    passes_for_a_side_table,
    passes_for_another_screen,
)
from condvln.verify.surroundings import Said, Surroundings, Thing
from condvln.verify.words import Words
from schemas.config import Thresholds

__all__ = ["RoomView", "longest_side", "model_of"]


class RoomView:
    """One room with its objects, whose labels are derived again from their raw labels.

    things : all objects except those inside something shut; some may not be visible
    astride : ids of objects that may belong to another room; foreign : labels of those of other rooms that may belong
        to this one
    """

    def __init__(
        self,
        room: Room,
        label: str,
        objects: Iterable[SceneObject],
        family: str,
        meaning: Words,
        hidden: Set[str],
        can_be_seen: Callable[[str], bool],
        thresholds: Thresholds,
        said: Said,
        astride: Set[str] = frozenset(),
        foreign: Set[str] = frozenset(),
    ) -> None:
        self.room = room
        self.label = label
        self._hidden, self._can_be_seen = hidden, can_be_seen
        ordered = sorted(objects, key=lambda item: item.object_id)
        things = [Thing.of(item, meaning.label(item.raw_label, family, model_of(item))) for item in ordered]
        self.things = tuple(thing for thing in things if thing.object_id not in hidden)
        self._all = tuple(things)
        self.surroundings = Surroundings(things, room.floor_y, thresholds, said)
        self._meaning, self._family = meaning, family
        self._named: dict[str, tuple[Thing, ...]] = {}
        self._open: dict[str, frozenset[str]] = {}
        self._vague: dict[str, frozenset[str]] = {}
        self._confused: dict[str, frozenset[str]] = {}
        for thing in things:
            labels, anything = meaning.may_be(thing.label, family, longest_side(thing))
            if passes_for_a_counter(thing, meaning.roles["worktop"], things, room.floor_y):
                labels |= {"counter"}
            if passes_for_a_side_table(thing, meaning.roles["worktop"]):
                labels |= {"side table"}
            alike = (x.label for x in things if anything and self._is_named(x) and looks_like(thing, x))
            self._open[thing.object_id] = frozenset(alike) if anything else labels
            low = thing.box is not None and thing.box[1][1] - thing.box[0][1] <= max(thing.ground_sides())
            self._vague[thing.object_id] = labels
            self._confused[thing.object_id] = meaning.also_called(thing.label, low=low)
        self._fallen = frozenset(thing.object_id for thing in things if has_fallen(thing, room.floor_y))
        roles, self.foreign = meaning.roles, foreign
        self._parts = frozenset(x.object_id for x in things if is_part(x, things, roles["part"], meaning.nouns))
        self._unclear = astride | {
            x.object_id
            for x in things
            if may_be_two(x, roles["seat"], family)
            or passes_for_another_screen(x, things, roles["screen"], roles["desktop"], family)
            or is_odd_sized(x, meaning.sizes, family)
        }

    @cached_property
    def labels(self) -> frozenset[str]:
        """Labels of the objects that are not in a shut container."""
        return frozenset(thing.label for thing in self.things)

    @kept
    def meant(self, label: str) -> tuple[Thing, ...]:
        """Return all visible objects that a word for `label` might mean."""
        return tuple(thing for thing in self._called(label) if self.is_seen(thing))

    def unknown(self, label: str) -> tuple[Thing, ...]:
        """Return all invisible objects that a word for `label` might mean; they can't be claimed to be absent."""
        return tuple(thing for thing in self._called(label) if not self.is_seen(thing))

    def is_seen(self, thing: Thing) -> bool:
        """Return whether an object is visible as an object of its own: neither inside something shut nor part of other
        furniture, and visible from where an agent can stand.
        """
        if thing.object_id in self._hidden or thing.object_id in self._parts:
            return False
        return self._can_be_seen(thing.object_id)

    def is_clear(self, thing: Thing) -> bool:
        """Return whether an object is surely in this room only, and surely what its label says."""
        return thing.object_id not in self._unclear

    def has_twin(self, thing: Thing) -> Thing | None:
        """Return another visible object that a word for `thing` might mean and whose size can't be compared with the
        size of `thing`, since one of the two may be scanned only in part, or is not clear (`is_clear`) in a scan; None
        if there is none.
        """
        scanned = self._family in FROM_SCANS
        for other in self.meant(thing.label):
            unclear = scanned and not self.is_clear(other)
            if other is not thing and (unclear or may_be_twins(thing, other, self._family)):
                return other
        return None

    def may_be_foreign(self, label: str) -> bool:
        """Return whether a word for `label` might mean an object of another room that extends into this room."""
        return not self._meaning.meant_by(label).isdisjoint(self.foreign)

    def is_itself(self, thing: Thing) -> bool:
        """Return whether an object is what people expect under its name: it has not fallen over, and it is clear
        (`is_clear`).
        """
        return thing.object_id not in self._fallen and self.is_clear(thing)

    def double(self, thing: Thing) -> Thing | None:
        """Return another object whose box may belong to the same real object as `thing`, or None."""
        for other in self._all:
            if other is thing or not may_be_one(thing, other, self._family):
                continue
            if self._could_call(thing.label, other) or self._could_call(other.label, thing):
                return other
        return None

    def _is_named(self, thing: Thing) -> bool:
        return not self._meaning.may_be(thing.label, self._family, None)[1]

    def _could_call(self, label: str, thing: Thing) -> bool:
        own = self._meaning.meant_by(label)
        return thing.label in own or bool(own & self._open[thing.object_id])

    def _called(self, label: str) -> tuple[Thing, ...]:
        """Return all objects that a word for `label` might mean, visible or not."""
        found = self._named.get(label)
        if found is None:
            own = self._meaning.meant_by(label)
            found = self._named[label] = tuple(
                [x for x in self._all if x.label in own or not own.isdisjoint(self._open[x.item.object_id])]
            )
        return found

    def nameless(self, label: str) -> list[Thing]:
        """Return the unlabelled objects that, as far as is known, might have the label `label`; in a scan, those too
        that some people would call so.
        """
        own = self._meaning.meant_by(label)
        others = self.confused(label) if self._family in FROM_SCANS else ()
        return [thing for thing in self._all if own & self._vague[thing.object_id] or thing in others]

    def confused(self, label: str) -> list[Thing]:
        """Return the objects with another label that some people would call `label`."""
        own = self._meaning.meant_by(label)
        return [thing for thing in self._all if own & self._confused[thing.object_id]]

    def knows_absence(self, label: str) -> bool:
        """Return whether absence of `label` can be known: no unlabelled object might have this label, nobody would call
        another object so, it is no fixture of such rooms, and the annotation is complete.
        """
        if not self.is_complete or self.has_always(label) or self.confused(label):
            return False
        return not self.nameless(label) and not self.may_be_foreign(label)

    @cached_property
    def is_complete(self) -> bool:
        """Whether the annotation of the room is complete. A scan's room without what its type requires is not."""
        if not self.room.complete or self._family not in FROM_SCANS:
            return self.room.complete
        there = {thing.label for thing in self._all}
        needed = (label for label, required in self._meaning.fixtures.get(self.label, {}).items() if required)
        return all(there & self._meaning.meant_by(label) for label in needed)

    def has_always(self, label: str) -> bool:
        """Return whether nearly every room of this type has a `label`, so that a scan that shows none proves
        nothing.
        """
        fixtures = self._meaning.fixtures
        return self._family in FROM_SCANS and (label in fixtures[""] or label in fixtures.get(self.label, {}))

    def only(self, label: str) -> Thing | None:
        """Return the object with this label if no other visible object could be meant, else None."""
        if self.may_be_foreign(label):
            return None
        found = self.meant(label)
        return found[0] if len(found) == 1 and found[0].label == label and self.is_itself(found[0]) else None


def longest_side(thing: Thing) -> float | None:
    """Return the longest side in metres; None if the extent is unknown."""
    if thing.box is None:
        return None
    low, high = thing.box
    return max(b - a for a, b in zip(low, high, strict=True)) / 1000.0


def model_of(item: SceneObject) -> str:
    """Return the model name in an object's id, if the id consists of a model name and the number of the copy; else an
    empty text.
    """
    return item.object_id.rpartition(":")[0]
