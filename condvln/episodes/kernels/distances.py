"""Geodesic distances between the places of a scene, only as far as a decision needs them; and tests of a path against
rectangles and points, one segment at a time, until the first hit.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined
from condvln.navigation.kernels.mesh import QueryMesh, corner
from condvln.navigation.kernels.path import MAX_POINTS, Search, new_search, route_between
from condvln.navigation.kernels.projection import NO_POLYGON, Place
from condvln.navigation.tile import Floats, Indices
from schemas.config.constants import SNAP_AT_MOST

__all__ = [
    "apart_objects",
    "comes_within",
    "distance_between",
    "least_distance",
    "nearest_point",
    "passes_through",
    "straight_distance",
    "straight_to_object",
]

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


@compiled
def straight_distance(at: Floats, one: int, other: int) -> float:
    """Return the horizontal distance in metres between two projected places, minus what two projections of one point
    may differ by: a lower bound of the length of a path.
    """
    dx = float(at[one, 0]) - float(at[other, 0])
    dz = float(at[one, 2]) - float(at[other, 2])
    return math.sqrt(dx * dx + dz * dz) - SNAP_AT_MOST


@compiled
def distance_between(
    mesh: QueryMesh,
    search: Search,
    asked: Floats,
    polys: Indices,
    at: Floats,
    one: int,
    other: int,
    points: Floats,
) -> tuple[float, int]:
    """Return the length in metres of the path from one place to another, infinite without a path, and its number of
    corners, which are written to ``points``.

    asked, polys, at : the places as requested, the polygons below them, and the places as projected
    """
    start, end = (
        Place(corner(asked, one), polys[one], corner(at, one)),
        Place(corner(asked, other), polys[other], corner(at, other)),
    )
    length, count = route_between(mesh, search, start, end, points)
    return (float(length) if math.isfinite(length) else math.inf), count


@inlined
def straight_to_object(at: Floats, start: int, begin: int, end: int) -> float:
    """Return the lower bound of `straight_distance` from a place to the places from ``begin`` to ``end``."""
    least = math.inf
    for place in range(begin, end):
        least = min(least, straight_distance(at, start, place))
    return least


@inlined
def nearest_point(
    mesh: QueryMesh,
    search: Search,
    asked: Floats,
    polys: Indices,
    at: Floats,
    start: int,
    begin: int,
    end: int,
    points: Floats,
) -> tuple[float, int]:
    """Return the geodesic distance in metres from a place to the nearest of the places from ``begin`` to ``end``, and
    which of them that is: the first of those at the same distance. Without a path, these are infinite and ``begin``.

    The place nearest by the straight line comes first; a place that is farther than the best path by the straight line
    is left out.

    Parameters
    ----------
    asked, polys, at : the places, see `distance_between`
    points : (MAX_POINTS, 3) working memory
    """
    best, chosen = math.inf, begin
    if polys[start] != NO_POLYGON:
        closest, least = begin, math.inf
        for place in range(begin, end):
            straight = straight_distance(at, start, place)
            if straight < least:
                closest, least = place, straight
        for turn in range(begin - 1, end):
            place = closest if turn < begin else turn
            if turn == closest or straight_distance(at, start, place) > best:
                continue
            found, _ = distance_between(mesh, search, asked, polys, at, start, place, points)
            if found < best or (found == best and found < math.inf and place < chosen):
                best, chosen = found, place
    return best, chosen


@compiled
def apart_objects(
    mesh: QueryMesh,
    asked: Floats,
    polys: Indices,
    at: Floats,
    first: Indices,
    least: float,
) -> npt.NDArray[np.bool_]:
    """Return a mask (n, n) of the pairs of objects whose goal points are at least ``least`` metres apart, by the paths
    in both directions.

    Of two objects, the points nearest by the straight line come first: where they are too close, nothing else is asked.

    Parameters
    ----------
    asked, polys, at : the p goal points, see `distance_between`
    first : (n + 1,) first goal point of each object
    """
    n = first.shape[0] - 1
    apart = np.ones((n, n), np.bool_)
    search, points = new_search(mesh.poly_size.shape[0]), np.empty((MAX_POINTS, 3), np.float32)
    for one in range(n):
        apart[one, one] = False
        for other in range(one + 1, n):
            closest, at_one, at_other = math.inf, first[one], first[other]
            for a in range(first[one], first[one + 1]):
                for b in range(first[other], first[other + 1]):
                    straight = straight_distance(at, a, b)
                    if straight < closest:
                        closest, at_one, at_other = straight, a, b
            if closest >= least:
                continue
            near = _is_near(mesh, search, asked, polys, at, at_one, at_other, least, points)
            for a in range(first[one], first[one + 1]):
                if near:
                    break
                for b in range(first[other], first[other + 1]):
                    if (a != at_one or b != at_other) and _is_near(mesh, search, asked, polys, at, a, b, least, points):
                        near = True
                        break
            apart[one, other] = not near
            apart[other, one] = not near
    return apart


@compiled
def _is_near(
    mesh: QueryMesh,
    search: Search,
    asked: Floats,
    polys: Indices,
    at: Floats,
    one: int,
    other: int,
    least: float,
    points: Floats,
) -> bool:
    """Return whether the path between two places is shorter than ``least`` metres in either direction."""
    if straight_distance(at, one, other) >= least:
        return False
    there, _ = distance_between(mesh, search, asked, polys, at, one, other, points)
    if there < least:
        return True
    back, _ = distance_between(mesh, search, asked, polys, at, other, one, points)
    return back < least
