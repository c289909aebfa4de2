"""The answer to a path query."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from condvln.navigation.tile import Floats

__all__ = ["ShortestPath"]


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
