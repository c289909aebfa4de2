"""The arrays for navmesh queries, in the layout of the kernels; and the plane geometry of ``DetourCommon.cpp``: in the
ground plane xz, ignoring y unless stated.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined
from condvln.navigation.tile import WALKABLE, Floats, Indices, NavMeshTile

__all__ = ["QueryMesh", "query_mesh"]

# Positions in ``QueryMesh.grid``
BMIN, BMAX, QUANT, CLIMB, ORIGIN_X, ORIGIN_Z, TILE_WIDTH, TILE_HEIGHT = 0, 3, 6, 7, 8, 9, 10, 11
GRID_SIZE = 12

Point: TypeAlias = "tuple[np.float32, np.float32, np.float32]"
"""x, y and z in metres, in the machine's registers: an array would have to be allocated"""


class QueryMesh(NamedTuple):
    """The query data of p polygons, n detail triangles and b tree nodes. All arrays are C-contiguous, all indices
    64-bit.
    """

    verts: Floats
    """(v, 3) vertices, metres"""
    poly_verts: Indices
    """(p, 6) vertex of each corner"""
    poly_size: Indices
    """(p,) corners"""
    neighbours: Indices
    """(p, 6) polygon across each edge, -1 for a wall"""
    walkable: npt.NDArray[np.uint8]
    """(p,) 1 if habitat-sim's query filter accepts the polygon"""
    island: Indices
    """(p,) connected component"""
    tri_start: Indices
    """(p + 1,) first detail triangle"""
    tri_points: Floats
    """(n, 3, 3) corners of detail triangles"""
    tri_edges: npt.NDArray[np.uint8]
    """(n, 3) per edge from corner j to j + 1: bit 0 on the polygon's boundary, bit 1 seen from the other triangle"""
    bv_bounds: Indices
    """(b, 6) box in cells, lower then upper"""
    bv_index: Indices
    """(b,) polygon, or minus the nodes to skip"""
    grid: Floats
    """(13,) tile bounds, cells per metre, climb, Detour's grid, margin of ``boxes``"""


def query_mesh(tile: NavMeshTile, island: Indices, origin: Floats, tile_width: float, tile_height: float) -> QueryMesh:
    """Convert ``tile`` to the arrays for queries. ``origin`` (x, z), ``tile_width`` and ``tile_height`` describe the
    grid, as the tile's file states them.
    """
    corners, poly = tile.detail_triangles
    counts = np.bincount(poly, minlength=len(tile.polys))
    start = np.zeros(len(tile.polys) + 1, np.int64)
    np.cumsum(counts, out=start[1:])
    grid = np.zeros(GRID_SIZE, np.float32)
    grid[BMIN : BMIN + 3], grid[BMAX : BMAX + 3] = tile.bounds
    grid[QUANT], grid[CLIMB] = tile.header["bv_quant_factor"], tile.header["walkable_climb"]
    grid[ORIGIN_X], grid[ORIGIN_Z] = origin[0], origin[2]
    grid[TILE_WIDTH], grid[TILE_HEIGHT] = tile_width, tile_height
    return QueryMesh(
        # a copy, since numba would compile again for a read-only array
        verts=np.array(tile.verts, np.float32, order="C"),
        poly_verts=tile.poly_verts.astype(np.int64, order="C"),
        poly_size=tile.polys["vert_count"].astype(np.int64),
        neighbours=tile.neighbours.astype(np.int64, order="C"),
        walkable=((tile.polys["flags"] & WALKABLE) != 0).astype(np.uint8),
        island=np.array(island, np.int64, order="C"),
        tri_start=start,
        tri_points=np.ascontiguousarray(corners, np.float32),
        tri_edges=_edge_bits(tile, counts, start),
        bv_bounds=np.concatenate([tile.bv_nodes["bmin"], tile.bv_nodes["bmax"]], axis=1).astype(np.int64),
        bv_index=tile.bv_nodes["i"].astype(np.int64),
        grid=grid,
    )


def _edge_bits(tile: NavMeshTile, counts: npt.NDArray[np.int64], start: Indices) -> npt.NDArray[np.uint8]:
    poly = np.repeat(np.arange(len(counts)), counts)
    rows = np.arange(len(poly)) + (tile.detail_meshes["tri_base"].astype(np.int64) - start[:-1])[poly]
    tris = tile.detail_tris[rows]
    boundary = (tris[:, 3:4] >> np.array([0, 2, 4], np.uint8)) & 1
    seen_elsewhere = tris[:, [0, 1, 2]] < tris[:, [1, 2, 0]]
    bits: npt.NDArray[np.uint8] = (boundary | (seen_elsewhere.astype(np.uint8) << 1)).astype(np.uint8)
    return np.ascontiguousarray(bits)


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
def corner(points: Floats, i: int) -> Point:
    """Return row i of points (n, 3)."""
    return points[i, 0], points[i, 1], points[i, 2]


@compiled
def turn(a: Point, b: Point, c: Point) -> np.float32:
    """Return :func:`triangle_area` of three points in space, seen from above."""
    return triangle_area(a[0], a[2], b[0], b[2], c[0], c[2])


@compiled
def distance(a: Point, b: Point) -> np.float32:
    """Return the Euclidean distance in space."""
    dx = b[0] - a[0]
    dy = b[1] - a[1]
    dz = b[2] - a[2]
    return np.float32(np.sqrt(dx * dx + dy * dy + dz * dz))


@compiled
def inside_polygon(mesh: QueryMesh, poly: int, x: np.float32, z: np.float32) -> bool:
    """Return whether the vertical line through (x, z) meets the polygon (even–odd rule)."""
    verts, poly_verts, size = mesh.verts, mesh.poly_verts, mesh.poly_size[poly]
    inside = False
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
def clamp_to_polygon(mesh: QueryMesh, poly: int, point: Point) -> Point:
    """Return the point itself if it is above or below the polygon, else the nearest point on the polygon's edges."""
    x, y, z = point[0], point[1], point[2]
    if not inside_polygon(mesh, poly, x, z):
        verts, poly_verts, size = mesh.verts, mesh.poly_verts, mesh.poly_size[poly]
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
