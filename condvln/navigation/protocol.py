"""The paths that pathfinders return."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.navigation.tile import Floats

if TYPE_CHECKING:
    from condvln.navigation.pathfinder import Pathfinder

__all__ = ["MultiGoalShortestPath", "PathfinderProtocol", "ShortestPath"]


PathfinderProtocol: TypeAlias = "Pathfinder"
"""The pathfinder, for modules that need no more than its type."""


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
