"""Navmesh queries of all episodes of a scene, collected first and then executed together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder

__all__ = ["Geodesics", "Point"]

F64 = NDArray[np.float64]
Point = tuple[float, float, float]


class Geodesics:
    """Points, distances and paths of one scene.

    First register all queries, then call `ask` once, then read the results.

    Attributes
    ----------
    positions : the registered points, by index; points (n, 3) : the same as an array
    moved (n,) : metres by which snapping moves each point; NaN if there is no navmesh nearby
    islands, island_radii : each point's island, -1 for none, and the island's radius in metres
    """

    def __init__(self) -> None:
        self._index: dict[Point, int] = {}
        self._pairs: dict[tuple[int, int], int] = {}
        self._legs: dict[tuple[int, int], int] = {}
        self._lengths: list[float] = []
        self._ways: list[tuple[float, tuple[Point, ...]]] = []
        self.positions: list[Point] = []
        self.points: F64 = np.empty((0, 3))
        self.moved: F64 = np.empty(0)
        self.islands: list[int] = []
        self.island_radii: list[float] = []

    def point(self, position: Point) -> int:
        """Register a point and return its index."""
        return self._index.setdefault(position, len(self._index))

    def pair(self, one: int, other: int) -> int:
        """Register a distance between two points and return its index."""
        return self._pairs.setdefault((one, other), len(self._pairs))

    def leg(self, one: int, other: int) -> int:
        """Register a path between two points and return its index."""
        return self._legs.setdefault((one, other), len(self._legs))

    def ask(self, pathfinder: Pathfinder) -> None:
        """Compute the results of all queries."""
        self.positions = list(self._index)
        points = self.points = np.array(self.positions).reshape(-1, 3)
        snapped, islands = pathfinder.snap_to_islands(points)
        moved = np.asarray(snapped, dtype=np.float64) - points
        self.moved = np.maximum(np.hypot(moved[:, 0], moved[:, 2]), np.abs(moved[:, 1]))
        self.islands = islands.tolist()
        radii = {k: pathfinder.island_radius(k) if k >= 0 else 0.0 for k in set(self.islands)}
        self.island_radii = [radii[k] for k in self.islands]
        if self._pairs:
            ends = np.array(list(self._pairs))
            away = pathfinder.geodesic_distances(points[ends[:, 0]], points[ends[:, 1]]).astype(np.float64)
            self._lengths = np.where(np.isnan(away), np.inf, away).tolist()
        if self._legs:
            ends = np.array(list(self._legs))
            ways = pathfinder.find_paths(points[ends[:, 0]], points[ends[:, 1]])
            corners = np.round(np.concatenate([way.points for way in ways]).astype(np.float64), 3) + 0.0
            places = [(x, y, z) for x, y, z in corners.tolist()]
            at = 0
            for way in ways:
                self._ways.append((way.geodesic_distance, tuple(places[at : at + len(way.points)])))
                at += len(way.points)

    def metres(self, pairs: Sequence[int]) -> list[float]:
        """Return the geodesic distances in metres of registered pairs; infinite where no path exists."""
        return [self._lengths[pair] for pair in pairs]

    def way(self, leg: int) -> tuple[float, tuple[Point, ...]]:
        """Return the length in metres of a registered path, and its corners, rounded to 1 mm. If there is no path, the
        length is infinite and there are no corners.
        """
        return self._ways[leg]
