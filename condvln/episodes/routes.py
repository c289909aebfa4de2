"""Geodesic distances and paths between starts and goal points, each computed once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from condvln.compiled import register_warm_up
from condvln.episodes.kernels.ways import comes_within, least_distance, passes_through
from condvln.navigation.protocol import PathfinderProtocol
from condvln.scene import round_mm
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
    """The goal points of a scene's objects, with cached geodesic distances from any point to all of them."""

    def __init__(self, pathfinder: PathfinderProtocol, goals: Mapping[str, F64]) -> None:
        self.pathfinder = pathfinder
        self.goals = dict(goals)
        self._span: dict[str, slice] = {}
        at = 0
        for name, points in self.goals.items():
            self._span[name] = slice(at, at + len(points))
            at += len(points)
        self._points = np.concatenate([*self.goals.values(), np.empty((0, 3))])
        self._owner = np.repeat(np.arange(len(self.goals)), [len(points) for points in self.goals.values()])
        self._distances: dict[tuple[bytes, str], F64] = {}
        self._rows: dict[bytes, F64] = {}
        self._paths: dict[bytes, F64 | None] = {}

    def __contains__(self, object_id: str) -> bool:
        return object_id in self._span

    def distances(self, start: F64, object_id: str) -> F64:
        """Return geodesic distances (k,) from `start` to the goal points of an object; inf where there is no path."""
        return self._from(start.tobytes(), start, object_id)

    def _from(self, name: bytes, start: F64, object_id: str) -> F64:
        row = self._rows.get(name)
        if row is not None:
            return row[self._span[object_id]]
        key = (name, object_id)
        found = self._distances.get(key)
        if found is None:
            found = self._distances[key] = self._table(start[None], self.goals[object_id])[0]
        return found

    def rows(self, starts: F64) -> F64:
        """Return geodesic distances (s, P) from `starts` (s, 3) to all P goal points of the scene."""
        table = self._table(starts, self._points)
        self._rows.update((start.tobytes(), row) for start, row in zip(starts, table, strict=True))
        return table

    def _table(self, starts: F64, ends: F64) -> F64:
        table: F64 = np.array(self.pathfinder.distance_table(starts, ends), dtype=np.float64)
        table[~np.isfinite(table)] = np.inf
        return table

    def nearest(self, rows: F64, object_id: str) -> F64:
        """Return the least distance (s,) from each of s starts to any goal point of an object. `rows` (s, P) has the
        distances from the starts to all P goal points.
        """
        return np.asarray(rows[:, self._span[object_id]].min(axis=1), dtype=np.float64)

    def gaps(self, enough: float) -> F64:
        """Return the least geodesic distances (n, n) between the goal points of each two of the n objects, in the order
        of ``goals``.

        Both directions are computed: Detour's path from a to b may be up to 2 m longer than its path from b to a on
        real navmeshes. Gaps of `enough` metres or more count as `enough`. The diagonal is 0.
        """
        key = (enough, self._points.tobytes(), self._owner.tobytes())
        known = _GAPS.setdefault(self.pathfinder, {})
        if key not in known:
            known.clear()  # drawing and placing need the same gaps
            known[key] = self._gaps(enough)
        return known[key]

    def _gaps(self, enough: float) -> F64:
        n = len(self.goals)
        # Farther points are skipped: a geodesic is no shorter than the straight line between the snapped points.
        within = enough + 2 * SNAP_AT_MOST
        near = (
            cKDTree(self._points).query_pairs(within, output_type="ndarray") if n else np.empty((0, 2), dtype=np.intp)
        )
        near = near[self._owner[near[:, 0]] != self._owner[near[:, 1]]]
        gaps = np.full((n, n), enough)
        if len(near):
            near = np.concatenate([near, near[:, ::-1]])
            asked = self.pathfinder.geodesic_distances(self._points[near[:, 0]], self._points[near[:, 1]])
            walk = np.where(np.isfinite(asked), asked, np.inf).astype(np.float64)
            np.minimum.at(gaps, (self._owner[near[:, 0]], self._owner[near[:, 1]]), walk)
        both: F64 = np.minimum(gaps, gaps.T)
        np.fill_diagonal(both, 0.0)
        return both

    def path(self, start: F64, end: F64) -> F64 | None:
        """Return the corner points (n, 3) of the shortest path, rounded to 1 mm; None if there is no path."""
        key = start.tobytes() + end.tobytes()
        if key not in self._paths:
            found = self.pathfinder.find_path(start, end)
            self._paths[key] = round_mm(found.points) if math.isfinite(found.geodesic_distance) else None
        return self._paths[key]

    def route(self, start: F64, moves: Sequence[str]) -> Route | None:
        """Return the route from `start` to the objects of `moves` in order, each time to the nearest goal point of the
        next object; None if there is no path.
        """
        at, length = start, 0.0
        stops, pieces = [], [start[None]]
        for name in moves:
            away = self.distances(at, name)
            best = int(away.argmin())
            if not math.isfinite(away[best]):
                return None
            point = self.goals[name][best]
            piece = self.path(at, point)
            if piece is None:
                return None
            length += float(away[best])
            pieces.append(piece[1:])
            stops.append(point)
            at = point
        return Route(np.array(stops), np.concatenate(pieces), length)

    def route_lengths(self, rows: F64, moves: Sequence[str]) -> F64:
        """Return the lengths (s,) in metres of the routes through `moves` from each of s starts, as `route` builds
        them. `rows` (s, P) has the distances from the starts to all P goal points.
        """
        span = rows[:, self._span[moves[0]]]
        ends = np.argmin(span, axis=1)
        onward = {k: self._onward(self.goals[moves[0]][k], moves[1:]) for k in np.unique(ends).tolist()}
        lengths: F64 = span[np.arange(len(rows)), ends] + np.array([onward[k] for k in ends.tolist()])
        return lengths

    def _onward(self, at: F64, moves: Sequence[str]) -> float:
        """Return the length in metres of the route from a point through all of `moves`."""
        length = 0.0
        for name in moves:
            away = self.distances(at, name)
            best = int(np.argmin(away))
            length += float(away[best])
            at = self.goals[name][best]
        return length

    def ordered_goals(self, start: F64, object_id: str) -> F64:
        """Return an object's goal points (k, 3): first the one geodesically nearest to the start, then the others in
        the order of ``goals``.

        Stock sensors measure the distance to the first goal, stock measures to the nearest one; with this order both
        agree at the start. A route through stops may end at another goal point.
        """
        points = self.goals[object_id]
        first = int(self.distances(start, object_id).argmin())
        return np.concatenate([points[first : first + 1], points[:first], points[first + 1 :]])


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
