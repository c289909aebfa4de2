"""The polygon nearest to a point, the point's projection onto this polygon, and uniform points on polygons:
``findNearestPoly``, ``closestPointOnPoly`` and ``dtRandomPointInConvexPoly`` of Detour.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled
from condvln.navigation.kernels.mesh import (
    BMAX,
    BMIN,
    CLIMB,
    GREATEST,
    ONE,
    ORIGIN_X,
    ORIGIN_Z,
    QUANT,
    TILE_HEIGHT,
    TILE_WIDTH,
    ZERO,
    Point,
    QueryMesh,
    height_in_triangle,
    inside_polygon,
    point_to_segment,
    triangle_area,
)
from condvln.navigation.tile import Floats, Indices

# Half extents in metres of the box in which habitat-sim searches for a polygon.
REACH_GROUND = np.float32(2.0)
REACH_HEIGHT = np.float32(4.0)
# Half extent in metres of a first, smaller search: far more than the rounding of tree boxes.
REACH_BELOW = np.float32(0.2)
# Largest horizontal distance in metres by which a navigable point is snapped, from habitat-sim's isNavigable.
NAVIGABLE_SHIFT = np.float32(1e-2)

NO_POLYGON = -1
# NumPy's scalars: for each literal that one kernel hands to another, numba would compile the other one once more.
ANY_ISLAND = np.int64(-1)
NAN = np.float32(np.nan)

BOUNDARY_ONLY, ALL_EDGES = np.bool_(True), np.bool_(False)


@compiled
def height_on_polygon(mesh: QueryMesh, poly: int, x: np.float32, z: np.float32) -> tuple[bool, np.float32]:
    """Return whether the polygon covers (x, z), and the height of its detail mesh there."""
    covered = inside_polygon(mesh, poly, x, z)
    height = ZERO
    if covered:
        found = False
        for tri in range(mesh.tri_start[poly], mesh.tri_start[poly + 1]):
            found, height = height_in_triangle(mesh.tri_points[tri], x, z)
            if found:
                break
        if not found:
            # There are only degenerate triangles here: the point is on an edge.
            _, height, _ = nearest_on_detail_edges(mesh, poly, x, z, ALL_EDGES)
    return covered, height


@compiled
def nearest_on_detail_edges(
    mesh: QueryMesh, poly: int, x: np.float32, z: np.float32, boundary_only: bool | np.bool_
) -> Point:
    """Return the horizontally nearest point on the edges of the detail mesh."""
    tri_start, tri_points, tri_edges = mesh.tri_start, mesh.tri_points, mesh.tri_edges
    best = GREATEST
    along = ZERO
    best_tri = tri_start[poly]
    best_from = 0
    for tri in range(tri_start[poly], tri_start[poly + 1]):
        j = 2
        for k in range(3):
            bits = tri_edges[tri, j]
            skipped = (bits & 1) == 0 and (boundary_only or (bits & 2) != 0)
            if not skipped:
                a = tri_points[tri, j]
                b = tri_points[tri, k]
                d, t = point_to_segment(x, z, a[0], a[2], b[0], b[2])
                if d < best:
                    best = d
                    along = t
                    best_tri = tri
                    best_from = j
            j = k
    a = tri_points[best_tri, best_from]
    b = tri_points[best_tri, best_from + 1 if best_from < 2 else 0]
    return a[0] + (b[0] - a[0]) * along, a[1] + (b[1] - a[1]) * along, a[2] + (b[2] - a[2]) * along


@compiled
def _clamped(value: np.float32, low: np.float32, high: np.float32) -> np.float32:
    if value < low:
        return low
    if value > high:
        return high
    return value


@compiled
def _cell(value: np.float32) -> int:
    return int(value) & 0xFFFF


@compiled
def nearest_polygon(
    mesh: QueryMesh, x: np.float32, y: np.float32, z: np.float32, island: int | np.int64
) -> tuple[int, np.float32, np.float32, np.float32]:
    """Return the polygon nearest to a point, and the x, y and z of the point's projection onto this polygon;
    ``NO_POLYGON`` and NaN if no polygon is in reach.

    A point above a polygon and within climbing height has distance 0. The first such polygon of the tree ends the
    search, since later ones would have to be strictly nearer.
    """
    grid = mesh.grid
    poly, px, py, pz, away = NO_POLYGON, NAN, NAN, NAN, GREATEST
    low_x, low_z = x - REACH_GROUND, z - REACH_GROUND
    high_x, high_z = x + REACH_GROUND, z + REACH_GROUND
    if (
        math.isfinite(x)
        and math.isfinite(y)
        and math.isfinite(z)
        and not math.floor((low_x - grid[ORIGIN_X]) / grid[TILE_WIDTH]) > ZERO
        and not math.floor((high_x - grid[ORIGIN_X]) / grid[TILE_WIDTH]) < ZERO
        and not math.floor((low_z - grid[ORIGIN_Z]) / grid[TILE_HEIGHT]) > ZERO
        and not math.floor((high_z - grid[ORIGIN_Z]) / grid[TILE_HEIGHT]) < ZERO
    ):
        # Most points are above a polygon, and few boxes of the tree contain such a point.
        poly, px, py, pz, away = _nearest_within(mesh, x, y, z, island, REACH_BELOW)
        if away > ZERO:
            poly, px, py, pz, away = _nearest_within(mesh, x, y, z, island, REACH_GROUND)
    return poly, px, py, pz


@compiled
def _nearest_within(
    mesh: QueryMesh, x: np.float32, y: np.float32, z: np.float32, island: int | np.int64, reach: np.float32
) -> tuple[int, np.float32, np.float32, np.float32, np.float32]:
    """Return the result of :func:`nearest_polygon` for the polygons in a box around the point, and the squared distance
    of the point from the polygon.
    """
    grid = mesh.grid
    low_x, low_y, low_z = x - reach, y - REACH_HEIGHT, z - reach
    high_x, high_y, high_z = x + reach, y + REACH_HEIGHT, z + reach
    bx, by, bz = grid[BMIN], grid[BMIN + 1], grid[BMIN + 2]
    tx, ty, tz = grid[BMAX], grid[BMAX + 1], grid[BMAX + 2]
    q = grid[QUANT]
    min_x = _cell(q * (_clamped(low_x, bx, tx) - bx)) & 0xFFFE
    min_y = _cell(q * (_clamped(low_y, by, ty) - by)) & 0xFFFE
    min_z = _cell(q * (_clamped(low_z, bz, tz) - bz)) & 0xFFFE
    max_x = _cell(q * (_clamped(high_x, bx, tx) - bx) + ONE) | 1
    max_y = _cell(q * (_clamped(high_y, by, ty) - by) + ONE) | 1
    max_z = _cell(q * (_clamped(high_z, bz, tz) - bz) + ONE) | 1

    best = GREATEST
    best_poly = NO_POLYGON
    best_x, best_y, best_z = NAN, NAN, NAN
    node = 0
    while node < mesh.bv_index.shape[0]:
        index = mesh.bv_index[node]
        box = mesh.bv_bounds[node]
        overlap = (
            min_x <= box[3]
            and max_x >= box[0]
            and min_y <= box[4]
            and max_y >= box[1]
            and min_z <= box[5]
            and max_z >= box[2]
        )
        if index >= 0 and overlap and mesh.walkable[index] and (island == ANY_ISLAND or mesh.island[index] == island):
            over, height = height_on_polygon(mesh, index, x, z)
            if over:
                cx, cy, cz = x, height, z
                d = abs(y - height) - grid[CLIMB]
                d = d * d if d > ZERO else ZERO
            else:
                cx, cy, cz = nearest_on_detail_edges(mesh, index, x, z, BOUNDARY_ONLY)
                dx, dy, dz = x - cx, y - cy, z - cz
                d = dx * dx + dy * dy + dz * dz
            if d < best:
                best = d
                best_poly = index
                best_x, best_y, best_z = cx, cy, cz
                if best <= ZERO:
                    break
        if overlap or index >= 0:
            node += 1
        else:
            node -= index
    return best_poly, best_x, best_y, best_z, best


class Place(NamedTuple):
    """A position and its projection onto the navmesh."""

    asked: Point
    """as requested"""
    poly: int
    """polygon of the projection, ``NO_POLYGON`` off the mesh"""
    at: Point
    """as projected"""


@compiled
def place_of(mesh: QueryMesh, point: Floats) -> Place:
    """Return the place of a point (3,)."""
    poly, x, y, z = nearest_polygon(mesh, point[0], point[1], point[2], ANY_ISLAND)
    return Place((point[0], point[1], point[2]), poly, (x, y, z))


@compiled
def project(mesh: QueryMesh, points: Floats, island: int | np.int64) -> tuple[Indices, Floats]:
    """Return, for n points, the nearest polygons (n,) and the snapped points (n, 3)."""
    polys = np.empty(points.shape[0], np.int64)
    snapped = np.empty((points.shape[0], 3), np.float32)
    for i in range(points.shape[0]):
        poly, x, y, z = nearest_polygon(mesh, points[i, 0], points[i, 1], points[i, 2], island)
        polys[i] = poly
        snapped[i, 0] = x
        snapped[i, 1] = y
        snapped[i, 2] = z
    return polys, snapped


@compiled
def navigable(mesh: QueryMesh, x: np.float32, y: np.float32, z: np.float32, max_y_delta: np.float32) -> bool:
    """Return whether snapping moves the point by at most ``max_y_delta`` metres in height and 1 cm horizontally, as
    habitat-sim's ``isNavigable`` requires.
    """
    poly, sx, sy, sz = nearest_polygon(mesh, x, y, z, ANY_ISLAND)
    if poly == NO_POLYGON or abs(sy - y) > max_y_delta:
        return False
    dx = x - sx
    dz = z - sz
    return bool(np.sqrt(dx * dx + dz * dz) <= NAVIGABLE_SHIFT)


@compiled
def all_navigable(mesh: QueryMesh, points: Floats, max_y_delta: np.float32) -> npt.NDArray[np.bool_]:
    """Return a mask (n,) of the points that are navigable, see :func:`navigable`."""
    answer = np.empty(points.shape[0], np.bool_)
    for i in range(points.shape[0]):
        answer[i] = navigable(mesh, points[i, 0], points[i, 1], points[i, 2], max_y_delta)
    return answer


@compiled
def top_down_view(
    mesh: QueryMesh, columns: int, rows: int, metres_per_pixel: np.float32, height: np.float32, eps: np.float32
) -> npt.NDArray[np.bool_]:
    """Return a mask (rows, columns) of the navigable points of a horizontal grid: habitat-sim's ``getTopDownView``. The
    grid begins at the mesh's lower bound; positions are accumulated in float32.
    """
    view = np.empty((rows, columns), np.bool_)
    z = mesh.grid[BMIN + 2]
    for row in range(rows):
        x = mesh.grid[BMIN]
        for column in range(columns):
            view[row, column] = navigable(mesh, x, height, z, eps)
            x = x + metres_per_pixel
        z = z + metres_per_pixel
    return view


@compiled
def ground_areas(mesh: QueryMesh) -> Floats:
    """Return twice the area (p,) of each walkable polygon in the ground plane, 0 for others: Detour's sampling
    weights.
    """
    weights = np.zeros(mesh.poly_size.shape[0], np.float32)
    for poly in range(mesh.poly_size.shape[0]):
        if mesh.walkable[poly]:
            for corner in range(2, mesh.poly_size[poly]):
                weights[poly] += max(_fan_area(mesh, poly, corner), ZERO)
    return weights


@compiled
def _fan_area(mesh: QueryMesh, poly: int, corner: int) -> np.float32:
    a = mesh.verts[mesh.poly_verts[poly, 0]]
    b = mesh.verts[mesh.poly_verts[poly, corner - 1]]
    c = mesh.verts[mesh.poly_verts[poly, corner]]
    return triangle_area(a[0], a[2], b[0], b[2], c[0], c[2])


@compiled
def points_on_polygons(mesh: QueryMesh, polys: Indices, picks: Floats, spreads: Floats) -> Floats:
    """Return points (n, 3), one on each of n polygons. A point is NaN if rounding placed it off its polygon.

    ``picks`` chooses the triangle of the polygon's fan and the position along its far edge, ``spreads`` the distance
    from the first corner; if both are uniform in [0, 1), the points are uniform on the polygon.
    """
    points = np.empty((polys.shape[0], 3), np.float32)
    for i in range(polys.shape[0]):
        poly = polys[i]
        whole = ZERO
        for corner in range(2, mesh.poly_size[poly]):
            whole += max(_fan_area(mesh, poly, corner), ZERO)
        threshold = picks[i] * whole
        passed = ZERO
        chosen = mesh.poly_size[poly] - 1
        u = ONE
        for corner in range(2, mesh.poly_size[poly]):
            area = max(_fan_area(mesh, poly, corner), ZERO)
            if threshold < passed + area:
                u = (threshold - passed) / area
                chosen = corner
                break
            passed += area
        v = np.sqrt(spreads[i])
        at_first = ONE - v
        at_before = (ONE - u) * v
        at_chosen = u * v
        a = mesh.verts[mesh.poly_verts[poly, 0]]
        b = mesh.verts[mesh.poly_verts[poly, chosen - 1]]
        c = mesh.verts[mesh.poly_verts[poly, chosen]]
        x = at_first * a[0] + at_before * b[0] + at_chosen * c[0]
        z = at_first * a[2] + at_before * b[2] + at_chosen * c[2]
        over, y = height_on_polygon(mesh, poly, x, z)
        points[i, 0] = x if over else NAN
        points[i, 1] = y if over else NAN
        points[i, 2] = z if over else NAN
    return points
