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

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.predicates import OF_THINGS, PREDICATE_GROUPS
from condvln.labels import Vocabulary
from condvln.labels.roles import labels_with_role
from condvln.scene import Room, RoomArrays, Scene
from condvln.scene.sightings import EVERYTHING_SEEN, Sightings
from schemas.config.constants import LANDMARK_SIZE
from schemas.program import BEARINGS, SUPERLATIVES, Anchor, ObjectRef, Predicate, Qualifier, RoomRef

__all__ = [
    "ALTERNATIVES",
    "Facts",
    "Qualification",
    "Referents",
    "object_refs",
    "qualifier_of",
    "room_refs",
    "things_meant",
]

ALTERNATIVES: Final = 2
"""Qualifiers kept per object and predicate group, those of largest margin; enough for texts to differ."""

ROOM_NAMES: Final = 6
"""Names kept per room: some of them may rest on what a program visits there."""

Bools = NDArray[np.bool_]


class Facts(Protocol):
    """Which predicates text may use of the objects of one room, in the order of ``RoomArrays.object_ids``.

    A status is +1 where a fact holds with margin, −1 where it fails with margin, 0 in the dead zone.

    status[p][i, j] : of "i p j", for predicates with one anchor
    margin[p][i, j] : how far it is from its threshold, comparable within one predicate
    """

    @property
    def status(self) -> Mapping[str, NDArray[np.int8]]: ...

    @property
    def margin(self) -> Mapping[str, NDArray[np.float64]]: ...

    def between(self, pairs: NDArray[np.intp]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """Status and margin (n, p) of "between a and b" for pairs (p, 2) of indices."""
        ...

    def closest(self, rival: NDArray[np.bool_]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """Status and margin (n, n) of "closest to", among each thing and its rivals."""
        ...

    def sizes(self, rival: NDArray[np.bool_]) -> Mapping[str, NDArray[np.int8]]:
        """Status (n,) of "the bigger" and "the smaller", of a thing and its one rival."""
        ...


@dataclass(frozen=True, slots=True)
class Qualification:
    """A qualifier by indices: `anchors` into the room's objects."""

    predicate: Predicate
    anchors: tuple[int, ...]
    margin: float


@dataclass(frozen=True, eq=False)
class Referents:
    """The names that one room's objects may go by.

    rival (n, n) : j can be seen and could be meant by i's label
    nameable (n,) : can be seen, the label is fit for text, and no word for it might mean a thing in doubt
    unique (n,) : nameable without rivals; small (n,) : shorter than the anchor size
    anchors (a,) : indices of what something may be found by: unique, of known extent, neither small nor portable
    suits (n, n) : j may be the anchor of i: it is fixed, or the larger of the two
    may_be (n,) : labels that a thing may bear without being called so, of those that may be some things only
    open (n,) : the same of all things whose extent is known, also of those that may be anything
    sayable : predicates that a qualifier may have
    blocked : labels that can't be said to be absent, since something nameless may bear them
    unplaced : those among them that something of unknown extent may bear, so that it may be near to anything
    """

    room: Room
    arrays: RoomArrays
    facts: Facts
    rival: Bools
    nameable: Bools
    unique: Bools
    small: Bools
    anchors: NDArray[np.intp]
    suits: Bools
    sayable: Container[str]
    may_be: tuple[frozenset[str], ...]
    open: tuple[frozenset[str], ...]
    blocked: frozenset[str]
    unplaced: frozenset[str]

    def lacks(self, label: str, vocabulary: Vocabulary) -> bool:
        """Whether text may claim that the room has no `label`."""
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
        return _qualifications(self)

    @cached_property
    def anchor_pairs(self) -> NDArray[np.intp]:
        """(p, 2) all pairs of anchors, in the order of their ids."""
        one, other = np.triu_indices(len(self.anchors), k=1)
        return np.stack([self.anchors[one], self.anchors[other]], axis=1).astype(np.intp)

    def related(self, predicate: Predicate) -> tuple[NDArray[np.intp], NDArray[np.int8], NDArray[np.float64], Bools]:
        """Facts of a predicate with anchors: anchors (a, k), and status, margin and `suits` (n, a) of all objects."""
        columns = self.anchor_pairs if predicate == "between" else self.anchors[:, None]
        if predicate == "between":
            status, margin = self.facts.between(columns)
        elif predicate == "closest to":
            status, margin = self._closest[0][:, self.anchors], self._closest[1][:, self.anchors]
        else:
            status = self.facts.status[predicate][:, self.anchors]
            margin = self.facts.margin[predicate][:, self.anchors]
        return columns, status, margin, np.asarray(self.suits[:, columns].all(axis=2))

    @cached_property
    def _closest(self) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        return self.facts.closest(self.rival)

    @cached_property
    def unique_labels(self) -> frozenset[str]:
        """Labels that fit one object of the room alone, under any word for them."""
        return frozenset(self.arrays.labels[i] for i in np.flatnonzero(self.unique))

    @cached_property
    def usable(self) -> Bools:
        """(n,) objects that text can name."""
        return np.asarray(self.unique | np.array([bool(q) for q in self.qualifications], dtype=bool))

    @cached_property
    def usable_anywhere(self) -> Bools:
        """(n,) objects that text can name wherever the start is."""
        told = [any(q.predicate not in BEARINGS for q in found) for found in self.qualifications]
        return np.asarray(self.unique | np.array(told, dtype=bool))

    @cached_property
    def sized(self) -> Bools:
        """(n,) objects whose extent is known."""
        return np.asarray(~np.isnan(self.arrays.aabb_max - self.arrays.aabb_min).any(axis=1))

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
        sayable: Container[str] = OF_THINGS,
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
        longest, sizes = _longest_side(arrays), arrays.aabb_max - arrays.aabb_min
        small = np.asarray(longest < anchor_size)
        fixed, landmark, portable = (
            np.isin(arrays.labels, sorted(labels_with_role(role))) for role in ("fixed", "landmark", "portable")
        )
        fixed |= landmark & (longest >= LANDMARK_SIZE)
        anchors = np.flatnonzero(unique & ~portable & (fixed | ~small) & ~np.isnan(sizes).any(axis=1))
        return cls(
            room=room,
            arrays=arrays,
            facts=facts,
            rival=rival,
            nameable=nameable,
            unique=unique,
            small=small,
            anchors=anchors,
            suits=_suits(sizes, np.asarray(fixed)),
            sayable=sayable,
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


def things_meant(
    scene: Scene, room_id: str, label: str, vocabulary: Vocabulary, sightings: Sightings = EVERYTHING_SEEN
) -> tuple[str, ...]:
    """Ids of the things of a room that can be seen and that a word for `label` might mean, nameless ones among them."""
    arrays = scene.arrays(room_id)
    meant = meant_by((label,), arrays.labels, _nameless(arrays, vocabulary, scene.family)[0], vocabulary)[0]
    return tuple(arrays.object_ids[i] for i in np.flatnonzero(meant & ~sightings.hidden(arrays)))


def _nameless(
    arrays: RoomArrays, vocabulary: Vocabulary, family: str | None
) -> tuple[tuple[frozenset[str], ...], tuple[frozenset[str], ...], frozenset[str], frozenset[str]]:
    """Labels that objects may have beside their own: `may_be`, `open`, `blocked` and `unplaced` of `Referents`."""
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


def _suits(sizes: NDArray[np.float64], fixed: Bools) -> Bools:
    """(n, n) whether j may be the anchor of i, by sizes (n, 3): the larger on the ground or in volume, or the fixed."""
    area, volume = sizes[:, 0] * sizes[:, 2], sizes.prod(axis=1)
    suits = fixed[None, :] | (area[None, :] >= area[:, None]) | (volume[None, :] >= volume[:, None])
    np.fill_diagonal(suits, False)
    return np.asarray(suits)


def _longest_side(arrays: RoomArrays) -> NDArray[np.float64]:
    """(n,) longest side in metres; infinite where no extent is known, so that it counts as large."""
    sides = np.max(arrays.aabb_max - arrays.aabb_min, axis=1, initial=-np.inf)
    sides = np.where(np.isnan(sides), 2.0 * arrays.radius, sides)
    return np.where(np.isnan(sides), np.inf, sides)


def _qualifications(referents: Referents) -> tuple[tuple[Qualification, ...], ...]:
    sizes, rows = referents.facts.sizes(referents.rival), np.flatnonzero(referents.nameable & ~referents.unique)
    found: list[list[Qualification]] = [[] for _ in referents.nameable]
    rivals = referents.rival[rows].astype(np.float32)
    located = referents.sized & ~(referents.rival & ~referents.sized).any(axis=1)
    for group, predicates in PREDICATE_GROUPS.items():
        ways: list[list[tuple[float, tuple[int, ...], Predicate]]] = [[] for _ in rows]
        for predicate in predicates:
            if predicate not in referents.sayable:
                continue
            if predicate in BEARINGS:
                # Whether it can be so is found when the start is chosen.
                for k in np.flatnonzero(located[rows]).tolist():
                    ways[k].append((0.0, (), predicate))
                continue
            if predicate in SUPERLATIVES:
                for k in np.flatnonzero(sizes[predicate][rows] == 1).tolist():
                    ways[k].append((0.0, (), predicate))
                continue
            anchors, status, margin, suits = referents.related(predicate)
            # Rivals that the loose threshold does not exclude; a matrix product counts them for all anchors at once.
            left = rivals @ (status != -1).astype(np.float32)
            for r, a in zip(*np.nonzero((status[rows] == 1) & (left == 0) & suits[rows]), strict=True):
                ways[r].append((-float(margin[rows[r], a]), tuple(anchors[a].tolist()), predicate))
        for r, options in enumerate(ways):
            kept = found[int(rows[r])]
            if (group == "height" and len(kept) >= ALTERNATIVES) or (group == "far" and kept):
                continue
            kept.extend(
                Qualification(predicate, anchors, -negated)
                for negated, anchors, predicate in sorted(options)[: None if group == "bearing" else ALTERNATIVES]
            )
    return tuple(tuple(kept) for kept in found)


def room_refs(referents: Sequence[Referents], vocabulary: Vocabulary) -> dict[str, tuple[RoomRef, ...]]:
    """Names of the rooms that have a unique one, with all alternatives, by room id.

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
        i for i in one.anchors.tolist() if all(other.lacks(one.arrays.labels[i], vocabulary) for other in others)
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
    """All ways to name one object of a room named `room`, best first; empty if there is none."""
    arrays = referents.arrays
    name, label = arrays.object_ids[index], arrays.labels[index]
    if referents.unique[index]:
        return (ObjectRef(object_id=name, label=label, room=room),)
    return tuple(
        ObjectRef(
            object_id=name,
            label=label,
            room=room,
            qualifier=qualifier_of(arrays, q.predicate, q.anchors),
        )
        for q in referents.qualifications[index]
    )


def qualifier_of(arrays: RoomArrays, predicate: Predicate, anchors: Sequence[int]) -> Qualifier:
    """A qualifier from the indices of its anchors."""
    return Qualifier(
        predicate=predicate,
        anchors=tuple(Anchor(object_id=arrays.object_ids[a], label=arrays.labels[a]) for a in anchors),
    )
