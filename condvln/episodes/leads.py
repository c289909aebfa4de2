"""Where leads end: places well inside a room from which an agent that turns recognises what decides a condition."""

from __future__ import annotations

import numpy as np
import shapely

from condvln.arrays import F64, Bools
from condvln.episodes.goals import is_standable
from condvln.episodes.observability import Observer
from condvln.kept import kept
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import eyes_at
from condvln.scene import Scene, round_mm
from schemas.config import PlacesConfig
from schemas.config.constants import LEAD_INSIDE, SINK
from schemas.program import Condition

__all__ = ["LeadPlaces"]


class LeadPlaces:
    """The places of one scene at which leads may end.

    Parameters
    ----------
    places : (p, 3) where an agent can look around, in all rooms
    starts : (s, 3)
    """

    def __init__(
        self, scene: Scene, pathfinder: Pathfinder, observer: Observer, rules: PlacesConfig, places: F64, starts: F64
    ) -> None:
        self._pathfinder, self._observer, self._eye_height = pathfinder, observer, rules.eye_height
        self._starts, self._rooms = starts, {room.room_id: room for room in scene.rooms}
        found = round_mm(places)
        self._places = found[is_standable(pathfinder, found, rules)]

    def holds(self, room_id: str, points: F64, inside: float = 0.0) -> Bools:
        """Return a mask (n,) of the points (n, 3) that are in a room or on its outline, at least `inside` metres from
        the outline.
        """
        room = self._rooms[room_id]
        if room.polygon is None:
            return np.zeros(len(points), bool)
        outline, at = shapely.make_valid(shapely.Polygon(room.polygon)), shapely.points(points[:, ::2])
        level = np.abs(points[:, 1] - room.floor_y) <= SINK
        return np.asarray(level & shapely.covers(outline, at) & (shapely.distance(outline.boundary, at) >= inside))

    @kept
    def points(self, room_id: str) -> F64:
        """Return the places (n, 3) of a room, in the order of their mean distance from the starts outside: one comes to
        the first ones soonest.
        """
        found = self._places[self.holds(room_id, self._places, LEAD_INSIDE)]
        outside = self._starts[~self.holds(room_id, self._starts)]
        if len(found) and len(outside):
            metres = np.asarray(self._pathfinder.distance_table(outside, found), np.float64)
            joined = np.isfinite(metres)
            total, ways = np.where(joined, metres, 0.0).sum(axis=0), joined.sum(axis=0)
            mean = np.where(ways > 0, total / np.maximum(ways, 1), np.inf)
            found = found[mean.argsort(kind="stable")]
        return found

    @kept
    def showing(self, condition: Condition) -> Bools:
        """Return a mask (n,) of the places of a condition's room from which it can be decided, whatever its truth is.

        Whether a lamp is near the bed is decided by all things that may be meant, and the bed; whether there is a lamp,
        by the floor and by the lamps that there are. So having such a place tells nothing of the truth.
        """
        eyes = eyes_at(self.points(condition.room.room_id), self._eye_height)
        seen = [self._observer.shows(need, eyes) for need in self._observer.either_way(condition)]
        return np.asarray(np.all(seen, axis=0))
