"""The possible stops of a program: objects that can be named and reached, and which of them are far enough apart."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.predicates import GROUP_OF
from condvln.instructions.referents import Referents
from condvln.labels import Vocabulary
from condvln.scene import Scene
from schemas.config import PlacesConfig, SamplingConfig

__all__ = ["Stops", "Target", "Targets", "apart_by_centres", "nameable", "targets"]


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
    clear : the object has a name other than those used only if nothing else can be named ("the chair away from the
        desk")
    """

    object_id: str
    position: int
    room_id: str
    index: int
    label: str
    weight: float
    clear: bool


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
    """Return the objects of the given `rooms` that text can name and that can be reached."""
    row_of = {name: k for k, name in enumerate(stops.object_ids)}
    chosen = [(room_id, i, row_of[name]) for room_id, i, name in nameable(referents, rooms) if name in row_of]
    rows = [row for _, _, row in chosen]
    alike = _alike([(room_id, referents[room_id].arrays.labels[i]) for room_id, i, _ in chosen], words)
    apart = stops.apart[np.ix_(rows, rows)] & ~alike
    large = {referents[room_id].arrays.labels[i] for room_id, i, _ in chosen if not referents[room_id].small[i]}
    found = tuple(
        Target(
            object_id=referents[room_id].arrays.object_ids[i],
            position=k,
            room_id=room_id,
            index=i,
            label=referents[room_id].arrays.labels[i],
            weight=1.0 if referents[room_id].arrays.labels[i] in large else sampling.small_target_weight,
            clear=_is_clear(referents[room_id], i, sampling),
        )
        for k, (room_id, i, _) in enumerate(chosen)
    )
    return Targets(found, apart, alike)


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
