"""Distances between the leaves of each episode (a row of the manifest), for all episodes of a scene at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import compiled, register_warm_up

__all__ = ["clearances", "near_goals"]

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@compiled
def clearances(corners: F64, corner_ends: I64, goals: F64, goal_ends: I64, row_ends: I64, widest: int) -> F64:
    """For each of the l leaves, return the squared distances (l, widest) in m² from its path to the nearest goal of
    every leaf of the same episode. The entry of the leaf itself is infinite.

    corners (n, 3), goals (m, 3) : of all leaves, concatenated; corner_ends, goal_ends (l,) : end index of each leaf
    row_ends (r,) : end index of each row's leaves; widest : largest number of leaves of a row
    """
    away = np.full((len(corner_ends), widest), np.inf)
    first = 0
    for row in range(len(row_ends)):
        for leaf in range(first, row_ends[row]):
            begin = corner_ends[leaf - 1] if leaf else 0
            for other in range(first, row_ends[row]):
                if other == leaf:
                    continue
                least = np.inf
                for at in range(begin, corner_ends[leaf] - 1):
                    x, y, z = corners[at, 0], corners[at, 1], corners[at, 2]
                    dx, dy, dz = corners[at + 1, 0] - x, corners[at + 1, 1] - y, corners[at + 1, 2] - z
                    square = dx * dx + dy * dy + dz * dz
                    for goal in range(goal_ends[other - 1] if other else 0, goal_ends[other]):
                        gx, gy, gz = goals[goal, 0] - x, goals[goal, 1] - y, goals[goal, 2] - z
                        along = (gx * dx + gy * dy + gz * dz) / square if square > 0.0 else 0.0
                        along = min(max(along, 0.0), 1.0)
                        gx -= along * dx
                        gy -= along * dy
                        gz -= along * dz
                        least = min(least, gx * gx + gy * gy + gz * gz)
                away[leaf, other - first] = least
        first = row_ends[row]
    return away


@compiled
def near_goals(goals: F64, goal_ends: I64, row_ends: I64, within: float) -> I64:
    """Return the pairs of goals that are less than `within` metres apart and belong to different leaves of one episode.
    The result (k, 4) has one line for each pair: leaf, later leaf, goal of the first leaf, goal of the second leaf; all
    are indices.
    """
    found = np.empty((16, 4), dtype=np.int64)
    count = 0
    first = 0
    for row in range(len(row_ends)):
        for leaf in range(first, row_ends[row]):
            for other in range(leaf + 1, row_ends[row]):
                for one in range(goal_ends[leaf - 1] if leaf else 0, goal_ends[leaf]):
                    for two in range(goal_ends[other - 1], goal_ends[other]):
                        dx, dy = goals[one, 0] - goals[two, 0], goals[one, 1] - goals[two, 1]
                        dz = goals[one, 2] - goals[two, 2]
                        if dx * dx + dy * dy + dz * dz < within * within:
                            if count == len(found):
                                longer = np.empty((2 * count, 4), dtype=np.int64)
                                longer[:count] = found
                                found = longer
                            found[count, 0] = leaf
                            found[count, 1] = other
                            found[count, 2] = one
                            found[count, 3] = two
                            count += 1
        first = row_ends[row]
    return found[:count]


def _warm_up() -> None:
    points, ends = np.zeros((2, 3)), np.array([1, 2])
    clearances(points, ends, points, ends, np.array([2]), 2)
    near_goals(points, ends, np.array([2]), 1.0)


register_warm_up("gaps between leaves", _warm_up)
