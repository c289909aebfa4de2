"""Stages 4 and 5: erosion by the agent's radius, and the distance of each span from the border of its area.

Distances are counted in half cells, 2 for a straight step and 3 for a diagonal one (``rcErodeWalkableArea`` and
``rcBuildDistanceField`` of Recast).
"""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, constant
from condvln.navigation.recast.arrays import Array
from condvln.navigation.recast.compact import CompactHeightfield

__all__ = ["distance_field", "erode"]

# "Not reached yet", in the eight bits of erosion and the sixteen bits of the distance field.
FAR_8 = 0xFF
FAR_16 = 0xFFFF
# The field is not blurred within this many half cells of the border.
BLUR_FROM = 2
# The four sides of a cell, in the order of ``neighbour``.
SIDE_0, SIDE_1, SIDE_2, SIDE_3 = constant(0), constant(1), constant(2), constant(3)


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
