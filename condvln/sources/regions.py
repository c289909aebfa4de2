"""Rooms from region annotations: vertical prisms over polygons, as in Habitat's semantic configurations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final, Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.json_document import JsonNode, parse_json
from condvln.labels import vocabulary
from condvln.labels.lists import types_by_contents
from condvln.scene import Room, SceneObject, SceneWarning, round_mm
from condvln.sources.source import InputLedger

__all__ = [
    "LEVEL_STEP",
    "NEAREST_REGION",
    "RegionIndex",
    "check_polygon",
    "in_rooms",
    "levelled",
    "made_room",
    "read_regions",
    "side_regions",
    "typed_by_contents",
]

NEAREST_REGION: Final = 0.25
"""Metres. An object whose centre is outside all regions by at most this (in a wall, on a sill) gets the nearest region,
if the second nearest is farther by ``CLEAR``; otherwise its room is ambiguous.
"""

CLEAR: Final = 0.05
"""Metres by which the second nearest region must be farther away than the nearest."""

DEFAULT_FLOOR: Final = 0.0
DEFAULT_EXTRUSION: Final = 2.5
"""Default floor height and room height in metres: habitat-sim's ``floor_height`` and ``extrusion_height``."""

MAX_REGION_BYTES: Final = 64 << 20

LEVEL_STEP: Final = 1.0
"""Least height difference in metres between the floors of two levels."""


def made_room(
    family: str,
    room_id: str,
    raw_label: str,
    heights: tuple[float, float],
    polygon: NDArray[np.float64] | None,
    *,
    level: int = 0,
    annotation: Literal["dataset", "user", "scene"] = "dataset",
    complete: bool = True,
    asked: bool = True,
) -> Room:
    """Return a room whose type follows from its raw label; `heights` are those of its floor and its ceiling."""
    floor_y, ceiling_y = (float(round_mm(height)) for height in heights)
    label = vocabulary.room_type(raw_label, family)
    return Room(room_id, raw_label, label, level, floor_y, ceiling_y, polygon, annotation, complete, asked)


def read_regions(annotations: JsonNode, annotation: Literal["dataset", "user"], family: str) -> tuple[Room, ...]:
    """Return the rooms of a ``region_annotations`` array, sorted by id (the region's name).

    Raises
    ------
    FormatError : a type is wrong, a name is repeated, or a polygon is invalid
    """
    rooms: dict[str, Room] = {}
    for node in annotations.elements():
        name, raw = node["name"].text(), node["label"].text()
        if not name.strip():
            node["name"].fail("the region's name is empty")
        if name in rooms:
            node.fail(f"two regions are named {name!r}")
        floor, extrusion = node.get("floor_height"), node.get("extrusion_height")
        floor_y = DEFAULT_FLOOR if floor is None else floor.number()
        height = DEFAULT_EXTRUSION if extrusion is None else extrusion.number()
        if height <= 0:
            node["extrusion_height"].fail("the height must be positive")
        corners = np.array([corner.vector(3)[[0, 2]] for corner in node["poly_loop"].elements()])
        polygon = check_polygon(corners.reshape(-1, 2), node["poly_loop"])
        rooms[name] = made_room(family, name, raw, (floor_y, floor_y + height), polygon, annotation=annotation)
    return levelled(tuple(rooms[name] for name in sorted(rooms)))


@dataclass(frozen=True)
class RegionIndex:
    """Finds the room that contains a point."""

    rooms: tuple[Room, ...]

    @cached_property
    def _polygons(self) -> list[tuple[shapely.Polygon, Room]]:
        return [(shapely.Polygon(r.polygon), r) for r in self.rooms]

    def room_of(self, point: NDArray[np.float64]) -> tuple[Room | None, list[tuple[float, Room]]]:
        """Return the room that contains a point, else the nearest room within `NEAREST_REGION` of the point; None if
        there is none, or another room is about as near. If no room contains it, also return which are `near`.
        """
        room = self.holding(point)
        if room is not None:
            return room, []
        near = self.near(point)
        clear = len(near) == 1 or (len(near) > 1 and near[1][0] - near[0][0] >= CLEAR)
        return near[0][1] if clear and near[0][0] <= NEAREST_REGION else None, near

    def holding(self, point: NDArray[np.float64]) -> Room | None:
        """Return the room that contains a point (3,); of several, the smallest."""
        spot = shapely.Point(point[0], point[2])
        holding = [(polygon.area, r.room_id, r) for polygon, r in self._around(point) if polygon.covers(spot)]
        return min(holding, key=lambda h: h[:2])[2] if holding else None

    def near(self, point: NDArray[np.float64]) -> list[tuple[float, Room]]:
        """Return (distance in metres, room) of each room within a horizontal distance of twice `NEAREST_REGION` of a
        point, nearest first.
        """
        spot = shapely.Point(point[0], point[2])
        near = [(float(polygon.distance(spot)), r.room_id, r) for polygon, r in self._around(point)]
        return [(metres, room) for metres, _, room in sorted(near, key=lambda n: n[:2]) if metres <= 2 * NEAREST_REGION]

    def _around(self, point: NDArray[np.float64]) -> list[tuple[shapely.Polygon, Room]]:
        """Return (polygon, room) of each room at the height of a point: the point is at most `NEAREST_REGION` below the
        room's floor or above its ceiling.
        """
        return [
            (polygon, r)
            for polygon, r in self._polygons
            if r.floor_y - NEAREST_REGION <= point[1] <= r.ceiling_y + NEAREST_REGION
        ]


def in_rooms(objects: Iterable[SceneObject], rooms: Sequence[Room]) -> tuple[list[SceneObject], list[SceneWarning]]:
    """Assign each object to the room that contains the object's centre, else to the nearest room, provided that this
    room is near and no other room is about as near. Return the objects and the warnings.

    A warning ``nearest_room`` names each object whose centre is outside its assigned room, and
    ``object_outside_rooms`` each that is left out. A room without a polygon contains everything.
    """
    whole = next((room for room in rooms if room.polygon is None), None)
    index = RegionIndex(tuple(rooms))
    placed: list[SceneObject] = []
    said: list[SceneWarning] = []
    for item in objects:
        room, near = (whole, []) if whole is not None else index.room_of(item.center)
        if near or room is None:
            if room is not None:
                message = (
                    f"its centre is in no room; it counts to the nearest one, {room.room_id}, {near[0][0]:.2f} m away"
                )
                said.append(SceneWarning("nearest_room", item.object_id, message))
            else:
                which = ", ".join(f"{r.room_id} {metres:.2f} m away" for metres, r in near)
                why = f"is in none and could be in {which}" if which else "is in none and near none"
                message = f"its centre {item.center.tolist()} {why}: left out"
                said.append(SceneWarning("object_outside_rooms", item.object_id, message))
        if room is not None:
            placed.append(replace(item, room_id=room.room_id))
    return placed, said


def side_regions(side: Path, names: Sequence[str], family: str, ledger: InputLedger) -> tuple[Room, ...]:
    """Return the zones that the user drew for a scene. `side` is one file for all scenes, or a folder with a file
    ``<name>.semantic_config.json`` for each scene that has zones.

    Parameters
    ----------
    names : possible names of the scene's file: the scene's own name, its stage's

    Raises
    ------
    InputError : the file is malformed
    """
    for file in [side] if side.is_file() else [side / f"{name}.semantic_config.json" for name in names]:
        if file.is_file():
            data = DatasetRoot(file.parent).read(file.name, MAX_REGION_BYTES)
            annotations = parse_json(data, str(file))["region_annotations"]
            ledger.entry(f"regions/{file.name}", "region_annotations", annotations.value)
            return read_regions(annotations, "user", family)
    return ()


def check_polygon(corners: NDArray[np.float64], node: JsonNode) -> NDArray[np.float64]:
    """Return the (n, 2) corners rounded to 1 mm, checked to enclose an area without self-intersection.

    Raises
    ------
    FormatError : the polygon at `node` is invalid
    """
    corners = round_mm(corners)
    if len(corners) < 3:
        node.fail("a polygon has at least three corners")
    polygon = shapely.Polygon(corners)
    if not polygon.is_valid or not polygon.area > 0:
        node.fail(f"the polygon is not simple ({shapely.is_valid_reason(polygon)})")
    return corners


def levelled(rooms: tuple[Room, ...]) -> tuple[Room, ...]:
    """Assign levels to rooms by ascending floor height. A new level begins where the next floor is at least
    `LEVEL_STEP` higher.
    """
    floors = sorted({r.floor_y for r in rooms})
    level_of: dict[float, int] = {}
    level = 0
    for i, floor in enumerate(floors):
        level += i > 0 and floor - floors[i - 1] >= LEVEL_STEP
        level_of[floor] = level
    return tuple(replace(r, level=level_of[r.floor_y]) for r in rooms)


def typed_by_contents(rooms: Sequence[Room], items: Iterable[SceneObject]) -> tuple[Room, ...]:
    """Return the rooms; those without a type of their own have the type that shows in what they hold."""
    held: dict[str, list[str]] = {}
    for item in items:
        held.setdefault(item.room_id, []).append(item.label)
    types = types_by_contents({room.room_id: room.label for room in rooms}, held, vocabulary)
    return tuple(replace(room, label=types[room.room_id]) for room in rooms)
