"""The expected output of a run for one scene, predicted from its rooms and labels before any relation is computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.borders import NO_BORDER, borders
from condvln.instructions.referents import Referents, room_refs
from condvln.labels import vocabulary
from condvln.scene import Scene

__all__ = ["SceneYield", "scene_yield"]


@dataclass(frozen=True, slots=True)
class SceneYield:
    """The expected output of a run for one scene.

    nothing : why there will be no instructions; empty where there may be some
    rooms, named : its rooms, and those that text can tell apart
    absence : rooms where something can be said to be absent
    blocked : (room, label) pairs whose absence would be claimed, were it not for something that may bear the label
    nameless : objects of no label of their own that block some; hidden : objects in something shut
    """

    scene_id: str
    nothing: str
    rooms: int
    named: int
    absence: int
    blocked: int
    nameless: int
    hidden: int

    def document(self) -> dict[str, Any]:
        """Return the prediction as ``--json`` prints it."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class _NoFacts:
    """A stand-in for a scene's facts that knows no relations, so that only labels can name rooms."""

    status: Mapping[str, NDArray[np.int8]]
    margin: Mapping[str, NDArray[np.float64]]
    denied: Mapping[str, NDArray[np.bool_]]
    excluded: Mapping[str, NDArray[np.bool_]]

    def between(self, pairs: NDArray[np.intp]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        return np.zeros((0, len(pairs)), np.int8), np.zeros((0, len(pairs)))

    def closest(self, rival: NDArray[np.bool_]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        return np.zeros(rival.shape, np.int8), np.zeros(rival.shape)

    def sizes(self, rival: NDArray[np.bool_]) -> Mapping[str, NDArray[np.int8]]:
        return {}


def scene_yield(scene: Scene, anchor_size: float) -> SceneYield:
    """Predict the output of a run for a scene, from its rooms and labels.

    anchor_size : least longest side of a thing that names a room, metres
    """
    facts, astride = _NoFacts({}, {}, {}, {}), borders(scene)
    referents = [
        Referents.of(
            room,
            scene.arrays(room.room_id),
            facts,
            vocabulary,
            anchor_size,
            scene.family,
            border=astride.get(room.room_id, NO_BORDER),
        )
        for room in scene.rooms
    ]
    named = room_refs(referents, vocabulary) if referents else {}
    everywhere = {label for label in vocabulary.labels if vocabulary.fit_for_text(label)}
    absence = blocked = 0
    for one in referents:
        if not one.complete or not one.room.asked:
            continue
        elsewhere = everywhere
        if not scene.single_room:
            elsewhere = everywhere & {o.label for o in scene.objects if o.room_id != one.room.room_id}
        lacking = {x for x in elsewhere if vocabulary.overlapping(x).isdisjoint(one.arrays.labels)}
        sure = {x for x in lacking if one.lacks(x, vocabulary)}
        absence += bool(sure)
        blocked += len(lacking - sure)
    return SceneYield(
        scene_id=scene.scene_id,
        nothing=_nothing(scene, referents, bool(named)),
        rooms=len(scene.rooms),
        named=len(named),
        absence=absence,
        blocked=blocked,
        nameless=sum(
            bool(vocabulary.may_be(item.label, scene.family, None if item.size is None else float(item.size.max())))
            for item in scene.objects
        ),
        hidden=sum(item.hidden for item in scene.objects),
    )


def _nothing(scene: Scene, referents: list[Referents], named: bool) -> str:
    if len(scene.objects) < 2:
        return "fewer than two objects: nothing to relate or to choose between"
    if not any(one.room.asked for one in referents):
        return "its annotation was checked by nobody, so no room is asked; 'absence: never' asks what claims no absence"
    if not named:
        return "no room has a name of its own"
    if sum(int(one.nameable.sum()) for one in referents) < 2:
        return "fewer than two objects that text can name"
    return ""
