"""What the kernels of a build share: the types of their arrays, growth of arrays whose final length is unknown, and
plane geometry on the grid and in metres.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined

__all__ = [
    "FAR",
    "Array",
    "Ground",
    "Point",
    "coincide",
    "depth_inside",
    "ground",
    "grown",
    "height_error",
    "in_cone",
    "least_extent",
    "point",
    "segment_distance",
    "segment_distance_2d",
    "segments_cross",
    "segments_touch",
    "turn",
]

# Kernels do integer and float32 arithmetic on array elements; each docstring names the dtype it expects.
Array: TypeAlias = npt.NDArray[Any]
# A point as kernels pass it: plain numbers, since a view of an array row would be reference-counted at each call.
Ground: TypeAlias = "tuple[Any, Any]"
Point: TypeAlias = "tuple[Any, Any, Any]"


@compiled
def grown(array: Array, needed: int) -> Array:
    """Return ``array`` itself if it has room for ``needed`` rows, else a copy of at least twice its length."""
    if needed <= len(array):
        return array
    larger = np.empty((max(needed, 2 * len(array)), *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


@compiled
def ground(points: Array, i: int) -> Ground:
    """Return x and z of the point in row i."""
    return points[i, 0], points[i, 2]


@compiled
def point(points: Array, i: int) -> Point:
    """Return x, y and z of the point in row i."""
    return points[i, 0], points[i, 1], points[i, 2]


@compiled
def turn(a: Ground, b: Ground, c: Ground) -> int:
    """Return twice the signed area of a, b, c: negative if c is left of the line from a to b, 0 on it."""
    abx, abz = b[0] - a[0], b[1] - a[1]
    acx, acz = c[0] - a[0], c[1] - a[1]
    return int(abx * acz - acx * abz)


@compiled
def coincide(a: Ground, b: Ground) -> bool:
    """Return whether two points have the same x and z."""
    return bool(a[0] == b[0] and a[1] == b[1])


@compiled
def segments_cross(a: Ground, b: Ground, c: Ground, d: Ground) -> bool:
    """Return whether segments ab and cd share a point that is inside both."""
    abc, abd, cda, cdb = turn(a, b, c), turn(a, b, d), turn(c, d, a), turn(c, d, b)
    if abc == 0 or abd == 0 or cda == 0 or cdb == 0:
        return False
    return (abc < 0) != (abd < 0) and (cda < 0) != (cdb < 0)


@compiled
def _on_segment(a: Ground, b: Ground, c: Ground) -> bool:
    """Return whether c lies on the closed segment ab."""
    if turn(a, b, c) != 0:
        return False
    k = 0 if a[0] != b[0] else 1
    return bool((a[k] <= c[k] and c[k] <= b[k]) or (a[k] >= c[k] and c[k] >= b[k]))


@compiled
def segments_touch(a: Ground, b: Ground, c: Ground, d: Ground) -> bool:
    """Return whether segments ab and cd share any point."""
    return (
        segments_cross(a, b, c, d)
        or _on_segment(a, b, c)
        or _on_segment(a, b, d)
        or _on_segment(c, d, a)
        or _on_segment(c, d, b)
    )


@compiled
def in_cone(before: Ground, corner: Ground, after: Ground, point: Ground, loose: bool) -> bool:
    """Return whether the segment from a polygon's ``corner`` to ``point`` starts inside the polygon.

    With ``loose`` a segment along one of the two edges counts at a convex corner.
    """
    if turn(before, corner, after) <= 0:  # convex or straight
        limit = 0 if loose else -1
        return turn(corner, point, before) <= limit and turn(point, corner, after) <= limit
    return not (turn(corner, point, after) <= 0 and turn(point, corner, before) <= 0)


FAR = np.float32(np.finfo(np.float32).max)
# Tolerance of barycentric coordinates.
INSIDE_EPSILON = np.float32(1e-4)


@compiled
def segment_distance_2d(p: Ground, a: Ground, b: Ground) -> np.float32:
    """Return the squared distance from a point to a segment in the ground plane."""
    abx, abz = b[0] - a[0], b[1] - a[1]
    dx, dz = p[0] - a[0], p[1] - a[1]
    length = abx * abx + abz * abz
    t = abx * dx + abz * dz
    if length > 0:
        t /= length
    t = max(np.float32(0), min(t, np.float32(1)))
    dx = a[0] + t * abx - p[0]
    dz = a[1] + t * abz - p[1]
    return np.float32(dx * dx + dz * dz)


@inlined
def segment_distance(p: Point, a: Point, b: Point) -> np.float32:
    """Return the squared distance from a point to a segment in space."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    dx, dy, dz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    length = abx * abx + aby * aby + abz * abz
    t = abx * dx + aby * dy + abz * dz
    if length > 0:
        t /= length
    t = max(np.float32(0), min(t, np.float32(1)))
    dx = a[0] + t * abx - p[0]
    dy = a[1] + t * aby - p[1]
    dz = a[2] + t * abz - p[2]
    return np.float32(dx * dx + dy * dy + dz * dz)


@inlined
def depth_inside(polygon: Array, n: int, p: Ground) -> np.float32:
    """Return the squared distance from ``p`` to the polygon's border in the ground plane, with a minus sign if ``p`` is
    inside.
    """
    nearest = FAR
    inside = False
    j = n - 1
    for i in range(n):
        a, b = ground(polygon, i), ground(polygon, j)
        if (a[1] > p[1]) != (b[1] > p[1]) and p[0] < (b[0] - a[0]) * (p[1] - a[1]) / (b[1] - a[1]) + a[0]:
            inside = not inside
        nearest = min(nearest, segment_distance_2d(p, b, a))
        j = i
    return -nearest if inside else nearest


@inlined
def height_error(p: Point, a: Point, b: Point, c: Point) -> np.float32:
    """Return the vertical distance from a point to a triangle; FAR if the triangle is neither above nor below the
    point.
    """
    ux, uz = c[0] - a[0], c[2] - a[2]
    vx, vz = b[0] - a[0], b[2] - a[2]
    px, pz = p[0] - a[0], p[2] - a[2]
    uu = ux * ux + uz * uz
    uv = ux * vx + uz * vz
    up = ux * px + uz * pz
    vv = vx * vx + vz * vz
    vp = vx * px + vz * pz
    inverse = np.float32(1) / (uu * vv - uv * uv)
    s = (vv * up - uv * vp) * inverse
    t = (uu * vp - uv * up) * inverse
    if s >= -INSIDE_EPSILON and t >= -INSIDE_EPSILON and s + t <= np.float32(1) + INSIDE_EPSILON:
        y = a[1] + (c[1] - a[1]) * s + (b[1] - a[1]) * t
        return np.float32(abs(y - p[1]))
    return FAR


@inlined
def least_extent(polygon: Array, n: int) -> np.float32:
    """Return the width of the polygon in metres. For each edge, the distance of the farthest vertex is measured; the
    width is the least of these distances.
    """
    least = FAR
    for i in range(n):
        after = (i + 1) % n
        farthest = np.float32(0)
        for j in range(n):
            if j != i and j != after:
                farthest = max(
                    farthest, segment_distance_2d(ground(polygon, j), ground(polygon, i), ground(polygon, after))
                )
        least = min(least, farthest)
    return np.float32(np.sqrt(least))
