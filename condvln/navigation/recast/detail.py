"""Stage 11: triangles that follow the height of the surface within each polygon (``rcBuildPolyMeshDetail`` of Recast).

The border of a polygon is sampled and simplified; then samples from inside the polygon are added, each time the one
that is farthest from the triangles, until all samples are close enough. All arithmetic is float32 in Recast's order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.arrays import Array, Ground, ground, grown_rows
from condvln.navigation.recast.compact import CompactHeightfield
from condvln.navigation.recast.config import RecastConfig
from condvln.navigation.recast.delaunay import EDGES_PER_POINT, delaunay, distance_2d
from condvln.navigation.recast.heights import fill_patch
from condvln.navigation.recast.metric import FAR, least_extent, segment_distance_2d
from condvln.navigation.recast.polymesh import PolyMesh
from condvln.navigation.recast.samples import (
    MAX_VERTICES,
    MAX_VERTICES_PER_EDGE,
    inner_samples,
    sample_border,
    worst_sample,
)

__all__ = ["DetailMesh", "build_detail"]

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
        out_points = grown_rows(out_points, all_points + n_points)
        out_points[all_points : all_points + n_points] = points[:n_points]
        all_points += n_points
        out_triangles = grown_rows(out_triangles, all_triangles + n_triangles)
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
