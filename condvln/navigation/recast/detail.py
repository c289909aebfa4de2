"""Stage 11: triangles that follow the height of the surface within each polygon (``rcBuildPolyMeshDetail`` of Recast).

The border of a polygon is sampled and simplified; then samples from inside the polygon are added, each time the one
that is farthest from the triangles, until all samples are close enough. All arithmetic is float32 in Recast's order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.compact import CompactHeightfield
from condvln.navigation.recast.config import RecastConfig
from condvln.navigation.recast.delaunay import EDGES_PER_POINT, delaunay, distance_2d
from condvln.navigation.recast.geometry import (
    FAR,
    Array,
    Ground,
    Point,
    depth_inside,
    ground,
    grown,
    height_error,
    least_extent,
    point,
    segment_distance,
    segment_distance_2d,
)
from condvln.navigation.recast.heights import fill_patch, sample_height
from condvln.navigation.recast.polymesh import PolyMesh

__all__ = [
    "MAX_VERTICES",
    "MAX_VERTICES_PER_EDGE",
    "DetailMesh",
    "build_detail",
    "inner_samples",
    "sample_border",
    "worst_sample",
]

# Detour counts the vertices of a polygon in eight bits; Recast uses half of that.
MAX_VERTICES = 127
MAX_VERTICES_PER_EDGE = 32
# Edges with less extent along x (metres) are ordered by z.
ORDER_EPSILON = np.float32(1e-6)
# Shift of samples as a share of a cell, so that a regular grid does not give degenerate triangles.
JITTER = np.float32(0.1)
JITTER_X = 0x8DA6B343
JITTER_Z = 0xD8163841


@inlined
def _sample_edge(
    a: Point,
    b: Point,
    room: int,
    spacing: np.float32,
    max_error: np.float32,
    surface: tuple[Array, Array],
    scale: Array,
    radius: int,
    edge: Array,
    kept: Array,
) -> int:
    """Sample the heights along the edge from a to b, and write the sampled points to ``edge``. Write to ``kept`` the
    indices of the points that must be kept, including both ends, and return their number.
    """
    patch, box = surface
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    steps = 1 + int(np.floor(np.sqrt(dx * dx + dz * dz) / spacing))
    steps = min(steps, MAX_VERTICES_PER_EDGE - 1, room)
    for k in range(steps + 1):
        u = np.float32(k) / np.float32(steps)
        x, y, z = a[0] + dx * u, a[1] + dy * u, a[2] + dz * u
        edge[k, 0], edge[k, 2] = x, z
        edge[k, 1] = np.float32(sample_height(x, y, z, scale[0], scale[1], radius, patch, box)) * scale[1]
    kept[0], kept[1] = 0, steps
    n = 2
    k = 0
    while k < n - 1:
        farthest = -1
        deviation = np.float32(0)
        for m in range(kept[k] + 1, kept[k + 1]):
            d = segment_distance(point(edge, m), point(edge, kept[k]), point(edge, kept[k + 1]))
            if d > deviation:
                deviation = d
                farthest = m
        if farthest >= 0 and deviation > max_error * max_error:
            for m in range(n, k + 1, -1):
                kept[m] = kept[m - 1]
            kept[k + 1] = farthest
            n += 1
        else:
            k += 1
    return n


@inlined
def sample_border(
    polygon: Array,
    n: int,
    spacing: np.float32,
    max_error: np.float32,
    surface: tuple[Array, Array],
    scale: Array,
    radius: int,
    points: Array,
    hull: Array,
    edge: Array,
    kept: Array,
) -> tuple[int, int]:
    """Write the border of a polygon, with the height samples that must be kept, to ``points`` and ``hull``. Return the
    number of points, and the number of points on the hull.
    """
    n_points = n
    n_hull = 0
    j = n - 1
    for i in range(n):
        hull[n_hull] = j
        n_hull += 1
        if spacing > 0:
            # The same direction from both sides of an edge, so that neighbouring polygons agree on its heights.
            a, b = point(polygon, j), point(polygon, i)
            backwards = a[2] > b[2] if abs(a[0] - b[0]) < ORDER_EPSILON else a[0] > b[0]
            if backwards:
                a, b = b, a
            m = _sample_edge(a, b, MAX_VERTICES - 1 - n_points, spacing, max_error, surface, scale, radius, edge, kept)
            for k in range(1, m - 1):
                points[n_points] = edge[kept[m - 1 - k] if backwards else kept[k]]
                hull[n_hull] = n_points
                n_hull += 1
                n_points += 1
        j = i
    return n_points, n_hull


@inlined
def inner_samples(
    polygon: Array, n: int, spacing: np.float32, surface: tuple[Array, Array], scale: Array, radius: int, samples: Array
) -> tuple[Array, int]:
    """Return grid points well inside a polygon, as rows (x, height in cells, z, 0), and their number."""
    patch, box = surface
    low = point(polygon, 0)
    high = low
    for i in range(1, n):
        p = point(polygon, i)
        low = (min(low[0], p[0]), min(low[1], p[1]), min(low[2], p[2]))
        high = (max(high[0], p[0]), max(high[1], p[1]), max(high[2], p[2]))
    middle = (high[1] + low[1]) * np.float32(0.5)
    count = 0
    for grid_z in range(int(np.floor(low[2] / spacing)), int(np.ceil(high[2] / spacing))):
        for grid_x in range(int(np.floor(low[0] / spacing)), int(np.ceil(high[0] / spacing))):
            x = np.float32(grid_x) * spacing
            z = np.float32(grid_z) * spacing
            if depth_inside(polygon, n, (x, z)) > -spacing / np.float32(2):
                continue
            samples = grown(samples, count + 1)
            samples[count, 0] = grid_x
            samples[count, 1] = sample_height(x, middle, z, scale[0], scale[1], radius, patch, box)
            samples[count, 2] = grid_z
            samples[count, 3] = 0
            count += 1
    return samples, count


@compiled
def _jitter(i: int, factor: int) -> np.float32:
    """Return a deterministic pseudo-random number between -1 and 1."""
    return np.float32((i * factor) & 0xFFFF) / np.float32(65535.0) * np.float32(2.0) - np.float32(1.0)


@inlined
def worst_sample(
    samples: Array, count: int, spacing: np.float32, scale: Array, points: Array, triangles: Array, n_triangles: int
) -> tuple[int, np.float32, Point]:
    """Return the sample with the greatest vertical distance from the triangles: its index, this distance and its
    position. The result is (-1, 0, ...) if no sample is off the triangles.
    """
    worst = -1
    error = np.float32(0)
    place = point(points, 0)
    for i in range(count):
        if samples[i, 3] != 0:
            continue
        p = (
            np.float32(samples[i, 0]) * spacing + _jitter(i, JITTER_X) * scale[2] * JITTER,
            np.float32(samples[i, 1]) * scale[1],
            np.float32(samples[i, 2]) * spacing + _jitter(i, JITTER_Z) * scale[2] * JITTER,
        )
        nearest = FAR
        for t in range(n_triangles):
            a, b, c = point(points, triangles[t, 0]), point(points, triangles[t, 1]), point(points, triangles[t, 2])
            nearest = min(nearest, height_error(p, a, b, c))
            if nearest <= error:
                break  # another sample is farther
        if nearest < FAR and nearest > error:
            error = nearest
            worst = i
            place = p
    return worst, error, place


# Detour counts the triangles of a polygon in eight bits.
MAX_TRIANGLES = 255
# Square of the distance in metres within which a vertex is on the polygon's border.
ON_BORDER_SQUARED = np.float32(0.001) * np.float32(0.001)


@dataclass(frozen=True, eq=False)
class DetailMesh:
    """Detail triangles of p polygons.

    Attributes
    ----------
    meshes : (p, 4) int32, first vertex, vertices, first triangle, triangles of each polygon; its own corners are the
        first vertices
    vertices : (v, 3) float32, metres
    triangles : (t, 4) uint8, corners counted from the polygon's first vertex, and two bits an edge, 1 where it is on
        the border
    """

    meshes: Array
    vertices: Array
    triangles: Array


def build_detail(mesh: PolyMesh, field: CompactHeightfield, region: Array, config: RecastConfig) -> DetailMesh:
    """Return the detail mesh of ``mesh`` over the floors of ``field``; ``region`` (s,) int32 holds the region of each
    span.
    """
    if len(mesh.polygons) == 0:
        return DetailMesh(np.zeros((0, 4), np.int32), np.zeros((0, 3), np.float32), np.zeros((0, 4), np.uint8))
    counts = mesh.vert_counts
    meshes, vertices, triangles = _build(
        mesh.vertices,
        mesh.polygons,
        counts,
        mesh.region,
        _boxes(mesh, counts, field.width, field.depth),
        field.width,
        field.start,
        field.column,
        field.floor,
        field.neighbour,
        region,
        config.bounds_min,
        config.cell_size,
        config.cell_height,
        config.detail_sample_distance,
        config.detail_sample_max_error,
        max(1, math.ceil(config.max_edge_error)),
    )
    return DetailMesh(meshes, vertices, triangles)


def _boxes(mesh: PolyMesh, counts: Array, width: int, depth: int) -> Array:
    """Return a box of cells around each polygon, (p, 4) int32. The four numbers are the least x, the least z, the
    number of columns, and the number of rows.
    """
    corners = mesh.vertices[
        np.where(
            np.arange(mesh.verts_per_poly) < counts[:, None],
            mesh.polygons[:, : mesh.verts_per_poly],
            mesh.polygons[:, :1],
        )
    ]
    low = np.maximum(corners.min(axis=1)[:, [0, 2]] - 1, 0)
    high = np.minimum(corners.max(axis=1)[:, [0, 2]] + 1, [width, depth])
    return np.ascontiguousarray(np.concatenate([low, high - low], axis=1), np.int32)


@inlined
def _fan(points: Array, hull: Array, n: int, n_corners: int, triangles: Array) -> int:
    """Triangulate the ring ``hull``: write its triangles to ``triangles`` and return their number. The first triangle
    cuts off one corner, chosen so that the triangle's perimeter is least. Each further triangle adds the ring's next
    point to the left or to the right of the previous triangle, whichever is nearer.
    """
    start = 0
    left = 1
    right = n - 1
    shortest = FAR
    for i in range(n):
        if hull[i] >= n_corners:
            continue  # the point is within an edge
        before = i - 1 if i > 0 else n - 1
        after = i + 1 if i + 1 < n else 0
        p, c, q = ground(points, hull[before]), ground(points, hull[i]), ground(points, hull[after])
        around = distance_2d(p, c) + distance_2d(c, q) + distance_2d(q, p)
        if around < shortest:
            shortest = around
            start, left, right = i, after, before
    triangles[0, 0], triangles[0, 1], triangles[0, 2] = hull[start], hull[left], hull[right]
    count = 1
    while (left + 1 if left + 1 < n else 0) != right:
        next_left = left + 1 if left + 1 < n else 0
        next_right = right - 1 if right > 0 else n - 1
        p, p_next = ground(points, hull[left]), ground(points, hull[next_left])
        q, q_next = ground(points, hull[right]), ground(points, hull[next_right])
        triangles[count, 0], triangles[count, 2] = hull[left], hull[right]
        if distance_2d(p, p_next) + distance_2d(p_next, q) < distance_2d(q, q_next) + distance_2d(p, q_next):
            triangles[count, 1] = hull[next_left]
            left = next_left
        else:
            triangles[count, 1] = hull[next_right]
            right = next_right
        count += 1
    return count


@compiled
def _on_border(a: Ground, b: Ground, polygon: Array, n: int) -> int:
    """Return 1 if both points are on the same edge of the polygon, seen from above; else 0."""
    j = n - 1
    for i in range(n):
        p, q = ground(polygon, j), ground(polygon, i)
        if segment_distance_2d(a, p, q) < ON_BORDER_SQUARED and segment_distance_2d(b, p, q) < ON_BORDER_SQUARED:
            return 1
        j = i
    return 0


@compiled
def _build(
    vertices: Array,
    polygons: Array,
    counts: Array,
    poly_region: Array,
    boxes: Array,
    width: int,
    start: Array,
    column: Array,
    floor: Array,
    neighbour: Array,
    region: Array,
    origin: Array,
    cell: np.float32,
    cell_height: np.float32,
    spacing: np.float32,
    max_error: np.float32,
    radius: int,
) -> tuple[Array, Array, Array]:
    most = polygons.shape[1] // 2
    cells = 0
    for p in range(len(polygons)):
        cells = max(cells, boxes[p, 2] * boxes[p, 3])
    patch = np.empty(cells, np.int32)
    queue = np.empty(cells + 1, np.int32)
    scale = np.array([np.float32(1) / cell, cell_height, cell], np.float32)
    corners = np.empty((most, 3), np.int32)
    polygon = np.empty((most, 3), np.float32)
    points = np.empty((2 * MAX_VERTICES, 3), np.float32)
    hull = np.empty(2 * MAX_VERTICES, np.int64)
    edge = np.empty((MAX_VERTICES_PER_EDGE + 1, 3), np.float32)
    kept = np.empty(MAX_VERTICES_PER_EDGE + 1, np.int32)
    edges = np.empty((EDGES_PER_POINT * MAX_VERTICES, 4), np.int64)
    triangles = np.empty((2 * EDGES_PER_POINT * MAX_VERTICES, 3), np.int64)
    samples = np.empty((512, 4), np.int32)
    meshes = np.empty((len(polygons), 4), np.int32)
    out_points = np.empty((8 * len(polygons), 3), np.float32)
    out_triangles = np.empty((8 * len(polygons), 4), np.uint8)
    all_points = 0
    all_triangles = 0
    for p in range(len(polygons)):
        n = counts[p]
        for i in range(n):
            corners[i] = vertices[polygons[p, i]]
            polygon[i, 0] = np.float32(corners[i, 0]) * cell
            polygon[i, 1] = np.float32(corners[i, 1]) * cell_height
            polygon[i, 2] = np.float32(corners[i, 2]) * cell
            points[i] = polygon[i]
        box = boxes[p]
        fill_patch(patch, box, corners[:n], poly_region[p], width, start, column, floor, neighbour, region, queue)
        surface = (patch, box)
        n_points, n_hull = sample_border(
            polygon, n, spacing, max_error, surface, scale, radius, points, hull, edge, kept
        )
        n_triangles = _fan(points, hull, n_hull, n, triangles)
        # Slivers get no inner points.
        if spacing > 0 and least_extent(polygon, n) >= spacing * np.float32(2):
            samples, n_samples = inner_samples(polygon, n, spacing, surface, scale, radius, samples)
            for _ in range(n_samples):
                if n_points >= MAX_VERTICES:
                    break
                worst, error, place = worst_sample(samples, n_samples, spacing, scale, points, triangles, n_triangles)
                if error <= max_error or worst < 0:
                    break
                samples[worst, 3] = 1
                points[n_points, 0], points[n_points, 1], points[n_points, 2] = place
                n_points += 1
                n_triangles = delaunay(points, n_points, hull, n_hull, edges, triangles)
            n_triangles = min(n_triangles, MAX_TRIANGLES)
        # Convert to metres in the scene. Recast raises the detail mesh by one cell.
        for i in range(n_points):
            points[i, 0] += origin[0]
            points[i, 1] += origin[1] + cell_height
            points[i, 2] += origin[2]
        for i in range(n):
            for k in range(3):
                polygon[i, k] += origin[k]
        meshes[p, 0], meshes[p, 1], meshes[p, 2], meshes[p, 3] = all_points, n_points, all_triangles, n_triangles
        out_points = grown(out_points, all_points + n_points)
        out_points[all_points : all_points + n_points] = points[:n_points]
        all_points += n_points
        out_triangles = grown(out_triangles, all_triangles + n_triangles)
        for t in range(n_triangles):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            p_a, p_b, p_c = ground(points, a), ground(points, b), ground(points, c)
            flags = _on_border(p_a, p_b, polygon, n)
            flags |= _on_border(p_b, p_c, polygon, n) << 2
            flags |= _on_border(p_c, p_a, polygon, n) << 4
            out_triangles[all_triangles, 0] = a
            out_triangles[all_triangles, 1] = b
            out_triangles[all_triangles, 2] = c
            out_triangles[all_triangles, 3] = flags
            all_triangles += 1
    return meshes, out_points[:all_points].copy(), out_triangles[:all_triangles].copy()
