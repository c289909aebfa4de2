"""The goal points of a scene's objects, and how far these are apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import register_warm_up
from condvln.episodes.kernels.distances import apart_objects
from condvln.episodes.kernels.ways import comes_within, least_distance, passes_through
from condvln.navigation.kernels.projection import ANY_ISLAND, project
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.points import many_points

__all__ = ["GoalField", "Route", "clearance"]

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class Route:
    """The path from a start through a leaf's stops.

    stops : (m, 3) the chosen point of each move, the last one the goal
    path : (n, 3) corner points rounded to 1 mm
    length : metres along the path through the stops
    """

    stops: F64
    path: F64
    length: float


_APART: Final[WeakKeyDictionary[Pathfinder, dict[tuple[float, bytes, bytes], Bools]]] = WeakKeyDictionary()
"""Cache of the latest answer of each pathfinder in use."""


class GoalField:
    """The goal points of a scene's objects.

    Attributes
    ----------
    goals : goal points (k, 3) by object id
    points : (p, 3) those of all objects, in the order of ``goals``
    first : (n + 1,) index of the first point of each of the n objects
    """

    def __init__(self, pathfinder: Pathfinder, goals: Mapping[str, F64]) -> None:
        self.pathfinder = pathfinder
        self.goals = dict(goals)
        self.points = np.concatenate([*self.goals.values(), np.empty((0, 3))])
        counts = [len(points) for points in self.goals.values()]
        self.first = np.cumsum([0, *counts], dtype=np.int64)

    def __contains__(self, object_id: str) -> bool:
        return object_id in self.goals

    def apart(self, least: float) -> Bools:
        """Return a mask (n, n) of the pairs of objects, in the order of ``goals``, whose goal points are at least
        `least` metres apart, by the geodesic distances in both directions. No object is apart from itself.

        Both directions count: Detour's path from a to b may be up to 2 m longer than its path from b to a on real
        navmeshes.
        """
        key = (least, self.points.tobytes(), self.first.tobytes())
        known = _APART.setdefault(self.pathfinder, {})
        if key not in known:
            known.clear()  # drawing and placing ask the same
            mesh, asked = self.pathfinder.query_mesh, many_points(self.points)
            known[key] = apart_objects(mesh, asked, *project(mesh, asked, ANY_ISLAND), self.first, least)
        return known[key]

    def gap(self, one: int, other: int) -> float:
        """Return the least geodesic distance in metres between the goal points of two objects, in either direction."""
        here, there = (self.points[self.first[k] : self.first[k + 1]] for k in (one, other))
        ways = (self.pathfinder.distance_table(*ends) for ends in ((here, there), (there, here)))
        return min(float(np.where(np.isnan(table), np.inf, table).min()) for table in ways)


def clearance(path: F64, points: F64) -> float:
    """Return the least straight-line distance in metres between a polyline (n, 3) and points (k, 3).

    A straight line is never longer than a geodesic, so this is also a lower bound of the geodesic clearance.
    """
    return least_distance(path, points, 0.0)


def _warm_up() -> None:
    line, square = np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[0.5, 0.5]])
    passes_through(line, square, square, np.eye(2)[None])
    comes_within(line, line + 1.0, 0.5)


register_warm_up("ways of episodes", _warm_up)
