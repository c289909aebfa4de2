"""What text may call an object: by its label where that is unique in the room, else by label and qualifier.

A qualifier is *necessary* (without it the phrase fits a rival too) and *sufficient* (every rival fails the predicate
at the loose threshold, so that none lies in the dead zone). A rival is an object of the room whose label a speaker
might use for this one as well: same label, synonym, hypernym or hyponym, or a thing of no label that may bear it. What
may be anything at all ("unknown") is nobody's rival: it only keeps the room from being said to lack something.

What nobody can see is unknown: text never names it, and it is not a rival of what is seen. It may still be there, so
that nothing that a word for it might mean is said to be absent. Where it is in doubt whether one can be seen, no word
that might mean it is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.predicates import PREDICATE_GROUPS
from condvln.labels import Vocabulary
from condvln.scene import Room, RoomArrays
from condvln.scene.sightings import EVERYTHING_SEEN, Sightings
from schemas.program import ObjectRef, Predicate, Qualifier, RoomRef

__all__ = ["ALTERNATIVES", "Facts", "Qualification", "Referents", "object_refs", "room_refs"]

ALTERNATIVES: Final = 2
"""Qualifiers kept per object and predicate group, those of largest margin; enough for texts to differ."""

ROOM_NAMES: Final = 6
"""Names kept per room: some of them may rest on what a program visits there."""

Bools = NDArray[np.bool_]


class Facts(Protocol):
    """Which predicates text may use of the objects of one room, in the order of ``RoomArrays.object_ids``.

    status[p][i, j] : +1 where "i p j" holds with margin, −1 where it fails with margin, 0 in the dead zone
    margin[p][i, j] : how far it is from its threshold, comparable within one predicate
    """

    @property
    def status(self) -> Mapping[str, NDArray[np.int8]]: ...

    @property
    def margin(self) -> Mapping[str, NDArray[np.float64]]: ...


@dataclass(frozen=True, slots=True)
class Qualification:
    """A qualifier by indices: `anchor` into the room's objects."""

    predicate: Predicate
    anchor: int
    margin: float


@dataclass(frozen=True, eq=False)
class Referents:
    """The names that one room's objects may go by.

    rival (n, n) : j can be seen and could be meant by i's label
    nameable (n,) : can be seen, the label is fit for text, and no word for it might mean a thing in doubt
    unique (n,) : nameable without rivals; anchor (n,) : unique and of known extent; small (n,) : shorter than the
    anchor size
    may_be (n,) : labels that a thing may bear without being called so, of those that may be some things only
    open (n,) : the same of all things whose extent is known, also of those that may be anything
    blocked : labels that can't be said to be absent, since something nameless may bear them
    unplaced : those among them that something of unknown extent may bear, so that it may be near to anything
    """

    room: Room
    arrays: RoomArrays
    facts: Facts
    rival: Bools
    nameable: Bools
    unique: Bools
    anchor: Bools
    small: Bools
    may_be: tuple[frozenset[str], ...]
    open: tuple[frozenset[str], ...]
    blocked: frozenset[str]
    unplaced: frozenset[str]

    def lacks(self, label: str, vocabulary: Vocabulary) -> bool:
        """Whether it can be said that nothing in the room goes by a word for `label`."""
        meant = vocabulary.overlapping(label)
        return self.room.complete and not meant & self.blocked and meant.isdisjoint(self.arrays.labels)

    def decides(self, label: str, vocabulary: Vocabulary) -> bool:
        """Whether "a `label` near …" can be said to be false.

        It is where the one thing that the label fits is elsewhere, which claims no absence; else only where all that
        may bear the label, nameless things among it, is known and is elsewhere.
        """
        if label in self.unique_labels:
            return True
        return self.room.complete and not vocabulary.overlapping(label) & self.unplaced

    @cached_property
    def qualifications(self) -> tuple[tuple[Qualification, ...], ...]:
        """Per object the ways to make it unique, best first; none where it needs none or has none."""
        return _qualifications(self.facts, self.rival, self.nameable, self.unique, self.anchor, self.small)

    @cached_property
    def unique_labels(self) -> frozenset[str]:
        """Labels that fit one object of the room alone, under any word for them."""
        return frozenset(self.arrays.labels[i] for i in np.flatnonzero(self.unique))

    @cached_property
    def usable(self) -> Bools:
        """(n,) objects that text can name."""
        return np.asarray(self.unique | np.array([bool(q) for q in self.qualifications], dtype=bool))

    @classmethod
    def of(
        cls,
        room: Room,
        arrays: RoomArrays,
        facts: Facts,
        vocabulary: Vocabulary,
        anchor_size: float,
        family: str | None = None,
        sightings: Sightings = EVERYTHING_SEEN,
    ) -> Referents:
        """Names of all objects of a room.

        family : whose labels they are; None where each is what its label says and nothing else
        """
        seen = ~sightings.hidden(arrays)
        may_be, open_, blocked, unplaced = _nameless(arrays, vocabulary, family)
        meant = meant_by(arrays.labels, arrays.labels, may_be, vocabulary)
        nameable = np.array([vocabulary.fit_for_text(label) for label in arrays.labels], dtype=bool) & seen
        nameable &= ~meant[:, sightings.in_doubt(arrays)].any(axis=1)
        rival = meant & seen & seen[:, None]
        np.fill_diagonal(rival, False)
        unique = nameable & ~rival.any(axis=1)
        small = np.asarray(_longest_side(arrays) < anchor_size)
        return cls(
            room=room,
            arrays=arrays,
            facts=facts,
            rival=rival,
            nameable=nameable,
            unique=unique,
            anchor=unique & np.array([o.geometry != "none" for o in arrays.objects], dtype=bool),
            small=small,
            may_be=may_be,
            open=open_,
            blocked=blocked,
            unplaced=unplaced,
        )


def meant_by(
    words: Sequence[str], labels: Sequence[str], may_be: Sequence[frozenset[str]], vocabulary: Vocabulary
) -> Bools:
    """(w, n): a word for label i might mean thing j, by its label or by what it may be.

    Parameters
    ----------
    labels, may_be : of the things, (n,) each
    """
    meant = {word: vocabulary.overlapping(word) for word in words}
    found = [
        [not meant[word].isdisjoint((label, *open_)) for label, open_ in zip(labels, may_be, strict=True)]
        for word in meant
    ]
    rows = {word: row for row, word in enumerate(meant)}
    table = np.array(found, dtype=bool).reshape(len(meant), len(labels))
    return np.asarray(table[[rows[word] for word in words]])


def _nameless(
    arrays: RoomArrays, vocabulary: Vocabulary, family: str | None
) -> tuple[tuple[frozenset[str], ...], tuple[frozenset[str], ...], frozenset[str], frozenset[str]]:
    """What things may be besides what they are called: `may_be`, `open`, `blocked` and `unplaced` of `Referents`."""
    none: frozenset[str] = frozenset()
    if family is None:
        return (none,) * len(arrays), (none,) * len(arrays), none, none
    longest = np.max(arrays.aabb_max - arrays.aabb_min, axis=1, initial=-np.inf)
    known = ~np.isnan(longest)
    found = [
        vocabulary.may_be(label, family, float(side) if there else None)
        for label, side, there in zip(arrays.labels, longest, known, strict=True)
    ]
    may_be = tuple(
        none if vocabulary.is_vague(label, family) else labels
        for label, labels in zip(arrays.labels, found, strict=True)
    )
    placed = tuple(labels if there else none for labels, there in zip(found, known, strict=True))
    unplaced = none.union(*(labels for labels, there in zip(found, known, strict=True) if not there))
    return may_be, placed, none.union(*found), unplaced


def _longest_side(arrays: RoomArrays) -> NDArray[np.float64]:
    """(n,) longest side in metres; infinite where no extent is known, so that it counts as large."""
    sides = np.max(arrays.aabb_max - arrays.aabb_min, axis=1, initial=-np.inf)
    sides = np.where(np.isnan(sides), 2.0 * arrays.radius, sides)
    return np.where(np.isnan(sides), np.inf, sides)


def _qualifications(
    facts: Facts, rival: Bools, nameable: Bools, unique: Bools, anchor: Bools, small: Bools
) -> tuple[tuple[Qualification, ...], ...]:
    n = len(nameable)
    rows, anchors = np.flatnonzero(nameable & ~unique), np.flatnonzero(anchor)
    found: list[list[Qualification]] = [[] for _ in range(n)]
    if not len(rows) or not len(anchors):
        return tuple(() for _ in range(n))
    rivals = rival[rows].astype(np.float32)
    for group, predicates in PREDICATE_GROUPS.items():
        ways: list[list[tuple[bool, float, int, Predicate]]] = [[] for _ in range(len(rows))]
        for predicate in predicates:
            status = facts.status[predicate][:, anchors]
            # Rivals that the loose threshold does not exclude; a matrix product counts them for all anchors at once.
            left = rivals @ (status != -1).astype(np.float32)
            margin = facts.margin[predicate]
            for r, a in zip(*np.nonzero((status[rows] == 1) & (left == 0)), strict=True):
                by = int(anchors[a])
                ways[r].append((bool(small[by]), -float(margin[rows[r], by]), by, predicate))
        for r, options in enumerate(ways):
            kept = found[int(rows[r])]
            if (group == "height" and len(kept) >= ALTERNATIVES) or (group == "far" and kept):
                continue
            kept.extend(
                Qualification(predicate, by, -negated) for _, negated, by, predicate in sorted(options)[:ALTERNATIVES]
            )
    return tuple(tuple(kept) for kept in found)


def room_refs(referents: Sequence[Referents], vocabulary: Vocabulary) -> dict[str, tuple[RoomRef, ...]]:
    """Names of the rooms that text can tell apart, with all their alternatives, by room id.

    A room's label alone serves where no other room could be meant by it; else an object that is unique in the room
    and that each of those others is known to lack under any word ("the bedroom with the piano"). The one room of a
    single-room scene needs no name of its own.
    """
    if len(referents) == 1:
        room = referents[0].room
        return {room.room_id: (RoomRef(room_id=room.room_id, label=room.label),)}
    names: dict[str, tuple[RoomRef, ...]] = {}
    for one in referents:
        if not vocabulary.room(one.room.label).fit_for_text:
            continue
        others = [r for r in referents if r is not one and vocabulary.might_mean_room(one.room.label, r.room.label)]
        if not others and not vocabulary.room(one.room.label).general:
            names[one.room.room_id] = (RoomRef(room_id=one.room.room_id, label=one.room.label),)
        else:
            names[one.room.room_id] = _anchored(one, others, vocabulary)
    return {room_id: refs for room_id, refs in names.items() if refs}


def _anchored(one: Referents, others: Sequence[Referents], vocabulary: Vocabulary) -> tuple[RoomRef, ...]:
    size = _longest_side(one.arrays)
    anchors = [
        i
        for i in np.flatnonzero(one.anchor)
        if not one.small[i] and all(other.lacks(one.arrays.labels[i], vocabulary) for other in others)
    ]
    # The largest first: what tells a room apart should be seen from its door.
    anchors.sort(key=lambda i: (-size[i], one.arrays.object_ids[i]))
    return tuple(
        RoomRef(
            room_id=one.room.room_id,
            label=one.room.label,
            anchor_id=one.arrays.object_ids[i],
            anchor_label=one.arrays.labels[i],
        )
        for i in anchors[:ROOM_NAMES]
    )


def object_refs(referents: Referents, index: int, room: RoomRef) -> tuple[ObjectRef, ...]:
    """All ways to name one object of a room that goes by `room`, best first; empty where there is none."""
    arrays = referents.arrays
    name, label = arrays.object_ids[index], arrays.labels[index]
    if referents.unique[index]:
        return (ObjectRef(object_id=name, label=label, room=room),)
    return tuple(
        ObjectRef(
            object_id=name,
            label=label,
            room=room,
            qualifier=Qualifier(
                predicate=q.predicate, anchor_id=arrays.object_ids[q.anchor], anchor_label=arrays.labels[q.anchor]
            ),
        )
        for q in referents.qualifications[index]
    )
