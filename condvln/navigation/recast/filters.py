"""Stage 2: filters that decide on which spans of the solid heightfield an agent can stand (``RecastFilter.cpp``).

Each filter returns new area ids, (s,) uint8, and does not change the heightfield.
"""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled
from condvln.navigation.recast.arrays import Array
from condvln.navigation.recast.heightfield import Heightfield

__all__ = ["filter_ledges", "filter_low_hanging_obstacles", "filter_low_height"]

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


def filter_low_height(field: Heightfield, walkable_height: int, height_must_exceed: bool) -> Array:
    """Mark spans without enough clearance for an agent as not walkable.

    ``height_must_exceed`` requires more than ``walkable_height`` voxels, as Recast did up to the version in habitat-sim
    0.3.3.
    """
    least = walkable_height + 1 if height_must_exceed else walkable_height
    last = np.zeros(len(field.top), bool)
    last[field.start[1:][np.diff(field.start) > 0] - 1] = True
    above = np.empty(len(field.top), np.int32)
    above[:-1] = field.bottom[1:]
    above[last] = SKY
    return np.where(above - field.top < least, np.uint8(0), field.area)


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
