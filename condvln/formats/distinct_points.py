"""Find equal points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["distinct_points"]


def distinct_points(points: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return two arrays of indices: the first point (u,) of each group of equal points, and the group (n,) of each of
    the points (n, 3). Groups ascend by x, then y, then z; no coordinate is NaN.

    The same as ``numpy.unique`` with ``axis=0``, which takes several times as long for rows of three numbers.
    """
    order = np.lexsort(points.T[::-1])
    ordered = points[order]
    begins = np.ones(len(points), dtype=np.bool_)
    begins[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    group = np.empty(len(points), dtype=np.intp)
    group[order] = np.cumsum(begins) - 1
    return order[begins], group
