"""Stage 8: outlines of the regions, simplified (``rcBuildContours`` of Recast).

A raw outline follows the cell edges around a region; each of its points stores the region on the other side of the edge
that ends at this point. A simplified outline keeps the points where that region changes and, along walls, as many
points as are needed to stay within ``max_edge_error``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.arrays import Array, Ground, ground, grown
from condvln.navigation.recast.compact import CompactHeightfield
from condvln.navigation.recast.planar import coincide

__all__ = ["AREA_BORDER", "REGION_MASK", "Contours", "trace_contours"]

# Fourth entry of a point: the adjacent region in the low bits, and this flag if the area id changes.
REGION_MASK = 0xFFFF
AREA_BORDER = 0x20000
# Recast stops tracing an outline after this many steps.
MAX_OUTLINE_STEPS = 40000
LEAST_POINTS = 3


@dataclass(frozen=True, eq=False)
class Contours:
    """Outlines of regions; contour k has the points ``start[k]:start[k + 1]``.

    Attributes
    ----------
    points : (n, 4) int32, x, y, z in cells, and the adjacent region with its flags
    start : (c + 1,) int32
    region, area : (c,) int32
    """

    points: Array
    start: Array
    region: Array
    area: Array

    def __len__(self) -> int:
        return len(self.region)

    def __getitem__(self, k: int) -> Array:
        return self.points[self.start[k] : self.start[k + 1]]


def trace_contours(
    field: CompactHeightfield, area: Array, region: Array, max_error: np.float32, max_edge_length: int
) -> tuple[Contours, Contours]:
    """Return the raw and the simplified outlines of all regions: outer outlines, and outlines of holes.

    Parameters
    ----------
    area : (s,) uint8 after erosion
    region : (s,) int32
    max_error, max_edge_length : cells; a length of 0 never splits long wall edges
    """
    raw, raw_start, simple, simple_start, regions, areas = _trace(
        field.width, field.column, field.floor, field.neighbour, area, region, max_error, max_edge_length
    )
    return Contours(raw, raw_start, regions, areas), Contours(simple, simple_start, regions, areas)


@inlined
def _open_edges(neighbour: Array, region: Array) -> Array:
    """Return the open edges of each span as the bits of one number, (s,) uint8: bit d is set if a step in direction d
    leaves the span's region.
    """
    edges = np.zeros(len(region), np.uint8)
    for i in range(len(region)):
        if region[i] != 0:
            bits = 0
            for direction in range(4):
                j = neighbour[i, direction]
                if j < 0 or region[j] != region[i]:
                    bits |= 1 << direction
            edges[i] = bits if bits != 0xF else 0  # a single span without open edges has no outline
    return edges


@inlined
def _corner_height(i: int, direction: int, floor: Array, neighbour: Array) -> int:
    """Return the height of the highest floor among the spans (at most four) that meet at one corner of span ``i``: the
    corner between the edges ``direction`` and ``direction + 1``.
    """
    height = floor[i]
    turned = (direction + 1) & 3
    for first, second in ((direction, turned), (turned, direction)):
        j = neighbour[i, first]
        if j >= 0:
            height = max(height, floor[j])
            k = neighbour[j, second]
            if k >= 0:
                height = max(height, floor[k])
    return int(height)


@inlined
def _walk(
    start: int,
    width: int,
    column: Array,
    floor: Array,
    neighbour: Array,
    area: Array,
    region: Array,
    edges: Array,
    out: Array,
) -> int:
    """Trace the outline that begins at the first remaining edge of the span ``start``: write the outline's points to
    ``out``, and remove its edges from ``edges``. Return the number of points.
    """
    i = start
    direction = 0
    while edges[i] & (1 << direction) == 0:
        direction += 1
    first = direction
    n = 0
    for _ in range(1, MAX_OUTLINE_STEPS):
        j = neighbour[i, direction]
        if edges[i] & (1 << direction):
            out[n, 0] = column[i] % width + (1 if direction in (1, 2) else 0)
            out[n, 1] = _corner_height(i, direction, floor, neighbour)
            out[n, 2] = column[i] // width + (1 if direction in (0, 1) else 0)
            out[n, 3] = 0
            if j >= 0:
                out[n, 3] = region[j] | (AREA_BORDER if area[j] != area[start] else 0)
            n += 1
            edges[i] &= ~(1 << direction)
            direction = (direction + 1) & 3
        else:
            i = j
            direction = (direction + 3) & 3
        if i == start and direction == first:
            break
    return n


@inlined
def _squared_distance(point: Ground, a: Ground, b: Ground) -> np.float32:
    """Return the squared horizontal distance from a point to a segment in cells, in float32."""
    abx, abz = np.float32(b[0] - a[0]), np.float32(b[1] - a[1])
    dx, dz = np.float32(point[0] - a[0]), np.float32(point[1] - a[1])
    length = abx * abx + abz * abz
    t = abx * dx + abz * dz
    if length > 0:
        t /= length
    t = max(np.float32(0), min(t, np.float32(1)))
    dx = np.float32(a[0]) + t * abx - np.float32(point[0])
    dz = np.float32(a[1]) + t * abz - np.float32(point[1])
    return dx * dx + dz * dz


@compiled
def _insert_after(kept: Array, n: int, i: int, value: int) -> None:
    for j in range(n, i + 1, -1):
        kept[j] = kept[j - 1]
    kept[i + 1] = value


@inlined
def _corner_stones(raw: Array, n: int, kept: Array) -> int:
    """Write to ``kept`` the indices of the points that a simplified outline must keep; return their number. These are
    the points where the adjacent region changes or, if it never changes, two extreme corners.
    """
    m = 0
    inner = False
    for i in range(n):
        inner = inner or raw[i, 3] & REGION_MASK != 0
    if inner:
        for i in range(n):
            if (raw[i, 3] ^ raw[(i + 1) % n, 3]) & (REGION_MASK | AREA_BORDER):
                kept[m] = i
                m += 1
    if m == 0:
        low = 0
        high = 0
        for i in range(n):
            if raw[i, 0] < raw[low, 0] or (raw[i, 0] == raw[low, 0] and raw[i, 2] < raw[low, 2]):
                low = i
            if raw[i, 0] > raw[high, 0] or (raw[i, 0] == raw[high, 0] and raw[i, 2] > raw[high, 2]):
                high = i
        kept[0] = low
        kept[1] = high
        m = 2
    return m


@compiled
def _forward(a: Ground, b: Ground) -> bool:
    """Return whether b comes after a, ordered by x and then by z. Edges are processed in this order, so that both sides
    of an edge give the same result.
    """
    return bool(b[0] > a[0] or (b[0] == a[0] and b[1] > a[1]))


@inlined
def _simplify(raw: Array, n: int, max_error: np.float32, max_edge_length: int, kept: Array) -> int:
    """Write to ``kept`` the indices of the raw points that the simplified outline keeps; return their number."""
    m = _corner_stones(raw, n, kept)
    # Add the farthest raw point until all are close enough. Edges between two regions stay straight.
    i = 0
    while i < m:
        begin, end = kept[i], kept[(i + 1) % m]
        step = 1
        if not _forward(ground(raw, begin), ground(raw, end)):
            begin, end = end, begin
            step = n - 1
        k = (begin + step) % n
        farthest = -1
        deviation = np.float32(0)
        if raw[k, 3] & REGION_MASK == 0 or raw[k, 3] & AREA_BORDER:
            while k != end:
                d = _squared_distance(ground(raw, k), ground(raw, begin), ground(raw, end))
                if d > deviation:
                    deviation = d
                    farthest = k
                k = (k + step) % n
        if farthest >= 0 and deviation > max_error * max_error:
            _insert_after(kept, m, i, farthest)
            m += 1
        else:
            i += 1
    if max_edge_length > 0:
        # Halve long wall edges.
        i = 0
        while i < m:
            begin, end = kept[i], kept[(i + 1) % m]
            middle = -1
            if raw[(begin + 1) % n, 3] & REGION_MASK == 0:
                dx = raw[end, 0] - raw[begin, 0]
                dz = raw[end, 2] - raw[begin, 2]
                between = end - begin if end >= begin else end + n - begin
                if dx * dx + dz * dz > max_edge_length * max_edge_length and between > 1:
                    half = between // 2 if _forward(ground(raw, begin), ground(raw, end)) else (between + 1) // 2
                    middle = (begin + half) % n
            if middle >= 0:
                _insert_after(kept, m, i, middle)
                m += 1
            else:
                i += 1
    return m


@compiled
def _trace(
    width: int,
    column: Array,
    floor: Array,
    neighbour: Array,
    area: Array,
    region: Array,
    max_error: np.float32,
    max_edge_length: int,
) -> tuple[Array, Array, Array, Array, Array, Array]:
    edges = _open_edges(neighbour, region)
    # Every step along an outline uses one open edge, and simplification only removes points.
    total = 0
    for i in range(len(edges)):
        for direction in range(4):
            total += (edges[i] >> direction) & 1
    raw = np.empty((total + 1, 4), np.int32)
    simple = np.empty((total + 1, 4), np.int32)
    kept = np.empty(total + 2, np.int32)
    raw_start = np.zeros(64, np.int32)
    simple_start = np.zeros(64, np.int32)
    regions = np.empty(64, np.int32)
    areas = np.empty(64, np.int32)
    contours = 0
    for i in range(len(edges)):
        if edges[i] == 0:
            continue
        points = raw[raw_start[contours] :]
        n = _walk(i, width, column, floor, neighbour, area, region, edges, points)
        m = _simplify(points, n, max_error, max_edge_length, kept)
        out = simple[simple_start[contours] :]
        for j in range(m):
            for k in range(3):
                out[j, k] = points[kept[j], k]
            # The region beyond the edge that leaves a point is stored in the next raw point.
            out[j, 3] = points[(kept[j] + 1) % n, 3] & (REGION_MASK | AREA_BORDER)
        m = _without_doubles(out, m)
        if m >= LEAST_POINTS:
            regions = grown(regions, contours + 1)
            areas = grown(areas, contours + 1)
            raw_start = grown(raw_start, contours + 2)
            simple_start = grown(simple_start, contours + 2)
            regions[contours] = region[i]
            areas[contours] = area[i]
            raw_start[contours + 1] = raw_start[contours] + n
            simple_start[contours + 1] = simple_start[contours] + m
            contours += 1
    return (
        raw[: raw_start[contours]],
        raw_start[: contours + 1],
        simple[: simple_start[contours]],
        simple_start[: contours + 1],
        regions[:contours],
        areas[:contours],
    )


@inlined
def _without_doubles(points: Array, n: int) -> int:
    """Remove the points that are directly above or below the next point; return the number of points left. There is
    only one pass, as in Recast.
    """
    i = 0
    while i < n:
        if coincide(ground(points, i), ground(points, (i + 1) % n)):
            for j in range(i, n - 1):
                points[j] = points[j + 1]
            n -= 1
        i += 1
    return n
