"""Distances between points, segments, polygons and triangles in float32, with Recast's order of operations."""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.arrays import Array, Ground, Point, ground

__all__ = ["FAR", "depth_inside", "height_error", "least_extent", "segment_distance", "segment_distance_2d"]

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
