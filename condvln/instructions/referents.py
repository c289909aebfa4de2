"""What text may call an object: by its label where that is unique in the room, else by label and qualifier.

A qualifier is *necessary* (without it the phrase fits a rival too) and *sufficient* (every rival fails the predicate
at the loose threshold, so that none lies in the dead zone). A rival is an object of the room whose label a speaker
might use for this one as well: same label, synonym, hypernym or hyponym.
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

    rival (n, n) : j could be meant by i's label; nameable (n,) : the label is fit for text; unique (n,) : nameable
    without rivals; small (n,) : shorter than the anchor size
    """

    room: Room
    arrays: RoomArrays
    facts: Facts
    rival: Bools
    nameable: Bools
    unique: Bools
    small: Bools

    @cached_property
    def qualifications(self) -> tuple[tuple[Qualification, ...], ...]:
        """Per object the ways to make it unique, best first; none where it needs none or has none."""
        return _qualifications(self.facts, self.rival, self.nameable, self.unique, self.small)

    @cached_property
    def unique_labels(self) -> frozenset[str]:
        """Labels that fit one object of the room alone, under any word for them."""
        return frozenset(self.arrays.labels[i] for i in np.flatnonzero(self.unique))

    @cached_property
    def usable(self) -> Bools:
        """(n,) objects that text can name."""
        return np.asarray(self.unique | np.array([bool(q) for q in self.qualifications], dtype=bool))

    @classmethod
    def of(cls, room: Room, arrays: RoomArrays, facts: Facts, vocabulary: Vocabulary, anchor_size: float) -> Referents:
        """Names of all objects of a room."""
        nameable = np.array([vocabulary.fit_for_text(label) for label in arrays.labels], dtype=bool)
        rival = overlap_matrix(arrays.labels, vocabulary)
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
            small=small,
        )


def overlap_matrix(labels: Sequence[str], vocabulary: Vocabulary) -> Bools:
    """(n, n): a word for label i might mean label j. True on the diagonal."""
    distinct = sorted(set(labels))
    of = np.array([distinct.index(label) for label in labels], dtype=np.int64)
    table = np.array([[b in vocabulary.overlapping(a) for b in distinct] for a in distinct], dtype=bool)
    if not len(of):
        return np.zeros((0, 0), dtype=bool)
    return np.asarray((table | table.T)[np.ix_(of, of)])


def _longest_side(arrays: RoomArrays) -> NDArray[np.float64]:
    """(n,) longest side in metres; infinite where no extent is known, so that it counts as large."""
    sides = np.max(arrays.aabb_max - arrays.aabb_min, axis=1, initial=-np.inf)
    sides = np.where(np.isnan(sides), 2.0 * arrays.radius, sides)
    return np.where(np.isnan(sides), np.inf, sides)


def _qualifications(
    facts: Facts, rival: Bools, nameable: Bools, unique: Bools, small: Bools
) -> tuple[tuple[Qualification, ...], ...]:
    n = len(nameable)
    rows, anchors = np.flatnonzero(nameable & ~unique), np.flatnonzero(unique)
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
                anchor = int(anchors[a])
                ways[r].append((bool(small[anchor]), -float(margin[rows[r], anchor]), anchor, predicate))
        for r, options in enumerate(ways):
            kept = found[int(rows[r])]
            if (group == "height" and len(kept) >= ALTERNATIVES) or (group == "far" and kept):
                continue
            kept.extend(
                Qualification(predicate, anchor, -negated)
                for _, negated, anchor, predicate in sorted(options)[:ALTERNATIVES]
            )
    return tuple(tuple(kept) for kept in found)


def room_refs(referents: Sequence[Referents], vocabulary: Vocabulary) -> dict[str, tuple[RoomRef, ...]]:
    """Names of the rooms that text can tell apart, with all their alternatives, by room id.

    A room's label alone serves where no other room could be meant by it; else an object that is unique in the room
    and that none of those others has under any word ("the bedroom with the piano"). Absence in the others is
    claimed, so they must be annotated completely. The one room of a single-room scene needs no name of its own.
    """
    if len(referents) == 1:
        room = referents[0].room
        return {room.room_id: (RoomRef(room_id=room.room_id, label=room.label),)}
    names: dict[str, tuple[RoomRef, ...]] = {}
    for one in referents:
        if not vocabulary.room(one.room.label).fit_for_text:
            continue
        meant = vocabulary.overlapping_rooms(one.room.label)
        others = [r for r in referents if r is not one and r.room.label in meant]
        if not others:
            names[one.room.room_id] = (RoomRef(room_id=one.room.room_id, label=one.room.label),)
        elif all(other.room.complete for other in others):
            names[one.room.room_id] = _anchored(one, others, vocabulary)
    return {room_id: refs for room_id, refs in names.items() if refs}


def _anchored(one: Referents, others: Sequence[Referents], vocabulary: Vocabulary) -> tuple[RoomRef, ...]:
    elsewhere = {label for other in others for label in other.arrays.labels}
    size = _longest_side(one.arrays)
    anchors = [
        i
        for i in np.flatnonzero(one.unique)
        if not elsewhere & vocabulary.overlapping(one.arrays.labels[i]) and not one.small[i]
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
