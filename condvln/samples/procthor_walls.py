"""Walls and doors of a layout in the format of ProcTHOR's houses, in Unity's frame.

A wall between two rooms is written once for each room, in opposite directions, and split where the adjacent room
changes. Interior walls list their lower corners first, exterior ones their upper corners. Doors are given along
``wall0`` from its first lower corner.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import shapely

from condvln.samples.floor_plan import SHARED
from condvln.samples.layout import Door, Layout
from condvln.samples.unity import UnityFrame

__all__ = [
    "DOOR_HEIGHT",
    "FIRST_ROOM",
    "WIDE_DOORWAY",
    "HouseWall",
    "door_asset",
    "door_record",
    "front_door",
    "house_walls",
    "wall_records",
]

FIRST_ROOM: Final = 2
"""Number of the first room; 1 is the outdoors."""

WIDE_DOORWAY: Final = 1.1
"""Width in metres from which an opening gets a double frame without a leaf; narrower ones have an open door."""

FRONT_DOOR: Final = 1.0
DOOR_HEIGHT: Final = 2.05
"""Width and height in metres of the door to the outdoors."""

Json = dict[str, Any]
Point = tuple[float, float]


class HouseWall(NamedTuple):
    """A wall of one room, from one corner to the next as Unity's (x, z), and the room behind it (None: outdoors)."""

    room: int
    start: Point
    end: Point
    behind: int | None

    @property
    def suffix(self) -> str:
        (x0, x1), (z0, z1) = (sorted(pair) for pair in zip(self.start, self.end, strict=True))
        return f"{x0:.2f}|{z0:.2f}|{x1:.2f}|{z1:.2f}"

    @property
    def name(self) -> str:
        return f"wall|{self.room}|{self.suffix}"

    @property
    def exterior_name(self) -> str:
        return f"wall|exterior|{self.suffix}"


def house_walls(room: int, outline: list[Point], outlines: list[list[Point]]) -> list[HouseWall]:
    """Return the room's walls, split where corners of other rooms lie on a wall."""
    walls = []
    for start, end in zip(outline, [*outline[1:], outline[0]], strict=True):
        side = shapely.LineString([start, end])
        corners = {c for other in outlines for c in other if side.distance(shapely.Point(c)) < 1e-6} | {start, end}
        ordered = sorted(corners, key=lambda c: side.project(shapely.Point(c)))
        for a, b in pairwise(ordered):
            middle = shapely.Point((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
            behind = [i for i, o in enumerate(outlines) if i != room and shapely.Polygon(o).distance(middle) < 1e-6]
            walls.append(HouseWall(room + FIRST_ROOM, a, b, behind[0] + FIRST_ROOM if behind else None))
    return walls


def wall_records(walls: list[HouseWall], ceiling: float) -> list[Json]:
    records = []
    for wall in walls:
        lower = [{"x": x, "y": 0, "z": z} for x, z in (wall.start, wall.end)]
        upper = [{"x": x, "y": ceiling, "z": z} for x, z in (wall.start, wall.end)]
        common = {"roomId": f"room|{wall.room}", "material": {"name": "PureWhite"}, "layer": "Procedural0"}
        records.append({"id": wall.name, "polygon": [*lower, *upper], **common})
        if wall.behind is None:
            records.append({"id": wall.exterior_name, "polygon": [*upper[::-1], *lower[::-1]], **common})
    return records


def door_record(door: Door, number: Mapping[str, int], walls: list[HouseWall], frame: UnityFrame) -> Json:
    """Return the record of a door on the wall of its first room. The position of the hole is measured
    along that wall.
    """
    first, second = (number[room] for room in door.rooms)
    ends = [frame.ground(*door.start), frame.ground(*door.end)]
    opening = shapely.LineString(ends)
    wall0, wall1 = (
        next(
            wall
            for wall in walls
            if (wall.room, wall.behind) == pair
            and shapely.LineString([wall.start, wall.end]).buffer(1e-6).covers(opening)
        )
        for pair in ((first, second), (second, first))
    )
    side = shapely.LineString([wall0.start, wall0.end])
    near, far = sorted(round(side.project(shapely.Point(end)), 6) for end in ends)
    wide = door.width > WIDE_DOORWAY
    return {
        "id": f"door|{min(first, second)}|{max(first, second)}",
        "room0": f"room|{first}",
        "room1": f"room|{second}",
        "wall0": wall0.name,
        "wall1": wall1.name,
        "holePolygon": [{"x": near, "y": 0, "z": 0}, {"x": far, "y": door.height, "z": 0}],
        "assetPosition": {"x": (near + far) / 2, "y": door.height / 2, "z": 0},
        "assetId": door_asset(door.width),
        **({} if wide else {"openable": True, "openness": 1}),
    }


def front_door(layout: Layout, number: Mapping[str, int], walls: list[HouseWall], frame: UnityFrame) -> list[Json]:
    """Return the record of a closed door to the outdoors, at a place without furniture, as a list of one; the list is
    empty if there is no such place.
    """
    taken = shapely.union_all(
        [shapely.Polygon([frame.ground(x, z) for x, z in p.footprint.exterior.coords]) for p in layout.furniture]
    )
    shared = [number[room.room_id] for room in layout.rooms if room.label in SHARED]
    for wall in walls:
        side = shapely.LineString([wall.start, wall.end])
        if wall.behind is None and wall.room in shared:
            for near in np.arange(0.3, side.length - FRONT_DOOR - 0.3, 0.1).round(2).tolist():
                hole = shapely.LineString([side.interpolate(near), side.interpolate(near + FRONT_DOOR)])
                if hole.distance(taken) > FRONT_DOOR:
                    return [_front_door_record(wall, near)]
    return []


def _front_door_record(wall: HouseWall, near: float) -> Json:
    far = round(near + FRONT_DOOR, 6)
    return {
        "id": f"door|1|{wall.room}",
        "room0": f"room|{wall.room}",
        "room1": f"room|{wall.room}",
        "wall0": wall.name,
        "wall1": wall.exterior_name,
        "holePolygon": [{"x": near, "y": 0, "z": 0}, {"x": far, "y": DOOR_HEIGHT, "z": 0}],
        "assetPosition": {"x": (near + far) / 2, "y": DOOR_HEIGHT / 2, "z": 0},
        "assetId": door_asset(FRONT_DOOR),
        "openable": False,
        "openness": 0,
    }


def door_asset(width: float) -> str:
    return f"Doorframe_Double_{width:.2f}" if width > WIDE_DOORWAY else f"Doorway_{width:.2f}"
