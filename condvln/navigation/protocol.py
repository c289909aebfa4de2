"""What the rest of the project asks of a navigation backend, and the paths that it answers with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from condvln.navigation.sampling import RandomSource
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import Floats, Ints

__all__ = ["PathfinderProtocol", "ShortestPath"]


@runtime_checkable
class PathfinderProtocol(Protocol):
    """Shortest paths and points of one scene: over a navmesh, over a graph of viewpoints, or by habitat-sim itself.

    Points are (3,) and batches (n, 3), metres, Habitat frame. A point that can't be projected snaps to NaN; one that
    can't be reached is infinitely far.
    """

    @property
    def settings(self) -> NavMeshSettings | None:
        """Agent and cell sizes that the backend was made for; None for a graph."""

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner, (3,) each."""

    @property
    def navigable_area(self) -> float:
        """Square metres of floor; 0 for a graph."""

    @property
    def num_islands(self) -> int:
        """Number of connected components."""

    def find_path(self, start: npt.ArrayLike, end: npt.ArrayLike) -> ShortestPath:
        """Shortest path between two points."""

    def find_multi_goal_path(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> ShortestPath:
        """Shortest of the paths to several ends."""

    def geodesic_distance(self, start: npt.ArrayLike, end: npt.ArrayLike) -> float:
        """Metres along the shortest path to ``end``, or to the nearest of several."""

    def geodesic_distances(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """Metres for each of n pairs, (n,) float32; a single start or end serves all the others."""

    def distance_table(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """Metres from each of n starts to each of m ends, (n, m) float32."""

    def snap_point(self, point: npt.ArrayLike, island: int | None = None) -> Floats:
        """Nearest place (3,) that can be stood on."""

    def snap_points(self, points: npt.ArrayLike, island: int | None = None) -> Floats:
        """:meth:`snap_point` of each of n points, (n, 3)."""

    def is_navigable(self, point: npt.ArrayLike, max_y_delta: float = 0.5) -> bool:
        """Can the point be stood on?"""

    def get_island(self, point: npt.ArrayLike) -> int:
        """Index of the connected component that the point snaps to; -1 for none."""

    def get_islands(self, points: npt.ArrayLike) -> Ints:
        """:meth:`get_island` of each of n points, (n,)."""

    def island_radius(self, point_or_index: npt.ArrayLike) -> float:
        """Metres from the mean of a component to its farthest place."""

    def island_area(self, index: int) -> float:
        """Square metres of one component."""

    def get_random_navigable_points(self, count: int, rng: RandomSource, island: int | None = None) -> Floats:
        """``count`` seeded random places (count, 3)."""


def _no_points() -> Floats:
    return np.empty((0, 3), np.float32)


@dataclass(frozen=True, eq=False)
class ShortestPath:
    """A shortest path, or the fact that there is none.

    Attributes
    ----------
    geodesic_distance : metres along the path; infinite where there is none
    points : (k, 3) float32 corner points, metres, Habitat frame; empty where there is none
    closest_goal : which of several goals the path leads to; -1 where there is no path
    """

    geodesic_distance: float = float("inf")
    points: Floats = field(default_factory=_no_points)
    closest_goal: int = -1

    @property
    def found(self) -> bool:
        """Is there a path?"""
        return self.geodesic_distance < float("inf")
