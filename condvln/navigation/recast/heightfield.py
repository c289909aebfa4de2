"""Stages 1 and 2: rasterize triangles to a solid heightfield, columns of voxel spans (``rcRasterizeTriangles`` of
Recast), and decide on which spans an agent can stand (``RecastFilter.cpp``).

Each triangle is cut along the grid lines, first into rows and then into cells; the part in a cell becomes one span from
the lowest to the highest voxel touched. Touching spans of a column are merged immediately, so the order of triangles
matters. A filter returns new area ids, (s,) uint8, and does not change the heightfield.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from condvln.compiled import compiled
from condvln.navigation.recast.config import MAX_SPAN_HEIGHT, RecastConfig
from condvln.navigation.recast.geometry import Array, grown

__all__ = ["Heightfield", "ceilings", "filter_ledges", "filter_low_hanging_obstacles", "filter_low_height", "rasterize"]

# A triangle cut by four lines has at most 7 corners; Recast reserves space for 12.
MAX_CORNERS = 12
# Initial number of spans; the pool doubles when it is full.
SPAN_POOL = 1 << 14
# Columns of the table of spans while they are linked lists.
BOTTOM, TOP, AREA, NEXT = range(4)


@dataclass(frozen=True, eq=False)
class Heightfield:
    """Solid spans of a grid of ``width`` x ``depth`` columns, lowest span first within each column.

    Attributes
    ----------
    width, depth : columns along x and z; column (x, z) has number x + z * width
    start : (width * depth + 1,) int32, the spans of column c are ``start[c]:start[c + 1]``
    bottom, top : (s,) int32, first voxel of a span and the one above its last
    area : (s,) uint8, 0 where an agent can't stand, else the area id
    """

    width: int
    depth: int
    start: Array
    bottom: Array
    top: Array
    area: Array


def rasterize(vertices: Array, faces: Array, face_area: Array, config: RecastConfig) -> Heightfield:
    """Voxelise triangles.

    Parameters
    ----------
    vertices : (n, 3) float32, metres
    faces : (m, 3) int32, every index below n
    face_area : (m,) uint8, area id of the top of what a face covers
    """
    start, bottom, top, area = _rasterize(
        vertices,
        faces,
        face_area,
        config.bounds_min,
        config.bounds_max,
        config.width,
        config.depth,
        config.cell_size,
        np.float32(1.0) / config.cell_size,
        np.float32(1.0) / config.cell_height,
        config.walkable_climb,
    )
    return Heightfield(config.width, config.depth, start, bottom, top, area)


@compiled
def _cut_row(
    x: Array, y: Array, z: Array, source: int, corners: int, line: np.float32, row: int, rest: int
) -> tuple[int, int]:
    """Cut the polygon in row ``source`` of the (4, 12) float32 work arrays at z = ``line``.

    The part before the line goes to row ``row``, the part after it to ``rest``; return their numbers of corners.
    """
    n_row = 0
    n_rest = 0
    last = corners - 1
    d_last = line - z[source, last]
    for i in range(corners):
        d = line - z[source, i]
        crosses = (d >= 0) != (d_last >= 0)
        if crosses:
            share = d_last / (d_last - d)
            xc = x[source, last] + (x[source, i] - x[source, last]) * share
            yc = y[source, last] + (y[source, i] - y[source, last]) * share
            zc = z[source, last] + (z[source, i] - z[source, last]) * share
            x[row, n_row], y[row, n_row], z[row, n_row] = xc, yc, zc
            x[rest, n_rest], y[rest, n_rest], z[rest, n_rest] = xc, yc, zc
            n_row += 1
            n_rest += 1
        # A corner on the line belongs to both sides, unless the crossing just added is that corner.
        if d > 0 or (d == 0 and not crosses):
            x[row, n_row], y[row, n_row], z[row, n_row] = x[source, i], y[source, i], z[source, i]
            n_row += 1
        if d < 0 or (d == 0 and not crosses):
            x[rest, n_rest], y[rest, n_rest], z[rest, n_rest] = x[source, i], y[source, i], z[source, i]
            n_rest += 1
        last = i
        d_last = d
    return n_row, n_rest


@compiled
def _cut_cell(
    x: Array, y: Array, source: int, corners: int, line: np.float32, rest: int
) -> tuple[int, int, np.float32, np.float32]:
    """Cut the polygon in row ``source`` of the work arrays at x = ``line``. The part before the line is the piece in
    one cell; the part after the line is written to row ``rest``.

    Returns the numbers of corners of the piece and of the rest, and the least and greatest y of the piece. Nothing else
    is needed of the piece, so it is not stored.
    """
    n_piece = 0
    n_rest = 0
    lowest = np.float32(np.inf)
    highest = np.float32(-np.inf)
    x_last = x[source, corners - 1]
    y_last = y[source, corners - 1]
    d_last = line - x_last
    for i in range(corners):
        xi = x[source, i]
        yi = y[source, i]
        d = line - xi
        crosses = (d >= 0) != (d_last >= 0)
        if crosses:
            share = d_last / (d_last - d)
            yc = y_last + (yi - y_last) * share
            x[rest, n_rest], y[rest, n_rest] = x_last + (xi - x_last) * share, yc
            n_rest += 1
            n_piece += 1
            lowest = min(lowest, yc)
            highest = max(highest, yc)
        if d > 0 or (d == 0 and not crosses):
            n_piece += 1
            lowest = min(lowest, yi)
            highest = max(highest, yi)
        if d < 0 or (d == 0 and not crosses):
            x[rest, n_rest], y[rest, n_rest] = xi, yi
            n_rest += 1
        x_last = xi
        y_last = yi
        d_last = d
    return n_piece, n_rest, lowest, highest


@compiled
def _insert(column: int, low: int, high: int, area: int, merge: int, first: Array, spans: Array, pool: Array) -> None:
    """Insert a span into its column's list, merging the spans that it touches.

    ``spans`` has rows of (bottom, top, area, next one or -1), in one array because the spans of a column are otherwise
    far apart in memory; ``pool`` is (number of rows ever used, head of the free list or -1). If two tops are within
    ``merge`` voxels, the higher area id is kept.
    """
    before = -1
    span = first[column]
    while span >= 0:
        bottom, top, following = spans[span, BOTTOM], spans[span, TOP], spans[span, NEXT]
        if bottom > high:
            break
        if top < low:
            before = span
        else:
            low = min(low, bottom)
            high = max(high, top)
            if high - top <= merge:
                area = max(area, spans[span, AREA])
            if before >= 0:
                spans[before, NEXT] = following
            else:
                first[column] = following
            spans[span, NEXT] = pool[1]
            pool[1] = span
        span = following
    fresh = pool[1]
    if fresh >= 0:
        pool[1] = spans[fresh, NEXT]
    else:
        fresh = pool[0]
        pool[0] += 1
    spans[fresh, BOTTOM] = low
    spans[fresh, TOP] = high
    spans[fresh, AREA] = area
    if before >= 0:
        spans[fresh, NEXT] = spans[before, NEXT]
        spans[before, NEXT] = fresh
    else:
        spans[fresh, NEXT] = first[column]
        first[column] = fresh


@compiled
def _rasterize(
    vertices: Array,
    faces: Array,
    face_area: Array,
    bounds_min: Array,
    bounds_max: Array,
    width: int,
    depth: int,
    cell: np.float32,
    per_cell: np.float32,
    per_height: np.float32,
    merge: int,
) -> tuple[Array, Array, Array, Array]:
    first = np.full(width * depth, -1, np.int32)
    spans = np.empty((SPAN_POOL, 4), np.int32)
    pool = np.array([0, -1], np.int64)
    # Rows of work space: the polygon not yet in a row and its next state, the part of a row not yet in a cell and its
    # next state.
    px = np.empty((4, MAX_CORNERS), np.float32)
    py = np.empty((4, MAX_CORNERS), np.float32)
    pz = np.empty((4, MAX_CORNERS), np.float32)
    x_min, y_min, z_min = bounds_min[0], bounds_min[1], bounds_min[2]
    ceiling = bounds_max[1] - y_min

    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        outside = False
        for k in range(3):
            lowest = min(min(vertices[a, k], vertices[b, k]), vertices[c, k])
            highest = max(max(vertices[a, k], vertices[b, k]), vertices[c, k])
            outside = outside or lowest > bounds_max[k] or highest < bounds_min[k]
        if outside:
            continue
        rest = 0
        px[rest, 0], px[rest, 1], px[rest, 2] = vertices[a, 0], vertices[b, 0], vertices[c, 0]
        py[rest, 0], py[rest, 1], py[rest, 2] = vertices[a, 1], vertices[b, 1], vertices[c, 1]
        pz[rest, 0], pz[rest, 1], pz[rest, 2] = vertices[a, 2], vertices[b, 2], vertices[c, 2]
        corners = 3
        z_lowest = min(min(pz[rest, 0], pz[rest, 1]), pz[rest, 2])
        z_highest = max(max(pz[rest, 0], pz[rest, 1]), pz[rest, 2])
        # Row -1 removes the part of the polygon before the grid.
        z_from = max(-1, min(int((z_lowest - z_min) * per_cell), depth - 1))
        z_to = max(0, min(int((z_highest - z_min) * per_cell), depth - 1))
        for z in range(z_from, z_to + 1):
            line = (z_min + np.float32(z) * cell) + cell
            row = 2
            row_corners, corners = _cut_row(px, py, pz, rest, corners, line, row, 1 - rest)
            rest = 1 - rest
            if row_corners < 3 or z < 0:
                continue
            x_lowest = px[row, 0]
            x_highest = px[row, 0]
            for i in range(1, row_corners):
                x_lowest = min(x_lowest, px[row, i])
                x_highest = max(x_highest, px[row, i])
            x_from = int((x_lowest - x_min) * per_cell)
            x_to = int((x_highest - x_min) * per_cell)
            if x_to < 0 or x_from >= width:
                continue
            x_from = max(-1, min(x_from, width - 1))
            x_to = max(0, min(x_to, width - 1))
            for x in range(x_from, x_to + 1):
                line = (x_min + np.float32(x) * cell) + cell
                piece_corners, row_corners, lowest, highest = _cut_cell(px, py, row, row_corners, line, 5 - row)
                row = 5 - row
                if piece_corners < 3 or x < 0:
                    continue
                lowest -= y_min
                highest -= y_min
                if highest < 0 or lowest > ceiling:
                    continue
                lowest = max(lowest, np.float32(0))
                highest = min(highest, ceiling)
                low = max(0, min(int(np.floor(lowest * per_height)), MAX_SPAN_HEIGHT))
                high = max(low + 1, min(int(np.ceil(highest * per_height)), MAX_SPAN_HEIGHT))
                if pool[1] < 0 and pool[0] == len(spans):
                    spans = grown(spans, pool[0] + 1)
                _insert(x + z * width, low, high, face_area[face], merge, first, spans, pool)
    return _in_column_order(first, spans)


@compiled
def _in_column_order(first: Array, spans: Array) -> tuple[Array, Array, Array, Array]:
    """Return the spans of all columns as contiguous arrays in column order. The input has a linked list of spans for
    each column.
    """
    start = np.empty(len(first) + 1, np.int32)
    bottom = np.empty(len(spans), np.int32)
    top = np.empty(len(spans), np.int32)
    area = np.empty(len(spans), np.uint8)
    count = 0
    for column in range(len(first)):
        start[column] = count
        span = first[column]
        while span >= 0:
            bottom[count] = spans[span, BOTTOM]
            top[count] = spans[span, TOP]
            area[count] = spans[span, AREA]
            count += 1
            span = spans[span, NEXT]
    start[len(first)] = count
    return start, bottom[:count].copy(), top[:count].copy(), area[:count].copy()


# Height in voxels of the empty space above the last span of a column.
SKY = 0xFFFF
# Columns to the west (-x), south (+z), east (+x) and north (-z): Recast's directions 0 to 3.
DX = np.array([-1, 0, 1, 0], np.int64)
DZ = np.array([0, 1, 0, -1], np.int64)


def filter_low_hanging_obstacles(field: Heightfield, walkable_climb: int) -> Array:
    """Mark an obstacle as walkable if its top is within a step of a walkable span just below it (kerbs, stairs)."""
    return _low_hanging(field.start, field.top, field.area, walkable_climb)


def filter_ledges(field: Heightfield, walkable_height: int, walkable_climb: int) -> Array:
    """Mark spans beside a drop of more than a step as not walkable. The border of the grid counts as a drop.

    Spans whose reachable neighbours differ in height by more than a step are marked too: the slope is too steep.
    """
    return _ledges(
        field.width, field.depth, field.start, field.bottom, field.top, field.area, walkable_height, walkable_climb
    )


def ceilings(field: Heightfield) -> Array:
    """Return the bottom of the span above each span, ``SKY`` for the highest of a column."""
    above = np.empty(len(field.top), np.int32)
    above[:-1] = field.bottom[1:]
    above[field.start[1:][np.diff(field.start) > 0] - 1] = SKY
    return above


def filter_low_height(field: Heightfield, walkable_height: int, height_must_exceed: bool) -> Array:
    """Mark spans without enough clearance for an agent as not walkable.

    ``height_must_exceed`` requires more than ``walkable_height`` voxels, as Recast did up to the version in habitat-sim
    0.3.3.
    """
    least = walkable_height + 1 if height_must_exceed else walkable_height
    return np.where(ceilings(field) - field.top < least, np.uint8(0), field.area)


@compiled
def _low_hanging(start: Array, top: Array, area: Array, climb: int) -> Array:
    out = area.copy()
    for column in range(len(start) - 1):
        was_walkable = False
        for i in range(start[column], start[column + 1]):
            walkable = area[i] != 0
            # The state before this filter counts, so that a stack of obstacles is not climbed.
            if not walkable and was_walkable and abs(top[i] - top[i - 1]) <= climb:
                out[i] = out[i - 1]
            was_walkable = walkable
    return out


@compiled
def _ledges(
    width: int, depth: int, start: Array, bottom: Array, top: Array, area: Array, height: int, climb: int
) -> Array:
    out = area.copy()
    for column in range(width * depth):
        x = column % width
        z = column // width
        for i in range(start[column], start[column + 1]):
            if area[i] == 0:
                continue
            floor = top[i]
            ceiling = bottom[i + 1] if i + 1 < start[column + 1] else SKY
            drop = SKY
            lowest = floor
            highest = floor
            for direction in range(4):
                nx = x + DX[direction]
                nz = z + DZ[direction]
                if nx < 0 or nz < 0 or nx >= width or nz >= depth:
                    drop = min(drop, -climb - floor)
                    continue
                neighbour = nx + nz * width
                begin = start[neighbour]
                end = start[neighbour + 1]
                # The empty space below the first span is a drop if the agent fits through the gap.
                below = bottom[begin] if begin < end else SKY
                if min(ceiling, below) - max(floor, -climb) > height:
                    drop = min(drop, -climb - floor)
                for j in range(begin, end):
                    other_floor = top[j]
                    other_ceiling = bottom[j + 1] if j + 1 < end else SKY
                    if min(ceiling, other_ceiling) - max(floor, other_floor) > height:
                        drop = min(drop, other_floor - floor)
                        if abs(other_floor - floor) <= climb:
                            lowest = min(lowest, other_floor)
                            highest = max(highest, other_floor)
            if drop < -climb or highest - lowest > climb:
                out[i] = 0
    return out
