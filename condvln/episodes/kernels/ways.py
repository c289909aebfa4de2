"""Tests of a path against rectangles and points, one segment at a time, until the first hit."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled

__all__ = ["comes_within", "least_distance", "passes_through"]

Doubles = npt.NDArray[np.float64]


@compiled
def passes_through(path: Doubles, center: Doubles, half: Doubles, axes: Doubles) -> bool:
    """Return whether any segment of a path crosses the interior of any of b rectangles in the XZ plane (slab test).

    Parameters
    ----------
    path : (n, 3) metres
    center, half : (b, 2) metres, as (x, z); axes : (b, 2, 2), columns the rectangles' unit axes
    """
    for b in range(len(center)):
        for k in range(len(path) - 1):
            ax, az = path[k, 0] - center[b, 0], path[k, 2] - center[b, 1]
            bx, bz = path[k + 1, 0] - center[b, 0], path[k + 1, 2] - center[b, 1]
            first, last = 0.0, 1.0
            for i in range(2):
                begin = ax * axes[b, 0, i] + az * axes[b, 1, i]
                way = bx * axes[b, 0, i] + bz * axes[b, 1, i] - begin
                if way != 0.0:
                    one, other = (-half[b, i] - begin) / way, (half[b, i] - begin) / way
                    first = max(first, min(one, other))
                    last = min(last, max(one, other))
                elif not abs(begin) < half[b, i]:
                    last = -math.inf  # the segment is beside the rectangle for its whole length
            if first < last:
                return True
    return False


@compiled
def least_distance(path: Doubles, points: Doubles, enough: float) -> float:
    """Return the least straight-line distance in metres between a polyline (n, 3) and points (k, 3).

    The search ends at the first distance below ``enough``.
    """
    best = math.inf
    for k in range(len(path) - 1):
        dx, dy, dz = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1], path[k + 1, 2] - path[k, 2]
        square = dx * dx + dy * dy + dz * dz
        for p in range(len(points)):
            x, y, z = points[p, 0] - path[k, 0], points[p, 1] - path[k, 1], points[p, 2] - path[k, 2]
            t = 0.0
            if square > 0.0:
                t = min(max((x * dx + y * dy + z * dz) / square, 0.0), 1.0)
            ex = points[p, 0] - (path[k, 0] + t * dx)
            ey = points[p, 1] - (path[k, 1] + t * dy)
            ez = points[p, 2] - (path[k, 2] + t * dz)
            best = min(best, math.sqrt(ex * ex + ey * ey + ez * ez))
            if best < enough:
                return best
    return best


@compiled
def comes_within(path: Doubles, points: Doubles, limit: float) -> bool:
    """Return whether a polyline (n, 3) comes within ``limit`` metres of one of the points (k, 3)."""
    return least_distance(path, points, limit) < limit
