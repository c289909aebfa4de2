"""The free floor of an agent: the open plan minus walls and furniture, shrunk by the agent's radius."""

from __future__ import annotations

from typing import Final

import shapely

from condvln.samples.layout import WALL_THICKNESS, Layout
from condvln.samples.room_space import AGENT_HEIGHT, BLOCKING_HEIGHT, opened

__all__ = ["free_floor", "open_plan"]

MILLIMETRE: Final = 0.001

SLIT: Final = 0.05
"""Strips of free floor narrower than this (metres) are removed, as a voxel-based builder would."""


def free_floor(layout: Layout, radius: float = 0.1) -> shapely.Geometry:
    """Return the floor on which the centre of an agent of this radius (metres) may be, as polygons over (x, z) with
    corners on the millimetre grid.

    Obstacles are walls and the footprints of everything between ankle and head height; rugs and mats are walkable. The
    result has several polygons if the floor is not connected for that radius.
    """
    blocked = [
        piece.footprint.buffer(radius, join_style="mitre")
        for piece in layout.furniture
        if piece.aabb[1, 1] > BLOCKING_HEIGHT / 1000 and piece.aabb[0, 1] < AGENT_HEIGHT / 1000
    ]
    floor = open_plan(layout).buffer(-radius, join_style="mitre").difference(shapely.union_all(blocked))
    return opened(floor, SLIT, MILLIMETRE)


def open_plan(layout: Layout) -> shapely.Geometry:
    """Return the floor between the walls, doorways included, furniture ignored."""
    rooms = [room.shape.buffer(-WALL_THICKNESS / 2, join_style="mitre") for room in layout.rooms]
    doors = []
    for door in layout.doors:
        (x0, z0), (x1, z1) = door.start, door.end
        across = WALL_THICKNESS / 2 + MILLIMETRE
        doors.append(
            shapely.box(x0, z0 - across, x1, z1 + across)
            if door.along_x
            else shapely.box(x0 - across, z0, x1 + across, z1)
        )
    return shapely.union_all([*rooms, *doors], grid_size=MILLIMETRE)
