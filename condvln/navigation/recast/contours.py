"""Stages 8 and 9: outlines of the regions, simplified (``rcBuildContours`` of Recast), and holes connected to their
region's outline by cuts, so that a single polygon results (``mergeRegionHoles``).

A raw outline follows the cell edges around a region; each of its points stores the region on the other side of the edge
that ends at this point. A simplified outline keeps the points where that region changes and, along walls, as many
points as are needed to stay within ``max_edge_error``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.compact import CompactHeightfield
from condvln.navigation.recast.geometry import (
    Array,
    Ground,
    coincide,
    ground,
    grown,
    in_cone,
    segment_distance_2d,
    segments_touch,
)

__all__ = ["AREA_BORDER", "REGION_MASK", "Contours", "merge_holes", "trace_contours"]

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
) -> Contours:
    """Return the simplified outlines of all regions: outer outlines, and outlines of holes.

    Parameters
    ----------
    area : (s,) uint8 after erosion
    region : (s,) int32
    max_error, max_edge_length : cells; a length of 0 never splits long wall edges
    """
    return Contours(
        *_trace(field.width, field.column, field.floor, field.neighbour, area, region, max_error, max_edge_length)
    )


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


@compiled
def _float_ground(points: Array, i: int) -> Ground:
    """Return x and z of a point in float32, in which Recast measures distances from segments."""
    return np.float32(points[i, 0]), np.float32(points[i, 2])


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
                d = segment_distance_2d(_float_ground(raw, k), _float_ground(raw, begin), _float_ground(raw, end))
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
) -> tuple[Array, Array, Array, Array]:
    edges = _open_edges(neighbour, region)
    # Every step along an outline uses one open edge, and simplification only removes points.
    total = 0
    for i in range(len(edges)):
        for direction in range(4):
            total += (edges[i] >> direction) & 1
    points = np.empty((total + 1, 4), np.int32)
    simple = np.empty((total + 1, 4), np.int32)
    kept = np.empty(total + 2, np.int32)
    start = np.zeros(64, np.int32)
    regions = np.empty(64, np.int32)
    areas = np.empty(64, np.int32)
    contours = 0
    for i in range(len(edges)):
        if edges[i] == 0:
            continue
        n = _walk(i, width, column, floor, neighbour, area, region, edges, points)
        m = _simplify(points, n, max_error, max_edge_length, kept)
        out = simple[start[contours] :]
        for j in range(m):
            for k in range(3):
                out[j, k] = points[kept[j], k]
            # The region beyond the edge that leaves a point is stored in the next raw point.
            out[j, 3] = points[(kept[j] + 1) % n, 3] & (REGION_MASK | AREA_BORDER)
        m = _without_doubles(out, m)
        if m >= LEAST_POINTS:
            regions = grown(regions, contours + 1)
            areas = grown(areas, contours + 1)
            start = grown(start, contours + 2)
            regions[contours] = region[i]
            areas[contours] = area[i]
            start[contours + 1] = start[contours] + m
            contours += 1
    return simple[: start[contours]], start[: contours + 1], regions[:contours], areas[:contours]


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


def merge_holes(contours: Contours) -> Contours:
    """Return the contours, in the same order, after merging holes into the outlines of their regions. A merged hole
    stays in its place as an empty contour.

    A hole that can't be merged stays a contour of its own, as in Recast.
    """
    polygons = [contours[k] for k in range(len(contours))]
    # Twice the area, rounded as in Recast; a contour of reverse winding is a hole.
    backwards = np.array([_doubled_area(p) < -2 for p in polygons], bool)
    if not backwards.any():
        return contours
    for region in np.unique(contours.region[backwards]):
        members = np.flatnonzero(contours.region == region)
        outlines = members[~backwards[members]]
        if len(outlines) == 0:
            continue
        holes = [(_leftmost(polygons[k]), int(k)) for k in members[backwards[members]]]
        holes.sort(key=lambda hole: hole[0][:2])  # sorted by corner only: equal ones keep their order
        order = [k for _, k in holes]
        outline, found = _merge_all(
            polygons[outlines[-1]],
            np.concatenate([polygons[k] for k in order]),
            np.cumsum([0] + [len(polygons[k]) for k in order]),
            np.array([corner[2] for corner, _ in holes], np.int64),
        )
        polygons[outlines[-1]] = outline
        for k in np.array(order)[found]:
            polygons[k] = polygons[k][:0]
    start = np.cumsum([0] + [len(p) for p in polygons]).astype(np.int32)
    return Contours(np.concatenate(polygons), start, contours.region, contours.area)


def _doubled_area(polygon: Array) -> int:
    x, z = polygon[:, 0].astype(np.int64), polygon[:, 2].astype(np.int64)
    return int((x * np.roll(z, 1) - np.roll(x, 1) * z).sum())


def _leftmost(polygon: Array) -> tuple[int, int, int]:
    """Return x, z and index of the leftmost corner: the one with the least x, on ties the least z, then the least
    index.
    """
    i = int(np.lexsort((polygon[:, 2], polygon[:, 0]))[0])
    return int(polygon[i, 0]), int(polygon[i, 2]), i


@compiled
def _blocked(a: Ground, b: Ground, polygon: Array, ignored: int) -> bool:
    """Return whether segment ab touches the polygon. The polygon's edges at corner ``ignored``, and those that end in a
    or b, do not count.
    """
    n = len(polygon)
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        if i == ignored or j == ignored:
            continue
        p, q = ground(polygon, i), ground(polygon, j)
        if coincide(a, p) or coincide(b, p) or coincide(a, q) or coincide(b, q):
            continue
        if segments_touch(a, b, p, q):
            return True
    return False


@inlined
def _joined(outline: Array, i: int, hole: Array, j: int) -> Array:
    """Return the outline with the hole inserted. The result runs around the outline from corner i back to i, then
    around the hole from corner j back to j.
    """
    n, m = len(outline), len(hole)
    out = np.empty((n + m + 2, 4), np.int32)
    for k in range(n + 1):
        out[k] = outline[(i + k) % n]
    for k in range(m + 1):
        out[n + 1 + k] = hole[(j + k) % m]
    return out


@compiled
def _merge_all(outline: Array, points: Array, start: Array, leftmost: Array) -> tuple[Array, Array]:
    """Return the outline with as many holes as possible merged into it, and whether each hole was merged.

    Hole h is ``points[start[h]:start[h + 1]]``; the leftmost hole comes first.
    """
    holes = len(leftmost)
    found = np.zeros(holes, np.bool_)
    capacity = len(outline) + len(points) + 2 * holes
    # Recast looks up the corner to ignore by the index of the hole, not of the diagonal, so entries of earlier holes
    # are read.
    corner_of = np.zeros(capacity, np.int64)
    length = np.zeros(capacity, np.int64)
    for h in range(holes):
        hole = points[start[h] : start[h + 1]]
        at = leftmost[h]
        for _ in range(len(hole)):
            tip = ground(hole, at)
            n = len(outline)
            diagonals = 0
            for i in range(n):
                corner = ground(outline, i)
                if in_cone(ground(outline, (i + n - 1) % n), corner, ground(outline, (i + 1) % n), tip, False):
                    dx = corner[0] - tip[0]
                    dz = corner[1] - tip[1]
                    corner_of[diagonals] = i
                    length[diagonals] = dx * dx + dz * dz
                    diagonals += 1
            order = np.argsort(length[:diagonals], kind="mergesort")
            corner_of[:diagonals] = corner_of[:diagonals][order]
            chosen = -1
            for d in range(diagonals):
                i = corner_of[d]
                clear = not _blocked(ground(outline, i), tip, outline, corner_of[h])
                other = h
                while clear and other < holes:
                    clear = not _blocked(ground(outline, i), tip, points[start[other] : start[other + 1]], -1)
                    other += 1
                if clear:
                    chosen = i
                    break
            if chosen >= 0:
                outline = _joined(outline, chosen, hole, at)
                found[h] = True
                break
            at = (at + 1) % len(hole)
    return outline, found
