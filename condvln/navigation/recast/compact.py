"""Stage 3: the open space above walkable spans, and the connections between them (``rcBuildCompactHeightfield``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from condvln.compiled import compiled
from condvln.navigation.recast.arrays import Array
from condvln.navigation.recast.filters import DX, DZ, SKY
from condvln.navigation.recast.heightfield import Heightfield
from schemas.errors import FormatError

__all__ = ["CompactHeightfield", "compact"]

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
    clearance : (s,) int32, free voxels above it, at most 255
    neighbour : (s, 4) int32, span reached by a step to -x, +z, +x, -z; -1 if none
    area : (s,) uint8, 0 where an agent can't stand
    """

    width: int
    depth: int
    start: Array
    column: Array
    floor: Array
    clearance: Array
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
    start, column, floor, clearance, areas = _walkable(field.start, field.bottom, field.top, area, spans)
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
    return CompactHeightfield(field.width, field.depth, start, column, floor, clearance, neighbour, areas)


@compiled
def _walkable(
    start: Array, bottom: Array, top: Array, area: Array, spans: int
) -> tuple[Array, Array, Array, Array, Array]:
    new_start = np.empty(len(start), np.int32)
    column_of = np.empty(spans, np.int32)
    floor = np.empty(spans, np.int32)
    clearance = np.empty(spans, np.int32)
    areas = np.empty(spans, np.uint8)
    count = 0
    for column in range(len(start) - 1):
        new_start[column] = count
        for i in range(start[column], start[column + 1]):
            if area[i] != 0:
                ceiling = bottom[i + 1] if i + 1 < start[column + 1] else SKY
                column_of[count] = column
                floor[count] = top[i]
                clearance[count] = max(0, min(ceiling - top[i], MAX_CLEARANCE))
                areas[count] = area[i]
                count += 1
    new_start[len(start) - 1] = count
    return new_start, column_of, floor, clearance, areas


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
