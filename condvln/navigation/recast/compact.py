"""Stages 3 to 5: the open space above walkable spans and its connections (``rcBuildCompactHeightfield`` of Recast),
erosion by the agent's radius, and the distance of each span from the border of its area.

Distances are counted in half cells, 2 for a straight step and 3 for a diagonal one (``rcErodeWalkableArea`` and
``rcBuildDistanceField``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from condvln.compiled import compiled
from condvln.navigation.recast.geometry import Array
from condvln.navigation.recast.heightfield import DX, DZ, Heightfield, ceilings
from schemas.errors import FormatError

__all__ = ["CompactHeightfield", "compact", "distance_field", "erode"]

# Limits of Recast's bit fields: spans of a neighbour column that a connection can address, per column, and in total.
MAX_LAYERS = 62
MAX_COLUMN_SPANS = 0xFF
MAX_SPANS = 1 << 24
# The clearance above a span has eight bits.
MAX_CLEARANCE = 0xFF


@dataclass(frozen=True, eq=False)
class CompactHeightfield:
    """Walkable spans seen from above, in column order.

    Attributes
    ----------
    width, depth : columns along x and z
    start : (width * depth + 1,) int32, the spans of column c are ``start[c]:start[c + 1]``
    column : (s,) int32, column of each span
    floor : (s,) int32, voxel on which the agent stands
    neighbour : (s, 4) int32, span reached by a step to -x, +z, +x, -z; -1 if none
    area : (s,) uint8, 0 where an agent can't stand
    """

    width: int
    depth: int
    start: Array
    column: Array
    floor: Array
    neighbour: Array
    area: Array


def compact(field: Heightfield, area: Array, walkable_height: int, walkable_climb: int) -> CompactHeightfield:
    """Keep the spans of ``field`` whose ``area`` (after the filters) is not 0, and connect them.

    Raises
    ------
    FormatError
        There are more spans than Recast's bit fields can number.
    """
    spans = int(np.count_nonzero(area))
    if spans > MAX_SPANS:
        raise FormatError(
            f"the mesh has {spans:,} walkable voxel spans, and a tile holds at most {MAX_SPANS:,}",
            place="compact heightfield",
            remedy="Use a larger cell_size or cut the mesh into parts",
        )
    start, column, floor, clearance, areas = _walkable(field, area)
    neighbour, layers = _connect(
        field.width, field.depth, start, column, floor, clearance, walkable_height, walkable_climb
    )
    most = int(np.diff(start).max(initial=0))
    if layers > MAX_LAYERS or most > MAX_COLUMN_SPANS:
        raise FormatError(
            f"{max(layers + 1, most)} floors lie one above another, but Recast can tell at most {MAX_LAYERS + 1} apart",
            place=f"compact heightfield, column {int(np.argmax(np.diff(start)))}",
            remedy="Use a larger cell_height, or clean the mesh",
        )
    return CompactHeightfield(field.width, field.depth, start, column, floor, neighbour, areas)


def _walkable(field: Heightfield, area: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return where the walkable spans of each column start, and of each such span the column, the floor, the clearance
    above and the area.
    """
    kept = area != 0
    columns = np.arange(len(field.start) - 1, dtype=np.int32)
    column = np.repeat(columns, np.diff(field.start))[kept]
    start = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=len(columns)))]).astype(np.int32)
    floor = field.top[kept].astype(np.int32)
    clearance = np.clip(ceilings(field)[kept] - floor, 0, MAX_CLEARANCE).astype(np.int32)
    return start, column, floor, clearance, area[kept]


@compiled
def _connect(
    width: int, depth: int, start: Array, column: Array, floor: Array, clearance: Array, height: int, climb: int
) -> tuple[Array, int]:
    """Return the four neighbours (s, 4) of each span, and the greatest index, counted from 0, that any of these
    neighbours has within its own column.
    """
    neighbour = np.full((len(floor), 4), -1, np.int32)
    highest_layer = 0
    for i in range(len(floor)):
        x = column[i] % width
        z = column[i] // width
        for direction in range(4):
            nx = x + DX[direction]
            nz = z + DZ[direction]
            if nx < 0 or nz < 0 or nx >= width or nz >= depth:
                continue
            other = nx + nz * width
            for j in range(start[other], start[other + 1]):
                gap = min(floor[i] + clearance[i], floor[j] + clearance[j]) - max(floor[i], floor[j])
                if gap >= height and abs(floor[j] - floor[i]) <= climb:
                    neighbour[i, direction] = j
                    highest_layer = max(highest_layer, j - start[other])
                    break
    return neighbour, highest_layer


# "Not reached yet", in the eight bits of erosion and the sixteen bits of the distance field.
FAR_8 = 0xFF
FAR_16 = 0xFFFF
# The field is not blurred within this many half cells of the border.
BLUR_FROM = 2
# The four sides of a cell, in the order of ``neighbour``.
SIDE_0, SIDE_1, SIDE_2, SIDE_3 = 0, 1, 2, 3


def erode(field: CompactHeightfield, walkable_radius: int) -> Array:
    """Return the area ids (s,) of the spans, uint8, with 0 for spans nearer than ``walkable_radius`` cells to a
    border.
    """
    distance = _border_distance(field.neighbour, field.area, FAR_8)
    return np.where(distance < 2 * walkable_radius, np.uint8(0), field.area)


def distance_field(field: CompactHeightfield, area: Array) -> tuple[Array, int]:
    """Return the blurred distance of each span from the border of its area.

    Parameters
    ----------
    area : (s,) uint8, area ids after erosion; spans of area 0 have distances among themselves

    Returns
    -------
    distance : (s,) int32, half cells
    highest : its maximum before the blur, the level at which Recast starts the watershed
    """
    distance = _border_distance(field.neighbour, area, FAR_16)
    return _blurred(field.neighbour, distance), int(distance.max(initial=0))


@compiled
def _border_distance(neighbour: Array, area: Array, far: int) -> Array:
    """Return the distance of each span to the nearest border span. A border span has fewer than four neighbours with
    its own area id. The distance is a chamfer distance, computed in two passes.
    """
    spans = len(area)
    distance = np.full(spans, far, np.int32)
    for i in range(spans):
        same = 0
        for direction in range(4):
            j = neighbour[i, direction]
            if j >= 0 and area[j] == area[i]:
                same += 1
        if same != 4:
            distance[i] = 0
    # Forward from -x and -z with their diagonals, then backward from +x and +z.
    for i in range(spans):
        _relax(neighbour, distance, i, SIDE_0, SIDE_3)
        _relax(neighbour, distance, i, SIDE_3, SIDE_2)
    for i in range(spans - 1, -1, -1):
        _relax(neighbour, distance, i, SIDE_2, SIDE_1)
        _relax(neighbour, distance, i, SIDE_1, SIDE_0)
    return distance


@compiled
def _relax(neighbour: Array, distance: Array, i: int, straight: int, turn: int) -> None:
    j = neighbour[i, straight]
    if j >= 0:
        distance[i] = min(distance[i], distance[j] + 2)
        k = neighbour[j, turn]
        if k >= 0:
            distance[i] = min(distance[i], distance[k] + 3)


@compiled
def _blurred(neighbour: Array, distance: Array) -> Array:
    """Return the mean of ``distance`` over the 3 x 3 neighbourhood of each span. A missing neighbour counts as the span
    itself; distances up to `BLUR_FROM` are kept.
    """
    out = np.empty(len(distance), np.int32)
    for i in range(len(distance)):
        own = distance[i]
        if own <= BLUR_FROM:
            out[i] = own
            continue
        total = own
        for direction in range(4):
            j = neighbour[i, direction]
            if j < 0:
                total += 2 * own
                continue
            total += distance[j]
            k = neighbour[j, (direction + 1) & 3]
            total += distance[k] if k >= 0 else own
        out[i] = (total + 5) // 9
    return out
