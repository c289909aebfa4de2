"""The possible stops of a program, which of them are far enough apart, and their names, of which no word may mean
something else in the text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.degeneracy import GivenUp, is_circular
from condvln.instructions.predicates import COMPASS, GROUP_OF
from condvln.instructions.referents import ALTERNATIVES, Referents
from condvln.labels import Vocabulary
from condvln.labels.lists import worth
from condvln.scene import Scene
from condvln.seeding import Draws
from schemas.config import PlacesConfig, SamplingConfig
from schemas.program import ObjectRef, RoomRef

__all__ = [
    "Said",
    "StopName",
    "StopNames",
    "Stops",
    "Target",
    "Targets",
    "apart_by_centres",
    "nameable",
    "preferences",
    "targets",
]


LEAST_STOP: Final = 0.15
"""Longest side in metres below which an object is never a stop: nobody is sent to a thing that small."""

OFTEN: Final = 0.3
"""Worth of going to a label from which on people are often sent there."""

SELDOM: Final = 0.1
"""How often a label below that is a stop, relative to those above."""


@dataclass(frozen=True, eq=False)
class Stops:
    """The reachable objects of a scene, and which of them are far enough apart.

    object_ids (n,) : objects with goal points; other objects are never stops
    apart (n, n) : two stops are far enough apart to be leaves of one program, or two moves of one leaf
    """

    object_ids: tuple[str, ...]
    apart: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Target:
    """An object that may be a stop.

    position : the object's index among all targets; index : its index among the objects of its room
    weight : how often it is a stop, relative to others, above 0
    clear : the object has a name other than those used only if nothing else can be named ("the chair away from the
        desk")
    plain : the object has a name without a compass word
    """

    object_id: str
    position: int
    room_id: str
    index: int
    label: str
    weight: float
    clear: bool
    plain: bool


@dataclass(frozen=True, eq=False)
class Targets:
    """The objects of a scene that may be stops, in order of room and object id.

    apart (t, t) : two targets may be stops of the same leaf, or goals of the same program: they are far enough apart,
        and not in `alike`
    alike (t, t) : two targets are in different rooms, and one word might name both
    """

    targets: tuple[Target, ...]
    apart: NDArray[np.bool_]
    alike: NDArray[np.bool_]


def apart_by_centres(scene: Scene, places: PlacesConfig) -> Stops:
    """Return the stops of a scene without computing geodesics. Two objects are apart if the horizontal distance between
    their centres is large enough.
    """
    ordered = sorted(scene.objects, key=lambda o: o.object_id)
    least = places.leaf_separation(scene.single_room)
    ground = np.array([o.center[[0, 2]] for o in ordered], dtype=np.float64).reshape(-1, 2)
    distance = np.linalg.norm(ground[:, None] - ground[None, :], axis=-1)
    return Stops(tuple(o.object_id for o in ordered), np.asarray(distance >= least))


def nameable(referents: Mapping[str, Referents], rooms: Iterable[str]) -> list[tuple[str, int, str]]:
    """Return the objects of the given `rooms` that text can name, in order of room: the room, the object's index there,
    and its id.
    """
    alone = len(referents) == 1
    return [
        (room_id, i, referents[room_id].arrays.object_ids[i])
        for room_id in sorted(rooms)
        for i in np.flatnonzero(referents[room_id].usable if alone else referents[room_id].usable_anywhere).tolist()
    ]


def targets(
    referents: Mapping[str, Referents],
    rooms: Iterable[str],
    stops: Stops,
    sampling: SamplingConfig,
    words: Vocabulary,
) -> Targets:
    """Return the objects of the given `rooms` that text can name, that can be reached, and that are worth it."""
    row_of = {name: k for k, name in enumerate(stops.object_ids)}
    chosen = [
        (room_id, i, row_of[name])
        for room_id, i, name in nameable(referents, rooms)
        if name in row_of and _worth(referents[room_id], i) > 0.0
    ]
    rows = [row for _, _, row in chosen]
    alike = _alike([(room_id, referents[room_id].arrays.labels[i]) for room_id, i, _ in chosen], words)
    apart = stops.apart[np.ix_(rows, rows)] & ~alike
    found = tuple(
        Target(
            object_id=referents[room_id].arrays.object_ids[i],
            position=k,
            room_id=room_id,
            index=i,
            label=referents[room_id].arrays.labels[i],
            weight=_worth(referents[room_id], i),
            clear=_is_clear(referents[room_id], i, sampling),
            plain=_is_plain(referents[room_id], i),
        )
        for k, (room_id, i, _) in enumerate(chosen)
    )
    return Targets(found, apart, alike)


def _worth(referents: Referents, index: int) -> float:
    """Return how often an object of a room is a stop, relative to what people are often sent to.

    There are two levels only: a label that is a stop in nearly every text that could ask about it is asked about, in
    the rest, where it is missing, and so tells the truth.
    """
    arrays = referents.arrays
    tiny = (arrays.aabb_max[index] - arrays.aabb_min[index]).max() < LEAST_STOP  # not if its extent is unknown
    goto = 0.0 if tiny else worth(arrays.labels[index], referents.room.label).goto
    return SELDOM if 0.0 < goto < OFTEN else float(goto > 0.0)


def _alike(named: Sequence[tuple[str, str]], words: Vocabulary) -> NDArray[np.bool_]:
    """Return a mask (n, n) for n objects, given as (room, label): whether two of them are in different rooms and one
    word might name both.
    """
    labels = {label: k for k, label in enumerate(sorted({label for _, label in named}))}
    meant = np.array([[other in words.overlapping(one) for other in labels] for one in labels], dtype=bool)
    meant = meant.reshape(len(labels), len(labels))
    rooms = {room: k for k, room in enumerate(sorted({room for room, _ in named}))}
    of_room = np.array([rooms[room] for room, _ in named], dtype=np.intp)
    of_label = np.array([labels[label] for _, label in named], dtype=np.intp)
    return np.asarray(meant[np.ix_(of_label, of_label)] & (of_room[:, None] != of_room))


def _is_clear(referents: Referents, index: int, sampling: SamplingConfig) -> bool:
    """Return whether an object has a name without a predicate, or a name whose predicate has a weight above 0."""
    groups = [GROUP_OF[q.predicate] for q in referents.qualifications[index]]
    return bool(referents.unique[index]) or any(getattr(sampling.predicates, group) > 0.0 for group in groups)


def _is_plain(referents: Referents, index: int) -> bool:
    """Return whether an object has a name without a compass word."""
    return bool(referents.unique[index]) or any(q.predicate not in COMPASS for q in referents.qualifications[index])


@dataclass(frozen=True, eq=False, slots=True)
class StopName:
    """One name of a stop. Each is made once, and is equal to itself only.

    anchors : labels of the anchors of its qualifier; group : the qualifier's group of predicates, "" without one
    """

    ref: ObjectRef
    anchors: tuple[str, ...]
    group: str
    egocentric: bool

    @property
    def compass(self) -> bool:
        """Whether the name has a compass word."""
        return self.group == "compass"


class Said:
    """The labels that a text has named, by room."""

    def __init__(self, things: Iterable[tuple[str, str]], vocabulary: Vocabulary) -> None:
        self._vocabulary = vocabulary
        self._by_room: dict[str, set[str]] = {}
        for room_id, label in things:
            self.add(room_id, label)

    def add(self, room_id: str, label: str) -> None:
        """Add a label that was named in a room."""
        self._by_room.setdefault(room_id, set()).add(label)

    def means(self, label: str, outside: str | None = None) -> bool:
        """Return whether a word for `label` might mean a thing that was named, in any room but `outside`."""
        words = self._vocabulary.overlapping(label)
        return any(room_id != outside and not words.isdisjoint(said) for room_id, said in self._by_room.items())


class StopNames:
    """The names of the rooms and stops of a scene.

    Parameters
    ----------
    rooms : the names of each room, by its id
    refs_of : returns the references to a target in a room with a certain name, best first
    """

    def __init__(
        self,
        rooms: Mapping[str, Sequence[RoomRef]],
        refs_of: Callable[[Target, RoomRef], Sequence[ObjectRef]],
        sampling: SamplingConfig,
        vocabulary: Vocabulary,
    ) -> None:
        self.rooms, self._refs_of, self._sampling, self._vocabulary = rooms, refs_of, sampling, vocabulary
        self._names: dict[tuple[int, str | None], list[StopName]] = {}

    def draw_rooms(self, room_ids: Sequence[str], said: Said, draws: Draws) -> dict[str, RoomRef]:
        """Return a name of each room, by its id, and add what they name to `said`. No name relies on an object with the
        label of a stop, or with a label in another room's name.

        Raises
        ------
        GivenUp : a room has no such name
        """
        found = {}
        for room_id in room_ids:
            names = self.rooms[room_id]
            free = [name for name in names if name.anchor_label is None or not said.means(name.anchor_label)]
            if not free:
                raise GivenUp("circular")
            found[room_id] = name = draws.choice(free[:ALTERNATIVES])
            if name.anchor_label is not None:
                said.add(room_id, name.anchor_label)
        return found

    @staticmethod
    def keep_rooms(rooms: Mapping[str, RoomRef], said: Said) -> None:
        """Keep names of rooms that were drawn before, by room id, for a text with other stops: add what they name to
        `said`.

        Raises
        ------
        GivenUp : a name relies on an object with the label of a stop
        """
        anchors = {room_id: room.anchor_label for room_id, room in rooms.items() if room.anchor_label is not None}
        if any(said.means(label) for label in anchors.values()):
            raise GivenUp("circular")
        for room_id, label in anchors.items():
            said.add(room_id, label)

    def draw_stop(
        self,
        target: Target,
        room: RoomRef,
        said: Said,
        draws: Draws,
        *,
        egocentric: bool,
        compass: bool,
        alone: bool,
    ) -> StopName:
        """Return a name of a target, by its weight, and add what it names to `said`. No name relies on an object with a
        label that was said of another room, unless the text names one room `alone`.

        egocentric, compass : whether the name may be egocentric, or have a compass word

        Raises
        ------
        GivenUp : the target has no such name
        """
        names = self._of(target, room)
        if len(names) == 1 and names[0].ref.qualifier is None:
            return names[0]
        names = [name for name in names if egocentric or not name.egocentric]
        if not names:
            raise GivenUp("circular")
        names = [name for name in names if compass or not name.compass]
        if not names:
            raise GivenUp("compass_words")
        if not alone:
            names = [name for name in names if not any(said.means(x, outside=room.room_id) for x in name.anchors)]
            if not names:
                raise GivenUp("two_things")
        if len(names) == 1:
            name = names[0]
        else:
            name = names[draws.cumulative([*accumulate(preferences([n.group for n in names], self._sampling))])]
        for anchor in name.anchors:
            said.add(room.room_id, anchor)
        return name

    def _of(self, target: Target, room: RoomRef) -> list[StopName]:
        key = (target.position, room.anchor_id)
        if key not in self._names:
            refs = [ref for ref in self._refs_of(target, room) if not is_circular(ref, self._vocabulary)]
            self._names[key] = [
                StopName(
                    ref,
                    () if ref.qualifier is None else ref.qualifier.anchor_labels,
                    "" if ref.qualifier is None else GROUP_OF[ref.qualifier.predicate],
                    ref.is_bearing,
                )
                for ref in refs
            ]
        return self._names[key]


def preferences(groups: Sequence[str], sampling: SamplingConfig) -> list[float]:
    """Return the weights of the names of one object, given the group of predicates of each, "" without a predicate. The
    names of a group share its weight; a name of weight 0 is used only if the object has no other name.
    """
    weights = [getattr(sampling.predicates, group, 1.0) / groups.count(group) for group in groups]
    return weights if any(weights) else [1.0] * len(groups)
