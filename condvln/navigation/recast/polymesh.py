"""Stage 10: convex polygons of the contours, and their shared edges (``rcBuildPolyMesh`` of Recast).

A contour is triangulated on the integer grid by cutting the ear with the shortest diagonal (``triangulate``); then
triangles are merged. Recast also removes vertices on the borders of tiles; a build without borders has none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.contours import Contours
from condvln.navigation.recast.geometry import (
    Array,
    Ground,
    coincide,
    ground,
    in_cone,
    segments_cross,
    segments_touch,
    turn,
)
from schemas.errors import FormatError

__all__ = ["NO_INDEX", "PolyMesh", "build_polymesh", "triangulate"]


@inlined
def triangulate(points: Array, corner: Array, ear: Array, triangles: Array) -> int:
    """Write the triangles of a polygon as rows of corner numbers; return the number of triangles.

    A self-overlapping polygon may give fewer than n - 2.

    Parameters
    ----------
    points : (n, 4) int32, x and z in columns 0 and 2
    corner, ear : (>= n,) int32 and bool, work space
    triangles : (>= n, 3) int32, output
    """
    n = len(points)
    for i in range(n):
        corner[i] = i
    for i in range(n):
        ear[(i + 1) % n] = _is_diagonal(i, (i + 2) % n, n, points, corner, False)
    count = 0
    while n > 3:
        best = _shortest_cut(n, points, corner, ear, False)
        if best < 0:
            best = _shortest_cut(n, points, corner, ear, True)
        if best < 0:
            return count
        tip = (best + 1) % n
        triangles[count, 0] = corner[best]
        triangles[count, 1] = corner[tip]
        triangles[count, 2] = corner[(best + 2) % n]
        count += 1
        n -= 1
        for k in range(tip, n):
            corner[k] = corner[k + 1]
            ear[k] = ear[k + 1]
        after = tip if tip < n else 0
        before = after - 1 if after > 0 else n - 1
        ear[before] = _is_diagonal((before + n - 1) % n, after, n, points, corner, False)
        ear[after] = _is_diagonal(before, (after + 1) % n, n, points, corner, False)
    triangles[count, 0], triangles[count, 1], triangles[count, 2] = corner[0], corner[1], corner[2]
    return count + 1


@compiled
def _is_diagonal(i: int, j: int, n: int, points: Array, corner: Array, loose: bool) -> bool:
    """Return whether the segment between corners i and j is inside the polygon. With ``loose`` the segment may touch
    the border.
    """
    a, b = ground(points, corner[i]), ground(points, corner[j])
    if not in_cone(ground(points, corner[(i + n - 1) % n]), a, ground(points, corner[(i + 1) % n]), b, loose):
        return False
    for k in range(n):
        m = k + 1 if k + 1 < n else 0
        if k in (i, j) or m in (i, j):
            continue
        p, q = ground(points, corner[k]), ground(points, corner[m])
        if coincide(a, p) or coincide(b, p) or coincide(a, q) or coincide(b, q):
            continue
        if segments_cross(a, b, p, q) if loose else segments_touch(a, b, p, q):
            return False
    return True


@compiled
def _squared_length(a: Ground, b: Ground) -> int:
    dx = b[0] - a[0]
    dz = b[1] - a[1]
    return int(dx * dx + dz * dz)


@compiled
def _shortest_cut(n: int, points: Array, corner: Array, ear: Array, loose: bool) -> int:
    """Return the corner before the ear that the shortest diagonal cuts off; with ``loose``, where no ear is left, of
    the diagonals that only touch the polygon. The result is -1 if there is none.
    """
    best = -1
    shortest = -1
    for i in range(n):
        if _is_diagonal(i, (i + 2) % n, n, points, corner, True) if loose else ear[(i + 1) % n]:
            # Recast measures loose cuts to one corner further.
            length = _squared_length(ground(points, corner[i]), ground(points, corner[(i + 2 + loose) % n]))
            if best < 0 or length < shortest:
                shortest = length
                best = i
    return best


# Marks "no vertex" and "no neighbour".
NO_INDEX = 0xFFFF
# Recast numbers vertices, polygons and edges in sixteen bits.
MAX_VERTICES = 0xFFFE
MAX_EDGES = 0xFFFF
# Corners of two contours with equal x and z are one vertex if their heights differ by at most this many cells.
SAME_HEIGHT = 2
VERTEX_BUCKETS = 1 << 12
LEAST_POINTS = 3


@dataclass(frozen=True, eq=False)
class PolyMesh:
    """Convex polygons over shared vertices.

    Attributes
    ----------
    vertices : (v, 3) int32, x, y, z in cells
    polygons : (p, 2k) int32, k vertices and then the polygon across each edge; NO_INDEX where there is none
    region, area : (p,) int32
    """

    vertices: Array
    polygons: Array
    region: Array
    area: Array

    @property
    def verts_per_poly(self) -> int:
        """Maximum number of vertices of a polygon, k."""
        return int(self.polygons.shape[1] // 2)

    @property
    def vert_counts(self) -> Array:
        """(p,) int64 number of vertices of each polygon."""
        counts: Array = (self.polygons[:, : self.verts_per_poly] != NO_INDEX).sum(axis=1)
        return counts


def build_polymesh(contours: Contours, verts_per_poly: int) -> PolyMesh:
    """Triangulate the contours, and merge the triangles into convex polygons of at most ``verts_per_poly`` corners.

    Raises
    ------
    FormatError
        There are more vertices or edges than a tile can number.
    """
    sizes = np.diff(contours.start)
    total = int(sizes[sizes >= LEAST_POINTS].sum())
    if total >= MAX_VERTICES:
        raise _too_many(f"{total:,} contour vertices", MAX_VERTICES)
    vertices, polygons, region, area = _polygons(
        contours.points, contours.start, contours.region, contours.area, verts_per_poly
    )
    mesh = PolyMesh(vertices, polygons, region, area)
    edges = int(mesh.vert_counts.sum())
    if _join(polygons, len(vertices), edges) >= MAX_EDGES:
        raise _too_many(f"{edges:,} polygon edges", MAX_EDGES)
    return mesh


def _too_many(what: str, most: int) -> FormatError:
    return FormatError(
        f"the walkable surface needs {what}, but a tile can number at most {most - 1:,}",
        place="polygon mesh",
        remedy="Use a larger cell_size or edge_max_error, or cut the mesh into parts",
    )


@inlined
def _vertex(x: int, y: int, z: int, vertices: Array, first: Array, after: Array, count: int) -> int:
    """Return the index of the vertex at (x, z) whose height is about ``y``; of several such vertices, the newest. If
    there is none, add a vertex and return its index, which is ``count``.
    """
    bucket = (x * 73856093 ^ z * 19349663) % VERTEX_BUCKETS
    i = first[bucket]
    while i >= 0:
        if vertices[i, 0] == x and vertices[i, 2] == z and abs(vertices[i, 1] - y) <= SAME_HEIGHT:
            return int(i)
        i = after[i]
    vertices[count, 0], vertices[count, 1], vertices[count, 2] = x, y, z
    after[count] = first[bucket]
    first[bucket] = count
    return count


@compiled
def _polygons(
    points: Array, start: Array, regions: Array, areas: Array, most: int
) -> tuple[Array, Array, Array, Array]:
    longest = 0
    total = 0
    for k in range(len(regions)):
        n = start[k + 1] - start[k]
        longest = max(longest, n)
        if n >= LEAST_POINTS:
            total += n
    vertices = np.zeros((total, 3), np.int32)
    first = np.full(VERTEX_BUCKETS, -1, np.int32)
    after = np.empty(total, np.int32)
    polygons = np.full((total, 2 * most), NO_INDEX, np.int32)
    poly_region = np.zeros(total, np.int32)
    poly_area = np.zeros(total, np.int32)
    corner = np.empty(longest + 1, np.int32)
    ear = np.empty(longest + 1, np.bool_)
    triangles = np.empty((longest + 1, 3), np.int32)
    number = np.empty(longest + 1, np.int32)
    parts = np.empty((longest + 1, most), np.int32)
    size = np.empty(longest + 1, np.int32)
    n_vertices = 0
    n_polygons = 0
    for k in range(len(regions)):
        contour = points[start[k] : start[k + 1]]
        if len(contour) < LEAST_POINTS:
            continue
        n_triangles = triangulate(contour, corner, ear, triangles)
        for i in range(len(contour)):
            number[i] = _vertex(contour[i, 0], contour[i, 1], contour[i, 2], vertices, first, after, n_vertices)
            n_vertices = max(n_vertices, number[i] + 1)
        n = 0
        for t in range(n_triangles):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            if a != b and a != c and b != c:
                parts[n, 0], parts[n, 1], parts[n, 2] = number[a], number[b], number[c]
                size[n] = 3
                n += 1
        if most > 3:
            n = _merge(parts, size, n, vertices, most)
        for i in range(n):
            for j in range(size[i]):
                polygons[n_polygons, j] = parts[i, j]
            poly_region[n_polygons] = regions[k]
            poly_area[n_polygons] = areas[k]
            n_polygons += 1
    return vertices[:n_vertices].copy(), polygons[:n_polygons].copy(), poly_region[:n_polygons], poly_area[:n_polygons]


@compiled
def _shared_edge(p: Array, n: int, q: Array, m: int) -> tuple[int, int]:
    """Return the index in p and the index in q of an edge that both polygons share; (-1, -1) if there is none. If they
    share several edges, the last of these in p counts.
    """
    at = -1
    other = -1
    for i in range(n):
        a, b = p[i], p[(i + 1) % n]
        for j in range(m):
            c, d = q[j], q[(j + 1) % m]
            if (a == d and b == c) or (a == c and b == d):
                at = i
                other = j
                break
    return at, other


@compiled
def _merge_gain(p: Array, n: int, q: Array, m: int, vertices: Array, most: int) -> int:
    """Return the squared length of the edge that merging p and q would remove. The result is -1 if they share no edge,
    or if the merged polygon would be too large or not convex.
    """
    if n + m - 2 > most:
        return -1
    i, j = _shared_edge(p, n, q, m)
    if i < 0:
        return -1
    if turn(ground(vertices, p[(i + n - 1) % n]), ground(vertices, p[i]), ground(vertices, q[(j + 2) % m])) >= 0:
        return -1
    if turn(ground(vertices, q[(j + m - 1) % m]), ground(vertices, q[j]), ground(vertices, p[(i + 2) % n])) >= 0:
        return -1
    a, b = ground(vertices, p[i]), ground(vertices, p[(i + 1) % n])
    dx = a[0] - b[0]
    dz = a[1] - b[1]
    return int(dx * dx + dz * dz)


@compiled
def _merge(parts: Array, size: Array, n: int, vertices: Array, most: int) -> int:
    """Merge convex polygons along their longest shared edge, in place, while any two can be merged; return their
    number. Of equal edges that of the first pair counts.
    """
    joined = np.empty(most, np.int32)
    while True:
        gain, a, b = 0, 0, 0
        for j in range(n):
            for k in range(j + 1, n):
                g = _merge_gain(parts[j], size[j], parts[k], size[k], vertices, most)
                if g > gain:
                    gain, a, b = g, j, k
        if gain == 0:
            return n
        i, j = _shared_edge(parts[a], size[a], parts[b], size[b])
        length = 0
        for k in range(size[a] - 1):
            joined[length] = parts[a, (i + 1 + k) % size[a]]
            length += 1
        for k in range(size[b] - 1):
            joined[length] = parts[b, (j + 1 + k) % size[b]]
            length += 1
        parts[a, :length] = joined[:length]
        size[a] = length
        n -= 1
        parts[b] = parts[n]
        size[b] = size[n]


@compiled
def _join(polygons: Array, n_vertices: int, n_edges: int) -> int:
    """Write the neighbours of each polygon to the second half of its row in ``polygons``; return the number of distinct
    edges.
    """
    most = polygons.shape[1] // 2
    first = np.full(n_vertices, -1, np.int32)
    after = np.empty(n_edges, np.int32)
    upper = np.empty(n_edges, np.int32)
    owner = np.empty((n_edges, 2), np.int32)
    taken = np.zeros(n_edges, np.bool_)
    edges = 0
    for rising in (True, False):
        for i in range(len(polygons)):
            for j in range(most):
                v = polygons[i, j]
                if v == NO_INDEX:
                    break
                w = polygons[i, j + 1] if j + 1 < most else NO_INDEX
                if w == NO_INDEX:
                    w = polygons[i, 0]
                if rising and v < w:
                    upper[edges] = w
                    owner[edges, 0], owner[edges, 1] = i, j
                    after[edges] = first[v]
                    first[v] = edges
                    edges += 1
                elif not rising and v > w:
                    # The newest edge between the two that no other polygon uses.
                    e = first[w]
                    while e >= 0 and not (upper[e] == v and not taken[e]):
                        e = after[e]
                    if e >= 0 and owner[e, 0] != i:
                        taken[e] = True
                        polygons[i, most + j] = owner[e, 0]
                        polygons[owner[e, 0], most + owner[e, 1]] = i
    return edges
