"""Branch subgoal accuracy: how many of the gold branch's subgoals were passed, in order."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from condvln.evaluation.goal_distances import Nearness, SnappedPath

__all__ = ["DistanceMode", "reached_in_order", "reached_in_order_euclidean"]

Points = npt.NDArray[np.float64]

DistanceMode = Literal["geodesic", "euclidean"]
"""How the distance to a subgoal is measured: along the floor (a ball would pass through walls), or as the authors'
code does."""


def reached_in_order(nearness: Nearness, path: SnappedPath, subgoals: Points, radius: float) -> int:
    """Length of the longest prefix of ``subgoals`` (m, 3) reached in order, geodesically nearer than ``radius``.

    One position may reach several; the start counts.
    """
    at = 0
    for number, subgoal in enumerate(subgoals):
        found = nearness.first_within(path, subgoal, radius, at)
        if found is None:
            return number
        at = found
    return len(subgoals)


def reached_in_order_euclidean(positions: Points, subgoals: Points, radius: float) -> int:
    """As the authors' public evaluator counts: straight line in 3-D, at most ``radius``, one subgoal a pose at most."""
    reached = 0
    for position in positions:
        if reached == len(subgoals):
            break
        reached += bool(np.sqrt(np.square(position - subgoals[reached]).sum()) <= radius)
    return reached
