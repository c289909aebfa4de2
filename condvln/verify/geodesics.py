"""Navmesh queries of all episodes of a scene, executed together; each different one once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder

__all__ = ["Geodesics", "Point", "Routes"]

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Point = tuple[float, float, float]


@dataclass(frozen=True, eq=False, slots=True)
class Routes:
    """Paths between points.

    metres (n,) : their lengths, infinite where no path exists
    corners (k, 3) : the corners of all different paths, rounded to 1 mm
    first, count (n,) : index of each path's first corner, and number of its corners, 0 if there is no path
    """

    metres: F64
    corners: F64
    first: I64
    count: I64


class Geodesics:
    """Points of one scene, and distances and paths between them.

    First register all points, then call `locate`.

    Attributes
    ----------
    positions : the registered points, by index; points (n, 3) : the same as an array
    moved (n,) : metres by which snapping moves each point; NaN if there is no navmesh nearby
    islands, island_radii (n,) : each point's island, -1 for none, and the island's radius in metres
    """

    def __init__(self, pathfinder: Pathfinder) -> None:
        self._pathfinder = pathfinder
        self._index: dict[Point, int] = {}
        self.positions: list[Point] = []
        self.points: F64 = np.empty((0, 3))
        self.moved: F64 = np.empty(0)
        self.islands: I64 = np.empty(0, np.int64)
        self.island_radii: F64 = np.empty(0)

    def point(self, position: Point) -> int:
        """Register a point and return its index."""
        return self._index.setdefault(position, len(self._index))

    def locate(self) -> None:
        """Find out where the registered points lie on the navmesh."""
        self.positions = list(self._index)
        points = self.points = np.array(self.positions).reshape(-1, 3)
        snapped, islands = self._pathfinder.snap_to_islands(points)
        moved = np.asarray(snapped, dtype=np.float64) - points
        self.moved = np.maximum(np.hypot(moved[:, 0], moved[:, 2]), np.abs(moved[:, 1]))
        self.islands = islands.astype(np.int64)
        found, which = np.unique(self.islands, return_inverse=True)
        self.island_radii = np.array([self._pathfinder.island_radius(k) if k >= 0 else 0.0 for k in found.tolist()])[
            which
        ]

    def metres(self, ones: I64, others: I64) -> F64:
        """Return the geodesic distances (n,) in metres between points, given by their indices (n,); infinite where no
        path exists.
        """
        ends, which = self._different(ones, others)
        away = self._pathfinder.geodesic_distances(*ends).astype(np.float64)
        return np.asarray(np.where(np.isnan(away), np.inf, away)[which])

    def routes(self, ones: I64, others: I64) -> Routes:
        """Return the paths between points, given by their indices (n,)."""
        ends, which = self._different(ones, others)
        metres, count, corners = self._pathfinder.path_corners(*ends)
        rounded = np.asarray(np.round(corners.astype(np.float64), 3) + 0.0, dtype=np.float64)
        return Routes(metres.astype(np.float64)[which], rounded, (np.cumsum(count) - count)[which], count[which])

    def _different(self, ones: I64, others: I64) -> tuple[tuple[F64, F64], I64]:
        """Return the ends (n, 3) of the different pairs, and the index of each pair among these."""
        first, which = np.unique(ones * len(self.points) + others, return_inverse=True)
        return (self.points[first // len(self.points)], self.points[first % len(self.points)]), which
