"""The interface of navigation backends, and the paths they return."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from condvln.navigation.points import RandomSource
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import Floats, Ints

__all__ = ["MultiGoalShortestPath", "PathfinderProtocol", "ShortestPath"]


@runtime_checkable
class PathfinderProtocol(Protocol):
    """Shortest paths and navigable points of one scene. An implementation uses a navmesh, a graph of viewpoints, or
    habitat-sim itself.

    Points are (3,) and batches (n, 3), metres, Habitat frame. A point that can't be projected snaps to NaN; the
    distance to a point that can't be reached is infinite.
    """

    @property
    def settings(self) -> NavMeshSettings | None:
        """Agent and cell sizes for which the backend was built; None for a graph."""

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner of the navmesh or graph, (3,) each, in metres."""

    @property
    def navigable_area(self) -> float:
        """Navigable area in square metres; 0 for a graph."""

    @property
    def num_islands(self) -> int:
        """Number of connected components."""

    def find_path(self, start: npt.ArrayLike, end: npt.ArrayLike) -> ShortestPath:
        """Return the shortest path between two points."""

    def find_multi_goal_path(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> ShortestPath:
        """Return the shortest of the paths to several ends."""

    def geodesic_distance(self, start: npt.ArrayLike, end: npt.ArrayLike) -> float:
        """Return the geodesic distance in metres to ``end``, or to the nearest of several ends."""

    def geodesic_distances(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """Return the distances (n,), float32, in metres of n pairs. A single start is paired with every end, and a
        single end with every start.
        """

    def distance_table(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """Return a table (n, m), float32, of the distances in metres from each of n starts to each of m ends."""

    def snap_point(self, point: npt.ArrayLike, island_index: int | None = None) -> Floats:
        """Return the nearest navigable point (3,)."""

    def snap_points(self, points: npt.ArrayLike, island: int | None = None) -> Floats:
        """Return the positions (n, 3) to which n points snap; see :meth:`snap_point`."""

    def is_navigable(self, point: npt.ArrayLike, max_y_delta: float = 0.5) -> bool:
        """Return whether the point is navigable."""

    def get_island(self, point: npt.ArrayLike) -> int:
        """Return the index of the connected component that the point snaps to; -1 if the point is off the navmesh or
        graph.
        """

    def get_islands(self, points: npt.ArrayLike) -> Ints:
        """Return the component indices (n,) of n points; see :meth:`get_island`."""

    def island_radius(self, point_or_index: npt.ArrayLike) -> float:
        """Return the distance in metres from the mean of a connected component's points to the farthest of them. The
        component is given by its index or by a point in it.
        """

    def island_area(self, island_index: int) -> float:
        """Return the area in square metres of one component."""

    def get_random_navigable_points(self, count: int, rng: RandomSource, island: int | None = None) -> Floats:
        """Return ``count`` seeded random navigable points (count, 3)."""


def _no_points() -> Floats:
    return np.empty((0, 3), np.float32)


@dataclass(eq=False)
class ShortestPath:
    """A shortest path, or the fact that there is none. As in habitat-sim, it is also a query: a caller sets
    ``requested_start`` and ``requested_end``, and ``Pathfinder.find_path(path)`` fills in the rest.

    Attributes
    ----------
    geodesic_distance : metres along the path; infinite if there is none
    points : (k, 3) float32 corner points, metres, Habitat frame; empty if there is none
    closest_goal : index of the goal that the path leads to; -1 if there is no path
    requested_start, requested_end : (3,) metres; None where the path is an answer only
    """

    geodesic_distance: float = float("inf")
    points: Floats = field(default_factory=_no_points)
    closest_goal: int = -1
    requested_start: npt.ArrayLike | None = None
    requested_end: npt.ArrayLike | None = None

    @property
    def found(self) -> bool:
        """Whether there is a path."""
        return self.geodesic_distance < float("inf")


@dataclass(eq=False)
class MultiGoalShortestPath:
    """habitat-sim's query for the shortest of the paths to several ends; ``Pathfinder.find_path(path)`` fills it in.

    Attributes
    ----------
    requested_start : (3,) metres
    requested_ends : (n, 3) metres
    points, geodesic_distance : those of `ShortestPath`
    closest_end_point_index : index of the end that the path leads to; -1 if there is no path
    """

    requested_start: npt.ArrayLike | None = None
    requested_ends: npt.ArrayLike | None = None
    points: Floats = field(default_factory=_no_points)
    geodesic_distance: float = float("inf")
    closest_end_point_index: int = -1
