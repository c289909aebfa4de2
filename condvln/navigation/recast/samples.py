"""Height samples of one polygon: along its border, and on a grid inside (part of ``buildPolyDetail`` of Recast)."""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.arrays import Array, Point, grown_rows, point
from condvln.navigation.recast.heights import sample_height
from condvln.navigation.recast.metric import FAR, depth_inside, height_error, segment_distance

__all__ = ["MAX_VERTICES", "MAX_VERTICES_PER_EDGE", "inner_samples", "sample_border", "worst_sample"]

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
            samples = grown_rows(samples, count + 1)
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
