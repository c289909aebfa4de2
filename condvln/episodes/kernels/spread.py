"""Choose points that are far from one another."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, register_warm_up

__all__ = ["farthest_points"]

Doubles = npt.NDArray[np.float64]


@compiled
def farthest_points(
    points: Doubles, count: int, excluded: npt.NDArray[np.bool_], least: float
) -> npt.NDArray[np.int64]:
    """Return the indices of up to ``count`` of the points (n, 3): the first one, then repeatedly the one farthest from
    all before that is not ``excluded`` (n,), the earliest on ties, as long as it is at least ``least`` metres away.
    """
    gap = np.empty(len(points))
    taken = np.zeros(max(1, min(count, len(points))), np.int64)
    size = 1
    for k in range(len(points)):
        gap[k] = -1.0 if excluded[k] else math.inf
    while True:
        last, following = taken[size - 1], 0
        for k in range(len(points)):
            dx = points[k, 0] - points[last, 0]
            dy = points[k, 1] - points[last, 1]
            dz = points[k, 2] - points[last, 2]
            gap[k] = min(gap[k], math.sqrt(dx * dx + dy * dy + dz * dz))
            if gap[k] > gap[following]:
                following = k
        if size == len(taken) or gap[following] < least:
            return taken[:size].copy()
        taken[size] = following
        size += 1


def _warm_up() -> None:
    farthest_points(np.zeros((1, 3)), 1, np.zeros(1, bool), 0.1)


register_warm_up("goal points of objects", _warm_up)
