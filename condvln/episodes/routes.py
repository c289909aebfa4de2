"""The goal points of a scene's objects, and how far these are apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from condvln.compiled import register_warm_up
from condvln.episodes.kernels.ways import comes_within, least_distance, passes_through
from condvln.navigation.protocol import PathfinderProtocol
from schemas.config.constants import SNAP_AT_MOST

__all__ = ["GoalField", "Route", "clearance"]

F64 = NDArray[np.float64]


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


_GAPS: Final[WeakKeyDictionary[PathfinderProtocol, dict[tuple[float, bytes, bytes], F64]]] = WeakKeyDictionary()
"""Cache of the latest gaps of each pathfinder in use."""


class GoalField:
    """The goal points of a scene's objects.

    Attributes
    ----------
    goals : goal points (k, 3) by object id
    points : (p, 3) those of all objects, in the order of ``goals``
    first : (n + 1,) index of the first point of each of the n objects
    """

    def __init__(self, pathfinder: PathfinderProtocol, goals: Mapping[str, F64]) -> None:
        self.pathfinder = pathfinder
        self.goals = dict(goals)
        self.points = np.concatenate([*self.goals.values(), np.empty((0, 3))])
        counts = [len(points) for points in self.goals.values()]
        self.first = np.cumsum([0, *counts], dtype=np.int64)
        self._owner = np.repeat(np.arange(len(self.goals)), counts)

    def __contains__(self, object_id: str) -> bool:
        return object_id in self.goals

    def gaps(self, enough: float) -> F64:
        """Return the least geodesic distances (n, n) between the goal points of each two of the n objects, in the order
        of ``goals``.

        Both directions are computed: Detour's path from a to b may be up to 2 m longer than its path from b to a on
        real navmeshes. Gaps of `enough` metres or more count as `enough`. The diagonal is 0.
        """
        key = (enough, self.points.tobytes(), self._owner.tobytes())
        known = _GAPS.setdefault(self.pathfinder, {})
        if key not in known:
            known.clear()  # drawing and placing need the same gaps
            known[key] = self._gaps(enough)
        return known[key]

    def _gaps(self, enough: float) -> F64:
        n = len(self.goals)
        # Farther points are skipped: a geodesic is no shorter than the straight line between the snapped points.
        within = enough + 2 * SNAP_AT_MOST
        near = cKDTree(self.points).query_pairs(within, output_type="ndarray") if n else np.empty((0, 2), dtype=np.intp)
        near = near[self._owner[near[:, 0]] != self._owner[near[:, 1]]]
        gaps = np.full((n, n), enough)
        if len(near):
            near = np.concatenate([near, near[:, ::-1]])
            asked = self.pathfinder.geodesic_distances(self.points[near[:, 0]], self.points[near[:, 1]])
            walk = np.where(np.isfinite(asked), asked, np.inf).astype(np.float64)
            np.minimum.at(gaps, (self._owner[near[:, 0]], self._owner[near[:, 1]]), walk)
        both: F64 = np.minimum(gaps, gaps.T)
        np.fill_diagonal(both, 0.0)
        return both


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
