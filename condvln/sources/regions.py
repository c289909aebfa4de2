"""Rooms from region annotations: vertical prisms over polygons, as Habitat's semantic configurations hold them."""

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
from condvln.scene import Room, SceneObject, SceneWarning, round_mm
from condvln.sources.input_ledger import InputLedger

__all__ = ["NEAREST_REGION", "RegionIndex", "check_polygon", "in_rooms", "read_regions", "side_regions"]

NEAREST_REGION: Final = 0.25
"""Metres. An object whose centre lies so little outside all regions (in a wall, on a sill) is the nearest one's."""

DEFAULT_FLOOR: Final = 0.0
DEFAULT_EXTRUSION: Final = 2.5
"""Metres; habitat-sim's defaults of ``floor_height`` and ``extrusion_height``."""

MAX_REGION_BYTES: Final = 64 << 20

LEVEL_STEP: Final = 1.0
"""Metres. Floors less far apart belong to one level."""


def read_regions(annotations: JsonNode, annotation: Literal["dataset", "user"], family: str) -> tuple[Room, ...]:
    """Rooms of a ``region_annotations`` array, sorted by id (the region's name).

    Raises
    ------
    FormatError : a wrong type, a name given twice, a polygon that is none
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
            node["extrusion_height"].fail("the height is not above zero")
        corners = np.array([corner.vector(3)[[0, 2]] for corner in node["poly_loop"].elements()])
        rooms[name] = Room(
            room_id=name,
            raw_label=raw,
            label=vocabulary.room_type(raw, family),
            level=0,
            floor_y=float(round_mm(floor_y)),
            ceiling_y=float(round_mm(floor_y + height)),
            polygon=check_polygon(corners.reshape(-1, 2), node["poly_loop"]),
            annotation=annotation,
            complete=True,
        )
    return _levelled(tuple(rooms[name] for name in sorted(rooms)))


@dataclass(frozen=True)
class RegionIndex:
    """Tells which room a point is in."""

    rooms: tuple[Room, ...]

    @cached_property
    def _polygons(self) -> list[tuple[shapely.Polygon, Room]]:
        return [(shapely.Polygon(r.polygon), r) for r in self.rooms]

    def room_of(self, point: NDArray[np.float64]) -> Room | None:
        """The room that holds a point (3,): of several the smallest; of none the nearest within `NEAREST_REGION`."""
        around = [
            (polygon, r)
            for polygon, r in self._polygons
            if r.floor_y - NEAREST_REGION <= point[1] <= r.ceiling_y + NEAREST_REGION
        ]
        spot = shapely.Point(point[0], point[2])
        holding = [(polygon.area, r.room_id, r) for polygon, r in around if polygon.covers(spot)]
        if holding:
            return min(holding, key=lambda h: h[:2])[2]
        near = [(polygon.distance(spot), r.room_id, r) for polygon, r in around]
        near = [n for n in near if n[0] <= NEAREST_REGION]
        return min(near, key=lambda n: n[:2])[2] if near else None


def in_rooms(objects: Iterable[SceneObject], rooms: Sequence[Room]) -> tuple[list[SceneObject], list[SceneWarning]]:
    """Objects with the room that holds their centre, and a warning for each that stands in none and is left out.

    A room without a polygon holds everything.
    """
    whole = next((room for room in rooms if room.polygon is None), None)
    index = RegionIndex(tuple(rooms))
    placed: list[SceneObject] = []
    lost: list[SceneWarning] = []
    for item in objects:
        room = whole or index.room_of(item.center)
        if room is None:
            message = f"its centre {item.center.tolist()} is in no room: left out"
            lost.append(SceneWarning("object_outside_rooms", item.object_id, message))
        else:
            placed.append(replace(item, room_id=room.room_id))
    return placed, lost


def side_regions(side: Path, names: Sequence[str], family: str, ledger: InputLedger) -> tuple[Room, ...]:
    """Zones that the user drew: one file for all scenes, or a folder with a ``<name>.semantic_config.json`` for some.

    Parameters
    ----------
    names : what the scene's file may be called: its own name, its stage's

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
    """(n, 2) corners rounded to 1 mm, checked to enclose an area without crossing themselves.

    Raises
    ------
    FormatError : about `node`
    """
    corners = round_mm(corners)
    if len(corners) < 3:
        node.fail("a polygon has at least three corners")
    polygon = shapely.Polygon(corners)
    if not polygon.is_valid or not polygon.area > 0:
        node.fail(f"the polygon is not simple ({shapely.is_valid_reason(polygon)})")
    return corners


def _levelled(rooms: tuple[Room, ...]) -> tuple[Room, ...]:
    """Rooms with their level: floors in ascending order, a new level where the next is `LEVEL_STEP` higher."""
    floors = sorted({r.floor_y for r in rooms})
    level_of: dict[float, int] = {}
    level = 0
    for i, floor in enumerate(floors):
        level += i > 0 and floor - floors[i - 1] >= LEVEL_STEP
        level_of[floor] = level
    return tuple(replace(r, level=level_of[r.floor_y]) for r in rooms)
