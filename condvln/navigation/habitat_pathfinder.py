"""habitat-sim's own pathfinder with our protocol, if habitat-sim is installed.

It is never required: :class:`~condvln.navigation.pathfinder.Pathfinder` gives the same numbers. It exists for users who
want results from the simulator itself.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from condvln.navigation.points import many_points, one_point, paired_points
from condvln.navigation.protocol import ShortestPath
from condvln.navigation.sampling import RandomSource
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import Floats, Ints
from schemas.errors import FormatError, UsageError

__all__ = ["HabitatPathfinder"]

NO_ISLAND = -1  # habitat-sim's ID_UNDEFINED


class HabitatPathfinder:
    """``habitat_sim.nav.PathFinder`` (0.2.5 or newer) on one navmesh.

    Points are (3,) and batches (n, 3), metres, Habitat frame; batches are loops, since habitat-sim has no batch
    functions.

    Raises
    ------
    UsageError : habitat-sim is not installed
    FormatError : habitat-sim can't load the file
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        try:
            self._nav: Any = importlib.import_module("habitat_sim.nav")
        except ImportError as error:
            raise UsageError(
                "habitat-sim is not installed",
                remedy="Install it (conda install habitat-sim -c aihabitat), or use the built-in pathfinder",
            ) from error
        self._habitat: Any = self._nav.PathFinder()
        if not Path(path).is_file() or not self._habitat.load_nav_mesh(str(path)):
            raise FormatError("habitat-sim can't load this navmesh", where=Path(path), remedy="Check the file")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> HabitatPathfinder:
        """Load a pathfinder over a ``.navmesh`` file."""
        return cls(path)

    @property
    def settings(self) -> NavMeshSettings | None:
        """Settings that the navmesh was built with; None if habitat-sim does not know them."""
        found = self._habitat.nav_mesh_settings
        if found is None:
            return None
        names = NavMeshSettings.__dataclass_fields__
        return NavMeshSettings(**{name: getattr(found, name) for name in names if hasattr(found, name)})

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner of the navmesh, (3,) each, in metres."""
        low, high = self._habitat.get_bounds()
        return np.array(low, np.float32), np.array(high, np.float32)

    @property
    def navigable_area(self) -> float:
        """Navigable area in square metres."""
        return float(self._habitat.navigable_area)

    @property
    def num_islands(self) -> int:
        """Number of connected components."""
        return int(self._habitat.num_islands)

    def find_path(self, start: npt.ArrayLike, end: npt.ArrayLike) -> ShortestPath:
        """Return the shortest path between two points."""
        query = self._nav.ShortestPath()
        query.requested_start, query.requested_end = one_point(start)[0], one_point(end)[0]
        found = self._habitat.find_path(query)
        return ShortestPath(float(query.geodesic_distance), many_points(query.points), 0 if found else -1)

    def find_multi_goal_path(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> ShortestPath:
        """Return the shortest of the paths to several ends."""
        query = self._nav.MultiGoalShortestPath()
        query.requested_start, query.requested_ends = one_point(start)[0], list(many_points(ends))
        self._habitat.find_path(query)
        goal = int(query.closest_end_point_index)
        return ShortestPath(float(query.geodesic_distance), many_points(query.points), goal)

    def geodesic_distance(self, start: npt.ArrayLike, end: npt.ArrayLike) -> float:
        """Return the geodesic distance in metres to ``end``, or to the nearest of several ends; infinite if there is
        no path.
        """
        if np.ndim(end) == 2:
            return self.find_multi_goal_path(start, end).geodesic_distance
        return self.find_path(start, end).geodesic_distance

    def geodesic_distances(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """Return the geodesic distances (n,), float32, of n pairs; see :meth:`geodesic_distance`. A single start is
        paired with every end, and a single end with every start.
        """
        pairs = np.broadcast_arrays(*paired_points(starts, ends))
        return np.array([self.geodesic_distance(a, b) for a, b in zip(*pairs, strict=True)], np.float32)

    def distance_table(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """Return a table (n, m), float32, of the geodesic distances in metres from each of n starts to each of m ends;
        see :meth:`geodesic_distance`.
        """
        first, second = many_points(starts), many_points(ends)
        table = np.empty((len(first), len(second)), np.float32)
        for row, start in enumerate(first):
            table[row] = self.geodesic_distances(start, second) if len(second) else 0.0
        return table

    def snap_point(self, point: npt.ArrayLike, island: int | None = None) -> Floats:
        """Return the nearest point (3,) on the navmesh, or on one island; NaN if none is in reach."""
        chosen = NO_ISLAND if island is None else island
        return np.array(self._habitat.snap_point(one_point(point)[0], chosen), np.float32)

    def snap_points(self, points: npt.ArrayLike, island: int | None = None) -> Floats:
        """Return the positions (n, 3) to which n points snap; see :meth:`snap_point`."""
        return many_points([self.snap_point(point, island) for point in many_points(points)])

    def is_navigable(self, point: npt.ArrayLike, max_y_delta: float = 0.5) -> bool:
        """Return whether the point is on the navmesh."""
        return bool(self._habitat.is_navigable(one_point(point)[0], max_y_delta))

    def get_island(self, point: npt.ArrayLike) -> int:
        """Return the index of the island that the point snaps to; -1 if the point is off the navmesh."""
        return int(self._habitat.get_island(one_point(point)[0]))

    def get_islands(self, points: npt.ArrayLike) -> Ints:
        """Return the island indices (n,) of n points; see :meth:`get_island`."""
        return np.array([self.get_island(point) for point in many_points(points)], np.int32)

    def island_radius(self, point_or_index: npt.ArrayLike) -> float:
        """Return the radius in metres of an island, given by index or by a point."""
        where = np.asarray(point_or_index)
        return float(self._habitat.island_radius(int(where) if where.ndim == 0 else one_point(where)[0]))

    def island_area(self, index: int) -> float:
        """Return the area in square metres of one island."""
        return float(self._habitat.island_area(index))

    def get_random_navigable_points(self, count: int, rng: RandomSource, island: int | None = None) -> Floats:
        """Return ``count`` random points (count, 3). They are drawn by the C library's generator, with a seed from
        ``rng``.
        """
        self._habitat.seed(int(np.random.default_rng(rng).integers(2**31)))
        chosen = NO_ISLAND if island is None else island
        drawn = [self._habitat.get_random_navigable_point(island_index=chosen) for _ in range(count)]
        return many_points(drawn)
