"""Heights of the surface around one polygon, and their sampling (``getHeightData`` and ``getHeight`` of Recast).

A patch is a rectangle of cells around the polygon. It is filled from the spans of the polygon's region; the remaining
cells are filled outward from these, so that samples on the border find a height.
"""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.geometry import Array

__all__ = ["UNSET", "fill_patch", "sample_height"]

# A cell of the patch without a height.
UNSET = 0xFFFF
# The cell of a vertex and the eight around it, in Recast's order.
AROUND_X = np.array([0, -1, 0, 1, 1, 1, 0, -1, -1], np.int64)
AROUND_Z = np.array([0, -1, -1, -1, 0, 1, 1, 1, 0], np.int64)
# Offset as a share of a cell, so that samples on a cell border belong to the cell above it.
BORDER_SLACK = np.float32(0.01)


@inlined
def fill_patch(
    patch: Array,
    box: Array,
    corners: Array,
    own_region: int,
    width: int,
    start: Array,
    column: Array,
    floor: Array,
    neighbour: Array,
    region: Array,
    queue: Array,
) -> None:
    """Fill ``patch`` with heights around one polygon.

    Parameters
    ----------
    patch : (>= w * d,) int32, output, row by row
    box : (4,) least x, least z, columns w and rows d of the patch
    corners : (n, 3) int32, the polygon's vertices in cells
    queue : (> w * d,) int32, work space
    """
    x_min, z_min, w, d = box[0], box[1], box[2], box[3]
    patch[: w * d] = UNSET
    tail = 0
    found = False
    for z in range(d):
        for x in range(w):
            cell = x_min + x + (z_min + z) * width
            for i in range(start[cell], start[cell + 1]):
                if region[i] == own_region:
                    patch[x + z * w] = floor[i]
                    found = True
                    for direction in range(4):
                        j = neighbour[i, direction]
                        if j >= 0 and region[j] != own_region:
                            queue[tail] = i
                            tail += 1
                            break
                    break
    if not found:
        seed = _seed(patch, box, corners, width, start, column, floor, neighbour, queue)
        patch[: w * d] = UNSET
        if seed >= 0:
            patch[_cell(seed, box, width, column)] = floor[seed]
            queue[0] = seed
            tail = 1
    head = 0
    while head < tail:
        i = queue[head]
        head += 1
        for direction in range(4):
            j = neighbour[i, direction]
            if j >= 0:
                cell = _cell(j, box, width, column)
                if cell >= 0 and patch[cell] == UNSET:
                    patch[cell] = floor[j]
                    queue[tail] = j
                    tail += 1


@compiled
def _cell(i: int, box: Array, width: int, column: Array) -> int:
    """Return the index, within the patch, of the cell in which span i lies; -1 if the span lies outside the patch."""
    x = column[i] % width - box[0]
    z = column[i] // width - box[1]
    if x < 0 or z < 0 or x >= box[2] or z >= box[3]:
        return -1
    return int(x + z * box[2])


@inlined
def _nearest_span(box: Array, corners: Array, width: int, start: Array, floor: Array) -> int:
    """Compare the spans beside each of the polygon's ``corners`` with this corner, and return the span with the least
    difference in height; -1 if there are no such spans.
    """
    nearest = UNSET
    best = -1
    for n in range(len(corners)):
        for k in range(len(AROUND_X)):
            x = corners[n, 0] + AROUND_X[k]
            z = corners[n, 2] + AROUND_Z[k]
            if x < box[0] or x >= box[0] + box[2] or z < box[1] or z >= box[1] + box[3]:
                continue
            for i in range(start[x + z * width], start[x + z * width + 1]):
                difference = abs(corners[n, 1] - floor[i])
                if difference < nearest:
                    nearest = difference
                    best = i
                    if nearest == 0:
                        return best
    return best


@inlined
def _seed(
    patch: Array,
    box: Array,
    corners: Array,
    width: int,
    start: Array,
    column: Array,
    floor: Array,
    neighbour: Array,
    stack: Array,
) -> int:
    """Return the span from which to fill the patch of a polygon that has no spans of its own region. This is the last
    span of a walk from one of the polygon's vertices towards its middle. Return -1 if no span is beside a vertex.
    """
    i = _nearest_span(box, corners, width, start, floor)
    if i < 0:
        return -1
    middle_x = 0
    middle_z = 0
    for n in range(len(corners)):
        middle_x += corners[n, 0]
        middle_z += corners[n, 2]
    middle_x //= len(corners)
    middle_z //= len(corners)
    patch[: box[2] * box[3]] = 0  # 1 where the walk has been
    stack[0] = i
    height = 1
    order = np.arange(4)
    while height > 0:
        height -= 1
        i = stack[height]
        x = column[i] % width
        z = column[i] // width
        if x == middle_x and z == middle_z:
            break
        if x == middle_x:
            straight = 1 if middle_z > z else 3
        else:
            straight = 2 if middle_x > x else 0
        # The straight direction is pushed last, so that it is tried first.
        order[straight], order[3] = order[3], order[straight]
        for k in range(4):
            j = neighbour[i, order[k]]
            if j >= 0:
                cell = _cell(j, box, width, column)
                if cell >= 0 and patch[cell] == 0:
                    patch[cell] = 1
                    stack[height] = j
                    height += 1
        order[straight], order[3] = order[3], order[straight]
    return i


@compiled
def sample_height(
    x: np.float32,
    y: np.float32,
    z: np.float32,
    per_cell: np.float32,
    cell_height: np.float32,
    radius: int,
    patch: Array,
    box: Array,
) -> int:
    """Return the height of the surface, in cells, at a position in metres from the grid's corner.

    If the patch has no height there, the surrounding cells are searched in square rings up to ``radius``; of the first
    ring with heights, the one nearest to ``y`` is returned. UNSET if there is none.
    """
    w, d = box[2], box[3]
    cx = max(0, min(int(np.floor(x * per_cell + BORDER_SLACK)) - box[0], w - 1))
    cz = max(0, min(int(np.floor(z * per_cell + BORDER_SLACK)) - box[1], d - 1))
    height = patch[cx + cz * w]
    if height != UNSET:
        return int(height)
    best = UNSET
    nearest = np.float32(np.inf)
    dx = 1
    dz = 0
    step_x = 1
    step_z = 0
    ring_end = 8
    ring_length = 16
    for k in range((2 * radius + 1) * (2 * radius + 1) - 1):
        px = cx + dx
        pz = cz + dz
        if px >= 0 and pz >= 0 and px < w and pz < d and patch[px + pz * w] != UNSET:
            difference = abs(np.float32(patch[px + pz * w]) * cell_height - y)
            if difference < nearest:
                nearest = difference
                best = patch[px + pz * w]
        if k + 1 == ring_end:
            if best != UNSET:
                break
            ring_end += ring_length
            ring_length += 8
        if dx == dz or (dx < 0 and dx == -dz) or (dx > 0 and dx == 1 - dz):
            step_x, step_z = -step_z, step_x
        dx += step_x
        dz += step_z
    return best
