"""Plane geometry of ``DetourCommon.cpp``: in the ground plane xz, ignoring y unless stated."""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.tile import Floats, Indices

ZERO = np.float32(0.0)
ONE = np.float32(1.0)
HALF = np.float32(0.5)
GREATEST = np.float32(np.finfo(np.float32).max)
# A detail triangle of less than half this area (m²) contains no point (Detour's EPS in dtClosestHeightPointTriangle).
DEGENERATE_TRIANGLE = np.float32(1e-6)


@compiled
def point_to_segment(
    x: np.float32, z: np.float32, px: np.float32, pz: np.float32, qx: np.float32, qz: np.float32
) -> tuple[np.float32, np.float32]:
    """Return the squared distance from (x, z) to the segment p–q, and where on the segment the nearest point is (0 at
    p, 1 at q).
    """
    pqx = qx - px
    pqz = qz - pz
    dx = x - px
    dz = z - pz
    d = pqx * pqx + pqz * pqz
    t = pqx * dx + pqz * dz
    if d > ZERO:
        t = t / d
    if t < ZERO:
        t = ZERO
    elif t > ONE:
        t = ONE
    dx = px + t * pqx - x
    dz = pz + t * pqz - z
    return dx * dx + dz * dz, t


@compiled
def triangle_area(
    ax: np.float32, az: np.float32, bx: np.float32, bz: np.float32, cx: np.float32, cz: np.float32
) -> np.float32:
    """Return twice the signed area of the triangle a, b, c in the ground plane, with the sign of Detour's
    ``dtTriArea2D``.
    """
    abx = bx - ax
    abz = bz - az
    acx = cx - ax
    acz = cz - az
    return acx * abz - abx * acz


@compiled
def distance(
    ax: np.float32, ay: np.float32, az: np.float32, bx: np.float32, by: np.float32, bz: np.float32
) -> np.float32:
    """Return the Euclidean distance in space."""
    dx = bx - ax
    dy = by - ay
    dz = bz - az
    return np.float32(np.sqrt(dx * dx + dy * dy + dz * dz))


@compiled
def inside_polygon(
    verts: Floats, poly_verts: Indices, poly_size: Indices, poly: int, x: np.float32, z: np.float32
) -> bool:
    """Return whether the vertical line through (x, z) meets the polygon (even–odd rule). The arrays are those of the
    ``QueryMesh``.
    """
    inside = False
    size = poly_size[poly]
    j = size - 1
    for i in range(size):
        vi = poly_verts[poly, i]
        vj = poly_verts[poly, j]
        xi = verts[vi, 0]
        zi = verts[vi, 2]
        zj = verts[vj, 2]
        if (zi > z) != (zj > z) and x < (verts[vj, 0] - xi) * (z - zi) / (zj - zi) + xi:
            inside = not inside
        j = i
    return inside


@inlined
def height_in_triangle(corner: Floats, x: np.float32, z: np.float32) -> tuple[bool, np.float32]:
    """Return whether (x, z) is inside the triangle ``corner`` (3, 3), and the triangle's height there."""
    v0x = corner[2, 0] - corner[0, 0]
    v0z = corner[2, 2] - corner[0, 2]
    v1x = corner[1, 0] - corner[0, 0]
    v1z = corner[1, 2] - corner[0, 2]
    v2x = x - corner[0, 0]
    v2z = z - corner[0, 2]
    denom = v0x * v1z - v0z * v1x
    if abs(denom) < DEGENERATE_TRIANGLE:
        return False, ZERO
    u = v1z * v2x - v1x * v2z
    v = v0x * v2z - v0z * v2x
    if denom < ZERO:
        denom = -denom
        u = -u
        v = -v
    if u >= ZERO and v >= ZERO and (u + v) <= denom:
        v0y = corner[2, 1] - corner[0, 1]
        v1y = corner[1, 1] - corner[0, 1]
        return True, corner[0, 1] + (v0y * u + v1y * v) / denom
    return False, ZERO


@compiled
def clamp_to_polygon(
    verts: Floats, poly_verts: Indices, poly_size: Indices, poly: int, x: np.float32, y: np.float32, z: np.float32
) -> tuple[np.float32, np.float32, np.float32]:
    """Return the point itself if it is above or below the polygon, else the nearest point on the polygon's edges. The
    arrays are those of the ``QueryMesh``.
    """
    if not inside_polygon(verts, poly_verts, poly_size, poly, x, z):
        size = poly_size[poly]
        nearest = GREATEST
        along = ZERO
        edge = 0
        for i in range(size):
            a = poly_verts[poly, i]
            b = poly_verts[poly, i + 1 if i + 1 < size else 0]
            d, t = point_to_segment(x, z, verts[a, 0], verts[a, 2], verts[b, 0], verts[b, 2])
            if d < nearest:
                nearest = d
                along = t
                edge = i
        a = poly_verts[poly, edge]
        b = poly_verts[poly, edge + 1 if edge + 1 < size else 0]
        x = verts[a, 0] + (verts[b, 0] - verts[a, 0]) * along
        y = verts[a, 1] + (verts[b, 1] - verts[a, 1]) * along
        z = verts[a, 2] + (verts[b, 2] - verts[a, 2]) * along
    return x, y, z
