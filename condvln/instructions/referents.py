"""How text may name an object: by its label if that is unique in the room, else by label and qualifier.

A qualifier must be *necessary* (without it the phrase fits a rival too) and *sufficient* (every rival fails the
predicate at the loose threshold, so that none is in the dead zone). A rival is an object of the room whose label a
speaker might also use for this one: same label, synonym, hypernym or hyponym, or an unlabelled object that may have the
label. An object that could be anything ("unknown") is a rival only of what has its size and height; elsewhere it only
prevents claims of absence in its room. Boxes of a scan that may be one object are never distinguished from each other.

Invisible objects count as unknown: text never names them, and they are no rivals of visible ones. They may still exist,
so absence is never claimed of a label that they might have. If it is uncertain whether an object is visible, text uses
no word that might mean it.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.likeness import (
    NO_BORDER,
    SCANS,
    Border,
    called_counters,
    called_otherwise,
    called_side_tables,
    doubles,
    fallen,
    look_alikes,
    mistakable,
    parts,
    twins,
)
from condvln.instructions.predicates import OF_THINGS, PREDICATE_GROUPS
from condvln.labels import Vocabulary
from condvln.labels.lists import fixtures_of, have_role, required_in
from condvln.scene import Room, RoomArrays, Scene
from condvln.scene.scene import EVERYTHING_SEEN, Sightings
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
    "things_meant_by",
]

ALTERNATIVES: Final = 2
"""Number of qualifiers kept per object and predicate group, those of largest margin; enough for varied texts."""

ROOM_NAMES: Final = 6
"""Number of names kept per room: some of them may rely on objects that a program visits there."""

Bools = NDArray[np.bool_]


class Facts(Protocol):
    """The facts that text may use about the objects of one room, in the order of ``RoomArrays.object_ids``.

    A status is +1 where a fact is true with margin, −1 where it is false with margin, 0 in the dead zone.

    status[p][i, j] : status of the fact "i p j", for each predicate p with one anchor
    margin[p][i, j] : distance from the threshold, comparable within one predicate
    denied[p][i, j] : whether a condition may state the fact as false; only for predicates that need more for this
        than a status of −1
    excluded[p][i, j] : whether the fact fails for i, so that it excludes i as a rival; only for such predicates
    """

    @property
    def status(self) -> Mapping[str, NDArray[np.int8]]: ...

    @property
    def margin(self) -> Mapping[str, NDArray[np.float64]]: ...

    @property
    def denied(self) -> Mapping[str, NDArray[np.bool_]]: ...

    @property
    def excluded(self) -> Mapping[str, NDArray[np.bool_]]: ...

    def between(self, pairs: NDArray[np.intp]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """Return the status and the margin of the statements "object i is between a and b", (n, p) each. Each row of
        `pairs` (p, 2) holds the indices of one a and one b.
        """
        ...

    def closest(self, rival: NDArray[np.bool_]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """Return the status and the margin of the statements "object i is the closest to object j", (n, n) each. Object
        i is compared with its rivals: `rival` (n, n) says whether the label of object i could mean object j.
        """
        ...

    def sizes(self, rival: NDArray[np.bool_]) -> Mapping[str, NDArray[np.int8]]:
        """Return the status (n,) of "the bigger" and of "the smaller", by predicate. Each object is compared with its
        only rival: `rival` (n, n) says whether the label of object i could mean object j.
        """
        ...


@dataclass(frozen=True, slots=True)
class Qualification:
    """A qualifier whose `anchors` are indices into the room's objects."""

    predicate: Predicate
    anchors: tuple[int, ...]
    margin: float


@dataclass(frozen=True, eq=False)
class Referents:
    """The possible names of one room's objects.

    rival (n, n) : j is visible and could be meant by i's label
    nameable (n,) : visible, with a label fit for text that no object of uncertain label might share
    unique (n,) : nameable without rivals; small (n,) : shorter than the anchor size
    double (n,) : may be the same object as a rival, so that no qualifier distinguishes them
    twin (n,) : may be as large as a rival, so that their sizes do not distinguish them
    anchors (a,) : indices of possible anchors: unique, of known extent, neither small nor portable
    suits (n, n) : j may be the anchor of i: j is fixed, or the larger of the two
    may_be (n,) : for each object whose label is uncertain but one of a few, the other labels that it may have
    open (n,) : for each object of known extent, the other labels that it may have, even if it could be anything
    sayable : predicates that a qualifier may use
    blocked : labels whose absence can't be claimed, since an unlabelled object may have them, or people may call
        another thing so
    unplaced : labels that an unlabelled object of unknown extent may have; such an object may be near to anything
    complete : absence can be claimed: the annotation is complete, as far as can be seen
    fixtures : labels whose absence can't be claimed, since nearly every such room has them
    """

    room: Room
    arrays: RoomArrays
    facts: Facts
    rival: Bools
    nameable: Bools
    unique: Bools
    double: Bools
    twin: Bools
    small: Bools
    anchors: NDArray[np.intp]
    suits: Bools
    sayable: Container[str]
    may_be: tuple[frozenset[str], ...]
    open: tuple[frozenset[str], ...]
    blocked: frozenset[str]
    unplaced: frozenset[str]
    complete: bool
    fixtures: frozenset[str]

    def lacks(self, label: str, vocabulary: Vocabulary) -> bool:
        """Return whether text may claim that the room has no `label`."""
        meant = vocabulary.overlapping(label)
        if not self.complete or label in self.fixtures:
            return False
        return not meant & self.blocked and meant.isdisjoint(self.arrays.labels)

    def decides(self, label: str, vocabulary: Vocabulary) -> bool:
        """Return whether a condition may state "a `label` near …" as false.

        It may if the label fits only one object, since then the statement claims no absence. Otherwise it may only if
        the room is complete and every unlabelled object that may have the label has a known extent.
        """
        if label in self.unique_labels:
            return True
        return self.complete and not vocabulary.overlapping(label) & self.unplaced

    @cached_property
    def qualifications(self) -> tuple[tuple[Qualification, ...], ...]:
        """For each object, the qualifiers that make it unique, best first. The result is empty for an object that needs
        no qualifier, or that no qualifier makes unique.
        """
        return _qualifications(self)

    @cached_property
    def anchor_pairs(self) -> NDArray[np.intp]:
        """All pairs of anchors as two indices each, (p, 2), in the order of the anchors' ids."""
        one, other = np.triu_indices(len(self.anchors), k=1)
        return np.stack([self.anchors[one], self.anchors[other]], axis=1).astype(np.intp)

    def related(self, predicate: Predicate) -> tuple[NDArray[np.intp], NDArray[np.int8], NDArray[np.float64], Bools]:
        """Return (anchors, status, margin, suits) of a predicate. Each row of `anchors` (a, k) is one possible choice
        of the predicate's k anchors, as indices. status, margin and `suits` (n, a) have one entry for each of n objects
        and each choice; `suits` tells whether a phrase may use the choice for the object.
        """
        columns = self.anchor_pairs if predicate == "between" else self.anchors[:, None]
        if predicate == "between":
            status, margin = self.facts.between(columns)
        elif predicate == "closest to":
            status, margin = self._closest[0][:, self.anchors], self._closest[1][:, self.anchors]
        else:
            status = self.facts.status[predicate][:, self.anchors]
            margin = self.facts.margin[predicate][:, self.anchors]
        return columns, status, margin, np.asarray(self.suits[:, columns].all(axis=2))

    def denied(self, predicate: Predicate, status: NDArray[np.int8]) -> Bools:
        """Return a mask (n, a) of the facts with `predicate` that a condition may state to be false. The caller passes
        the `status` (n, a) that `related` returned.
        """
        found = self.facts.denied.get(predicate)
        return np.asarray(status == -1) if found is None else np.asarray(found[:, self.anchors])

    def kept(self, predicate: Predicate, status: NDArray[np.int8]) -> Bools:
        """Return a mask (n, a): for each object and each choice of anchors, whether the object stays a rival, since a
        phrase with `predicate` and these anchors may still mean this object. `status` (n, a) is the status that
        `related` returns.
        """
        found = self.facts.excluded.get(predicate)
        return np.asarray(status != -1 if found is None else (status != -1) | ~found[:, self.anchors])

    @cached_property
    def _closest(self) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        return self.facts.closest(self.rival)

    @cached_property
    def unique_labels(self) -> frozenset[str]:
        """Labels that belong to exactly one object of the room, and whose words can mean no other object
        of the room.
        """
        return frozenset(self.arrays.labels[i] for i in np.flatnonzero(self.unique))

    @cached_property
    def usable(self) -> Bools:
        """Mask (n,) of objects that text can name."""
        return np.asarray(self.unique | np.array([bool(q) for q in self.qualifications], dtype=bool))

    @cached_property
    def usable_anywhere(self) -> Bools:
        """Mask (n,) of objects that text can name wherever the start is."""
        told = [any(q.predicate not in BEARINGS for q in found) for found in self.qualifications]
        return np.asarray(self.unique | np.array(told, dtype=bool))

    @cached_property
    def sized(self) -> Bools:
        """Mask (n,) of objects whose extent is known."""
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
        border: Border = NO_BORDER,
    ) -> Referents:
        """Return the names of all objects of a room.

        family : family whose labels the objects have; None if each object is only what its label says
        border : what may belong to two rooms, and so is named in neither
        """
        part = parts(arrays)
        seen = ~(sightings.hidden(arrays) | part)
        may_be, open_, blocked, unplaced = _nameless(arrays, vocabulary, family)
        meant = meant_by(arrays.labels, arrays.labels, may_be, vocabulary)
        nameable = np.array([vocabulary.fit_for_text(label) for label in arrays.labels], dtype=bool) & seen
        nameable &= ~meant[:, sightings.in_doubt(arrays) & ~part].any(axis=1)
        nameable &= ~fallen(arrays)
        if border.labels:
            blocked, unplaced = blocked | border.labels, unplaced | border.labels
            nameable &= np.array([not vocabulary.overlapping(x) & border.labels for x in arrays.labels], dtype=bool)
        unclear = np.array([name in border.own for name in arrays.object_ids], dtype=bool)
        nameable &= ~unclear
        complete, fixtures = room.complete, frozenset[str]()
        if family in SCANS:
            unclear |= mistakable(arrays)
            nameable &= ~unclear
            fixtures = fixtures_of(room.label)
            needed = [vocabulary.overlapping(label) for label in sorted(required_in(room.label))]
            complete = complete and not any(labels.isdisjoint(arrays.labels) for labels in needed)
        rival = meant & seen & seen[:, None]
        np.fill_diagonal(rival, False)
        unique = nameable & ~rival.any(axis=1)
        longest, sizes = _longest_side(arrays), arrays.aabb_max - arrays.aabb_min
        small = np.asarray(longest < anchor_size)
        fixed, landmark, portable = (have_role(arrays.labels, role) for role in ("fixed", "landmark", "portable"))
        fixed |= landmark & (longest >= LANDMARK_SIZE)
        anchors = np.flatnonzero(unique & ~portable & (fixed | ~small) & ~np.isnan(sizes).any(axis=1))
        return cls(
            room=room,
            arrays=arrays,
            facts=facts,
            rival=rival,
            nameable=nameable,
            unique=unique,
            double=doubles(arrays, meant) if family in SCANS else np.zeros(len(arrays), dtype=bool),
            twin=twins(arrays, rival, unclear) if family in SCANS else np.zeros(len(arrays), dtype=bool),
            small=small,
            anchors=anchors,
            suits=_suits(sizes, np.asarray(fixed)),
            sayable=sayable,
            may_be=may_be,
            open=open_,
            blocked=blocked,
            unplaced=unplaced,
            complete=complete,
            fixtures=fixtures,
        )


def meant_by(
    words: Sequence[str], labels: Sequence[str], may_be: Sequence[frozenset[str]], vocabulary: Vocabulary
) -> Bools:
    """Return a mask (w, n): whether each of the w `words`, which are labels, might mean each of n objects. A word might
    mean an object by the object's own label or by another label that the object may have.

    Parameters
    ----------
    labels, may_be : of the objects, (n,) each
    """
    rows = {word: row for row, word in enumerate(dict.fromkeys(words))}
    table = np.zeros((len(rows), len(labels)), dtype=bool)
    for column, (label, open_) in enumerate(zip(labels, may_be, strict=True)):
        for own in (label, *open_):
            for word in rows.keys() & vocabulary.overlapping(own):  # which is symmetric
                table[rows[word], column] = True
    return np.asarray(table[[rows[word] for word in words]])


def things_meant(
    scene: Scene, room_id: str, label: str, vocabulary: Vocabulary, sightings: Sightings = EVERYTHING_SEEN
) -> tuple[str, ...]:
    """Return the ids of the visible objects of a room that a word for `label` might mean. Unlabelled objects are
    included.
    """
    return things_meant_by(scene, room_id, (label,), vocabulary, sightings)[0]


def things_meant_by(
    scene: Scene, room_id: str, labels: Sequence[str], vocabulary: Vocabulary, sightings: Sightings = EVERYTHING_SEEN
) -> list[tuple[str, ...]]:
    """Return what `things_meant` returns for each of several labels."""
    arrays = scene.arrays(room_id)
    meant = meant_by(labels, arrays.labels, _nameless(arrays, vocabulary, scene.family)[0], vocabulary)
    meant &= ~sightings.hidden(arrays) & ~parts(arrays)
    return [tuple(arrays.object_ids[i] for i in np.flatnonzero(row)) for row in meant]


def _nameless(
    arrays: RoomArrays, vocabulary: Vocabulary, family: str | None
) -> tuple[tuple[frozenset[str], ...], tuple[frozenset[str], ...], frozenset[str], frozenset[str]]:
    """Return the labels that objects may have besides their own, as the fields `may_be`, `open`, `blocked` and
    `unplaced` of `Referents`.
    """
    none: frozenset[str] = frozenset()
    if family is None:
        return (none,) * len(arrays), (none,) * len(arrays), none, none
    longest = np.max(arrays.aabb_max - arrays.aabb_min, axis=1, initial=-np.inf)
    known = ~np.isnan(longest)
    found = [
        vocabulary.may_be(label, family, float(side) if there else None)
        for label, side, there in zip(arrays.labels, longest, known, strict=True)
    ]
    found = [
        labels | {"counter"} if tall else labels for labels, tall in zip(found, called_counters(arrays), strict=True)
    ]
    found = [
        labels | {"side table"} if short else labels
        for labels, short in zip(found, called_side_tables(arrays), strict=True)
    ]
    vague = np.array([vocabulary.is_vague(label, family) for label in arrays.labels], dtype=bool)
    may_be = tuple(
        like if anything else labels
        for labels, anything, like in zip(found, vague, look_alikes(arrays, vague), strict=True)
    )
    called = called_otherwise(arrays)
    if family in SCANS:
        # In other families this would leave open a third of the statements about stagings (decision 27).
        found = [labels | others for labels, others in zip(found, called, strict=True)]
    placed = tuple(labels if there else none for labels, there in zip(found, known, strict=True))
    unplaced = none.union(*(labels for labels, there in zip(found, known, strict=True) if not there))
    return may_be, placed, none.union(*found, *called), unplaced


def _suits(sizes: NDArray[np.float64], fixed: Bools) -> Bools:
    """Return a mask (n, n): whether object j may be the anchor of object i, judging by the `sizes` (n, 3). This is so
    if j is fixed, or if the ground area or the volume of j is at least that of i.
    """
    area, volume = sizes[:, 0] * sizes[:, 2], sizes.prod(axis=1)
    suits = fixed[None, :] | (area[None, :] >= area[:, None]) | (volume[None, :] >= volume[:, None])
    np.fill_diagonal(suits, False)
    return np.asarray(suits)


def _longest_side(arrays: RoomArrays) -> NDArray[np.float64]:
    """Return the longest side (n,) of each object in metres. An object of unknown extent counts as large: its side is
    infinite.
    """
    sides = np.max(arrays.aabb_max - arrays.aabb_min, axis=1, initial=-np.inf)
    sides = np.where(np.isnan(sides), 2.0 * arrays.radius, sides)
    return np.where(np.isnan(sides), np.inf, sides)


def _qualifications(referents: Referents) -> tuple[tuple[Qualification, ...], ...]:
    sizes = referents.facts.sizes(referents.rival)
    rows = np.flatnonzero(referents.nameable & ~referents.unique & ~referents.double)
    found: list[list[Qualification]] = [[] for _ in referents.nameable]
    rivals = referents.rival[rows].astype(np.float32)
    located = referents.sized & ~(referents.rival & ~referents.sized).any(axis=1)
    for group, predicates in PREDICATE_GROUPS.items():
        ways: list[list[tuple[float, tuple[int, ...], Predicate]]] = [[] for _ in rows]
        for predicate in predicates:
            if predicate not in referents.sayable:
                continue
            if predicate in BEARINGS:
                # Whether the egocentric statement is possible is found when the start is chosen.
                for k in np.flatnonzero(located[rows]).tolist():
                    ways[k].append((0.0, (), predicate))
                continue
            if predicate in SUPERLATIVES:
                for k in np.flatnonzero((sizes[predicate][rows] == 1) & ~referents.twin[rows]).tolist():
                    ways[k].append((0.0, (), predicate))
                continue
            anchors, status, margin, suits = referents.related(predicate)
            # Rivals that the loose threshold does not exclude, counted for all anchors at once by a matrix product.
            left = rivals @ referents.kept(predicate, status).astype(np.float32)
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
    """Return all alternative names of each room that has a unique name, by room id.

    A room's label suffices if no other room could be meant by it. Otherwise the name includes an object that is unique
    in the room and known to be absent from each of those others ("the bedroom with the piano"). The only room of a
    single-room scene needs no name.
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
    # The largest first, since the distinguishing object should be visible from the room's door.
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
    """Return all ways to name one object of a room named `room`, best first; empty if there are none."""
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
    """Return a qualifier from the indices of its anchors."""
    return Qualifier(
        predicate=predicate,
        anchors=tuple(Anchor(object_id=arrays.object_ids[a], label=arrays.labels[a]) for a in anchors),
    )
