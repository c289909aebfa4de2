"""Own scenes: one JSON file each, with rooms as floor polygons and objects as boxes. docs/boxes.md explains the format.

Walls are those of the file; without any, the outlines of the rooms, with openings for the doors; and a file without
walls and doors has neither, so that rooms are open to each other where they touch.
"""

from __future__ import annotations

import math
import posixpath
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np
import shapely
from pydantic import Field, StringConstraints, ValidationError, ValidationInfo, field_validator

from condvln.arrays import F64
from condvln.formats.json_document import parse_json
from condvln.labels import vocabulary
from condvln.scene import OrientedBox, Room, Scene, SceneObject, SceneWarning, round_mm
from condvln.scene.boxes import with_box
from condvln.scene.rotations import Z_UP_TO_HABITAT, rotation_y
from condvln.scene.scene import SceneGeometry
from condvln.sources.procthor_house import HouseWall, Opening
from condvln.sources.procthor_solids import walls_with_openings
from condvln.sources.regions import in_rooms, levelled, made_room
from condvln.sources.scene_source import FileSource, Note
from condvln.sources.solids import Piece, floor, joined, object_boxes
from condvln.sources.source import MAX_OBJECTS, InputLedger
from schemas.base import Document
from schemas.errors import FormatError, InputError

__all__ = ["BoxScene", "BoxesSource"]


MAX_BYTES: Final = 64 << 20
LARGEST: Final = 300.0
"""Largest extent of a scene in metres: the navmesh of a larger one would not fit in memory."""
REACH: Final = 1e4
"""Largest coordinate in metres."""
DOOR_REACH: Final = 0.25
"""Metres on both sides of a door in which walls are opened and floor is laid: where rooms are drawn without their
walls, there is a gap between them.
"""
SHOWN: Final = 20
"""Number of faults of a file that an error names."""

Coordinate = Annotated[float, Field(strict=True, ge=-REACH, le=REACH)]
Length = Annotated[float, Field(strict=True, ge=0.001, le=100.0)]
Name = Annotated[str, StringConstraints(strict=True, strip_whitespace=True, min_length=1, max_length=200)]
Spot = tuple[Coordinate, Coordinate]
"""A place on the ground: (x, z), or (x, y) where z is up."""


class _Labelled(Document):
    label: Name
    id: Name | None = None


class BoxRoom(_Labelled):
    """A room: its outline on the ground, the height of its floor, and its height; metres."""

    polygon: Annotated[tuple[Spot, ...], Field(min_length=3)]
    floor: Coordinate = 0.0
    height: Length = 2.5

    @field_validator("polygon")
    @classmethod
    def _simple(cls, corners: tuple[Spot, ...]) -> tuple[Spot, ...]:
        outline = shapely.Polygon(round_mm(corners))
        if not outline.is_valid or not outline.area > 0:
            raise ValueError(f"the polygon is not simple ({shapely.is_valid_reason(outline)})")
        return corners


class BoxObject(_Labelled):
    """An object: the centre of its box, the box's full size along its own axes in metres, and its yaw in degrees,
    counter-clockwise seen from above.
    """

    center: tuple[Coordinate, Coordinate, Coordinate]
    size: tuple[Length, Length, Length]
    yaw: Annotated[float, Field(strict=True, ge=-3600, le=3600)] = 0.0
    room: Name | None = None


class BoxLine(Document):
    """A wall or an open door, from one place on the ground to another; height in metres above the floor."""

    start: Annotated[Spot, Field(alias="from")]
    to: Spot
    height: Length | None = None

    @field_validator("to")
    @classmethod
    def _long(cls, to: Spot, info: ValidationInfo) -> Spot:
        start = info.data.get("start")
        if start is not None and np.hypot(*np.subtract(start, to)) < 0.01:
            raise ValueError("it is shorter than 1 cm")
        return to


class BoxScene(Document):
    """A file of family ``boxes``."""

    up: Literal["y", "z"] = "y"
    rooms: Annotated[tuple[BoxRoom, ...], Field(min_length=1, max_length=MAX_OBJECTS)]
    objects: Annotated[tuple[BoxObject, ...], Field(max_length=MAX_OBJECTS)]
    doors: Annotated[tuple[BoxLine, ...], Field(max_length=2000)] = ()
    walls: Annotated[tuple[BoxLine, ...], Field(max_length=MAX_OBJECTS)] | None = None

    def ground(self, place: Spot) -> F64:
        """Return (x, z) in Habitat's frame of a place on the ground."""
        return np.array([place[0], -place[1] + 0.0 if self.up == "z" else place[1]])

    def faults(self) -> Iterator[str]:
        """Yield what is wrong between keys that are right by themselves, each with its place."""
        rooms = _ids(self.rooms)
        for key, ids in (("rooms", rooms), ("objects", _ids(self.objects))):
            counts = Counter(ids)
            yield from (
                f"{key}[{k}].id: {counts[own]} of the {key} have the id {own!r}"
                for k, own in enumerate(ids)
                if counts[own] > 1
            )
        second = 1 if self.up == "z" else 2
        places = [corner for room in self.rooms for corner in room.polygon]
        places += [(item.center[0], item.center[second]) for item in self.objects]
        places += [place for line in (*self.doors, *(self.walls or ())) for place in (line.start, line.to)]
        if (extent := float(np.ptp(places, axis=0).max())) > LARGEST:
            yield f"top level: the scene is {extent:.0f} m long, at most {LARGEST:.0f} m are read; are these metres?"
        for k, item in enumerate(self.objects):
            if item.room is not None and item.room not in rooms:
                yield f"objects[{k}].room: there is no room {item.room!r}, only {', '.join(rooms[:SHOWN])}"


def _ids(items: Sequence[_Labelled]) -> list[str]:
    """Return the id of each room or object: its own, else its label and its number, from 0."""
    return [item.id or f"{item.label} {k}" for k, item in enumerate(items)]


class BoxesSource(FileSource):
    """Files ``<scene>.json`` of a folder and its direct subfolders."""

    family: ClassVar[str] = "boxes"
    bytes_per_object: ClassVar[float] = 120.0
    objects_per_room: ClassVar[float] = 10.0

    nothing: ClassVar[tuple[str, str]] = (
        "scenes (*.json)",
        "Put a file <scene>.json for each scene there (docs/boxes.md), or correct the source's 'root'",
    )

    def listing(self) -> Iterator[tuple[str, Note]]:
        """See `Source.listing`."""
        for scene_id, path in self.scans().items():
            try:
                value = parse_json(self.files.read(path, MAX_BYTES), str(self.root / path)).value
                if not isinstance(value, dict) or not {"rooms", "objects"} & value.keys():
                    self.pass_over(path, "JSON without rooms and objects")
                    continue
            except InputError:
                pass  # the reader says what is wrong with it
            yield scene_id, partial(self.note, scene_id, path)

    def scene(self, scene_id: str) -> Scene:
        """Return one scene; see `Source.read`."""
        document, ledger = self.document(scene_id), InputLedger()
        name = posixpath.basename(scene_id)
        rooms = self.drawn_rooms([name], ledger) or self._rooms(document)
        known = {room.room_id for room in rooms}
        named = [*zip(document.objects, _ids(document.objects), strict=True)]
        items = [_object(document, item, own) for item, own in named]
        stated = {own: item.room for item, own in named if item.room is not None and item.room in known}
        placed, warnings = in_rooms((item for item in items if item.object_id not in stated), rooms)
        placed += [replace(item, room_id=stated[item.object_id]) for item in items if item.object_id in stated]
        if not document.doors and document.walls is None:
            why = "no doors and no walls are given: rooms are open to each other where they touch"
            warnings.append(SceneWarning("no_walls", scene_id, why))
        return self.made(scene_id, rooms, placed, warnings, self.shipped_navmeshes(name, ledger))

    def geometry(self, scene: Scene) -> SceneGeometry:
        """Return floors, walls with openings for the doors, and objects as boxes; see `Source.geometry`."""
        structure = _structure(self.document(scene.scene_id))
        return joined([*structure, object_boxes(enumerate(scene.objects))], approximate=True)

    def document(self, scene_id: str) -> BoxScene:
        """Return the content of a scene's file.

        Raises
        ------
        FormatError : not JSON, or keys are missing or wrong; the message names all of them
        """
        path = self.path_of(scene_id, self.scans())
        where = str(self.root / path)
        value = parse_json(self.files.read(path, MAX_BYTES), where).value
        try:
            document = BoxScene.model_validate(value)
        except ValidationError as error:
            raise _wrong([_fault(one) for one in error.errors(include_url=False)], where) from None
        if faults := [*document.faults()]:
            raise _wrong(faults, where)
        return document

    def _rooms(self, document: BoxScene) -> tuple[Room, ...]:
        return levelled(
            tuple(
                made_room(
                    self.family,
                    own,
                    room.label,
                    (room.floor, room.floor + room.height),
                    round_mm([document.ground(corner) for corner in room.polygon]),
                )
                for room, own in zip(document.rooms, _ids(document.rooms), strict=True)
            )
        )

    def scans(self) -> dict[str, str]:
        """Return the path of each scene's file by scene id, sorted; the subfolder is part of the id."""
        return {path.removesuffix(".json"): path for path in sorted(self.matching("*.json", "*/*.json"))}

    def note(self, scene_id: str, path: str, ledger: InputLedger) -> None:
        """See `FileSource.note`."""
        super().note(scene_id, path, ledger)
        document = self.document(scene_id)
        ledger.rooms, ledger.objects = len(document.rooms), len(document.objects)


def _fault(error: Mapping[str, Any]) -> str:
    """Return the place and the cause of one of pydantic's errors."""
    place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in error["loc"]).lstrip(".")
    what = {"missing": "the key is missing", "extra_forbidden": "there is no such key"}
    return f"{place or 'top level'}: {what.get(error['type'], error['msg'].removeprefix('Value error, '))}"


def _wrong(faults: list[str], where: str) -> FormatError:
    more = [f"and {len(faults) - SHOWN} more"] if len(faults) > SHOWN else []
    return FormatError(
        "; ".join([*faults[:SHOWN], *more]), where=where, remedy="Correct these keys; docs/boxes.md lists all keys"
    )


def _object(document: BoxScene, item: BoxObject, own: str) -> SceneObject:
    """Return an object that is not assigned to a room yet."""
    turn = Z_UP_TO_HABITAT if document.up == "z" else np.eye(3)
    size = np.abs(turn @ np.array(item.size))
    box = OrientedBox(turn @ np.array(item.center), size / 2, rotation_y(math.radians(item.yaw)))
    label = vocabulary.canonical(item.label, BoxesSource.family)
    return with_box(SceneObject(own, "", item.label, label, round_mm(box.center)), box)


def _structure(document: BoxScene) -> list[Piece]:
    """Return the floors of rooms and doors, and the walls."""
    outlines = [round_mm([document.ground(corner) for corner in room.polygon]) for room in document.rooms]
    floors = [floor(outline, room.floor) for outline, room in zip(outlines, document.rooms, strict=True)]
    shapes = [shapely.Polygon(outline) for outline in outlines]

    def placed(line: BoxLine) -> tuple[F64, F64, float, float]:
        """Return both ends of a line, and its heights: those of the nearest room."""
        start, end = document.ground(line.start), document.ground(line.to)
        room = document.rooms[int(np.argmin(shapely.distance(shapes, shapely.Point((start + end) / 2))))]
        return start, end, room.floor, room.floor + (line.height or room.height)

    edges = [placed(line) for line in document.walls or ()]
    if document.walls is None and document.doors:
        edges = [
            (start, end, room.floor, room.floor + room.height)
            for outline, room in zip(outlines, document.rooms, strict=True)
            for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True)
        ]
    doors = []
    for start, end, low, top in map(placed, document.doors):
        doors.append(Opening("", "door", ("", ""), "", start, end, low - DOOR_REACH, top, passable=True))
        along = (end - start) / np.linalg.norm(end - start)
        across = DOOR_REACH * np.array([-along[1], along[0]])
        floors.append(floor(round_mm([start - across, end - across, end + across, start + across]), low))
    walls = [HouseWall("", "", *edge, empty=False) for edge in edges]
    return [*floors, *walls_with_openings(walls, doors, DOOR_REACH)]
