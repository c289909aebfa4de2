"""Check which objects of a scene can be seen at all, with rays that are cast again for this check.

An object is visible if enough of this package's points on its surface are visible from positions in its room where an
agent can stand. The generator requires four times as much before text mentions an object, and zero of many more points
before text may ignore it. Objects in between are never mentioned, so two sets of points agree on the rest. The contents
of a shut container are not visible.
"""

from __future__ import annotations

from collections.abc import Set
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import eyes_at
from condvln.scene import Scene
from condvln.verify.certificate import Certificate
from condvln.verify.sight import Sight
from schemas.config import PlacesConfig
from schemas.config.constants import FLOOR_LIFT, SEEABLE_SHARE
from schemas.program import Program

__all__ = ["Onlookers", "check_seen"]

F64 = NDArray[np.float64]

POINTS: Final = 256
"""Number of points on an object's surface."""
SEEN_SHARE: Final = SEEABLE_SHARE / 4
"""Share of the points that must be visible."""
FEW: Final = 8
"""Stride of the positions and points that are tested first; this suffices for most objects."""


class Onlookers:
    """Finds out whether an object is visible from at least one position in its room where an agent can stand. Each
    object is tested once.

    hidden : ids of objects inside something shut
    """

    def __init__(
        self, scene: Scene, sight: Sight, pathfinder: Pathfinder, places: PlacesConfig, hidden: Set[str]
    ) -> None:
        self._scene, self._sight, self._pathfinder, self._places = scene, sight, pathfinder, places
        self._hidden = hidden
        self._eyes: dict[str, F64] = {}
        self._seen: dict[str, bool] = {}

    def see(self, object_id: str) -> bool:
        """Return whether an object is visible from some position in its room."""
        if object_id not in self._seen:
            item = self._scene.object_of.get(object_id)
            if item is None or object_id in self._hidden or item.room_id not in self._scene.room_of:
                return False
            self._look_around(item.room_id)
        return self._seen[object_id]

    def _look_around(self, room_id: str) -> None:
        """Look for all objects of a room."""
        names = [x.object_id for x in self._scene.objects if x.room_id == room_id and x.object_id not in self._hidden]
        things = [(name, self._sight.surface(name, POINTS)) for name in names]
        eyes = self._of_room(room_id)
        for stride in (FEW, 1):
            looked = [(name, points[::stride]) for name, points in things]
            least = [SEEN_SHARE * len(points) for _, points in things]
            seen = self._sight.met(looked, eyes[::stride], least)
            self._seen.update(zip([name for name, _ in things], seen, strict=True))
            things = [thing for thing, found in zip(things, seen, strict=True) if not found]

    def _of_room(self, room_id: str) -> F64:
        """Return eyes (n, 3) at the positions of a room where an agent can stand."""
        if room_id not in self._eyes:
            floor = self._sight.floor(room_id) - np.array([0.0, FLOOR_LIFT, 0.0])
            stood = np.asarray(self._pathfinder.are_navigable(floor)) if len(floor) else np.zeros(0, bool)
            self._eyes[room_id] = eyes_at(floor[stood], self._places.eye_height)
        return self._eyes[room_id]


def check_seen(program: Program, onlookers: Onlookers, certificate: Certificate) -> None:
    """Check that all objects that a text presupposes (stops, anchors and witnesses) are visible."""
    named: set[str | None] = set()
    for condition in program.conditions:
        named |= {*condition.witnesses, condition.room.anchor_id}
        named |= {*(condition.qualifier.anchor_ids if condition.qualifier else ())}
    for leaf in program.leaves:
        for move in leaf.moves:
            named |= {move.object_id, move.room.anchor_id}
            named |= {*(move.qualifier.anchor_ids if move.qualifier else ())}
    out_of_sight = sorted(name for name in named if name is not None and not onlookers.see(name))
    certificate.holds("seeable", not out_of_sight, "seen from where an agent can stand", out_of_sight)
