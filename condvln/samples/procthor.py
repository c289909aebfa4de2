"""Write layouts as ProcTHOR houses: ``houses.jsonl.gz``, one house per line, and ``asset-database.json``.

The format follows real houses of schema 1.0.0: room outlines are clockwise in (x, z), positions are centres of boxes,
and objects on others are their children. Room types beyond ProcTHOR's four are written in its spelling. The frame is
Unity's (left-handed, +y up, +z north): (x, y, z) becomes (x, y, −z), angles are negated.

A wall between two rooms is written once for each room, in opposite directions, and split where the adjacent room
changes. Interior walls list their lower corners first, exterior ones their upper corners. Doors are given along
``wall0`` from its first lower corner.

Habitat's form of the dataset (``ai2thor-hab``) has scene instances without rooms, plus houses. ``hab/`` is a Habitat
scene dataset with the names and folders of the released one
(``configs/scenes/ProcTHOR/<n>/ProcTHOR-Train-<k>.scene_instance.json``); ``houses/train.jsonl.gz`` has house k in line
k. Both are in the house's own frame, with z mirrored. Only the houses contain rooms.
"""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import orjson
import shapely

from condvln.samples.catalogue import Kind, catalogue, class_ids, native_labels, record
from condvln.samples.floor_mesh import free_floor
from condvln.samples.floor_plan import SHARED
from condvln.samples.layout import Door, Furniture, Layout
from condvln.samples.replicacad import LEXICON, replicacad_files
from schemas.base import Json

__all__ = ["HOUSES", "SCENES", "UnityFrame", "ai2thor_hab_files", "primary_property", "procthor_files"]

SCENES: Final = "hab"
HOUSES: Final = "houses"
"""The two folders of the dataset."""

SCENES_A_FOLDER: Final = 100
DECIMALS = 6

_SCENE: Final = "configs/scenes/"
_LEFT_OUT: Final = ("navmeshes", "configs/semantics/")


def ai2thor_hab_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files as (path relative to the folder that holds ``hab/`` and ``houses/``, bytes). Layout k becomes the
    scene ``ProcTHOR-Train-<k>``.
    """
    for path, content in procthor_files(layouts):
        yield f"{HOUSES}/{path.replace('houses.', 'train.')}", content
    named = {f"ProcTHOR-Train-{k}": in_house_frame(layout) for k, layout in enumerate(layouts.values())}
    for path, content in replicacad_files(named):
        if path.startswith(_LEFT_OUT):
            continue
        if path.startswith(_SCENE):
            name = path.removeprefix(_SCENE)
            folder = int(name.split(".")[0].rsplit("-", 1)[1]) // SCENES_A_FOLDER
            path, content = f"{_SCENE}ProcTHOR/{folder}/{name}", _scene(content)
        elif path.endswith(".scene_dataset_config.json"):
            path, content = "ai2thor-hab.scene_dataset_config.json", _dataset(content)
        elif path == f"configs/ssd/{LEXICON}.json":
            content = _lexicon(content)
        elif path.endswith(".ao_config.json"):
            content = _articulated(path.split("/")[1])
        yield f"{SCENES}/{path}", content


def in_house_frame(layout: Layout) -> Layout:
    """Return `layout` in the coordinate frame of its house. The lowest corner in Unity's frame becomes the origin; then
    z is mirrored.
    """
    (x0, _), (_, z1) = layout.bounds

    def point(x: float, z: float) -> tuple[float, float]:
        return round(x - x0, DECIMALS) + 0.0, round(z - z1, DECIMALS) + 0.0

    def center(at: tuple[float, float, float]) -> tuple[float, float, float]:
        x, z = point(at[0], at[2])
        return x, at[1], z

    return replace(
        layout,
        rooms=tuple(replace(room, polygon=tuple(point(*c) for c in room.polygon)) for room in layout.rooms),
        doors=tuple(replace(door, start=point(*door.start), end=point(*door.end)) for door in layout.doors),
        furniture=tuple(replace(piece, center=center(piece.center)) for piece in layout.furniture),
    )


def _scene(content: bytes) -> bytes:
    document = orjson.loads(content)
    del document["navmesh_instance"], document["semantic_scene_instance"]
    return orjson.dumps(document)


def _dataset(content: bytes) -> bytes:
    document: dict[str, Any] = orjson.loads(content)
    del document["navmesh_instances"]
    document["scene_instances"]["paths"] = {".json": ["configs/scenes/ProcTHOR/*"]}
    document["articulated_objects"]["paths"] = {".json": ["urdf/*/"]}
    del document["semantic_scene_descriptor_instances"]["paths"]
    return orjson.dumps(document)


def _lexicon(content: bytes) -> bytes:
    """Return the semantic lexicon with each of the catalogue's words replaced by AI2-THOR's object type."""
    classes = [{**c, "name": native_labels()[c["name"]].ai2thor} for c in orjson.loads(content)["classes"]]
    return orjson.dumps({"classes": classes})


def _articulated(name: str) -> bytes:
    """Return the configuration of the articulated body `name`. Habitat's ProcTHOR has no names for the types of such
    bodies, so the semantic id is the position (from 1) of the body's label among the catalogue's sorted labels.
    """
    (label,) = {kind.label for kind in catalogue().values() if kind.urdf == name}
    return orjson.dumps({"urdf_filepath": f"{name}.urdf", "semantic_id": class_ids()[label]})


@dataclass(frozen=True, slots=True)
class UnityFrame:
    """Unity's coordinate frame, with its origin moved by (x, z)."""

    x: float = 0.0
    z: float = 0.0

    @classmethod
    def with_corner_at_origin(cls, layout: Layout) -> UnityFrame:
        """Return the frame in which the plan's lowest corner is (0, 0, 0), as in ProcTHOR's houses."""
        (x0, _), (_, z1) = layout.bounds
        return cls(-x0, z1)

    def ground(self, x: float, z: float) -> tuple[float, float]:
        """Return a floor point (x, z) in Unity's frame."""
        return round(x + self.x, DECIMALS) + 0.0, round(self.z - z, DECIMALS) + 0.0

    def point(self, x: float, y: float, z: float) -> dict[str, float]:
        """Return a point in Unity's JSON form."""
        unity_x, unity_z = self.ground(x, z)
        return {"x": unity_x, "y": round(y, DECIMALS) + 0.0, "z": unity_z}

    def center(self, piece: Furniture) -> dict[str, float]:
        """Return the centre of a piece's box in Unity's JSON form."""
        return self.point(*piece.center)

    def rotation(self, piece: Furniture) -> dict[str, float]:
        """Return a piece's rotation as Euler angles in degrees; yaw is clockwise seen from above."""
        return {"x": 0.0, "y": -math.degrees(piece.yaw.radians) % 360, "z": 0.0}


FIRST_ROOM: Final = 2
"""Number of the first room; 1 is the outdoors."""

WIDE_DOORWAY: Final = 1.1
"""Width in metres from which an opening gets a double frame without a leaf; narrower ones have an open door."""

FRONT_DOOR: Final = 1.0
DOOR_HEIGHT: Final = 2.05
"""Width and height in metres of the door to the outdoors."""

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
        records.append(record("procthor wall", name=wall.name, corners=[*lower, *upper], room=wall.room))
        if wall.behind is None:
            corners = [*upper[::-1], *lower[::-1]]
            records.append(record("procthor wall", name=wall.exterior_name, corners=corners, room=wall.room))
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
    made: Json = record(
        "procthor door",
        **_hole(near, far, door.height),
        first=min(first, second),
        second=max(first, second),
        room0=first,
        room1=second,
        wall0=wall0.name,
        wall1=wall1.name,
        asset=door_asset(door.width),
    )
    return made if door.width > WIDE_DOORWAY else made | {"openable": True, "openness": 1}


def _hole(near: float, far: float, height: float) -> Json:
    middle, half_height = (near + far) / 2, height / 2
    return {"near": near, "far": far, "middle": middle, "height": height, "half_height": half_height}


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
    made: Json = record(
        "procthor door",
        **_hole(near, round(near + FRONT_DOOR, 6), DOOR_HEIGHT),
        first=1,
        second=wall.room,
        room0=wall.room,
        room1=wall.room,
        wall0=wall.name,
        wall1=wall.exterior_name,
        asset=door_asset(FRONT_DOOR),
    )
    return made | {"openable": False, "openness": 0}


def door_asset(width: float) -> str:
    return f"Doorframe_Double_{width:.2f}" if width > WIDE_DOORWAY else f"Doorway_{width:.2f}"


DOOR_DEPTH: Final = 0.17
"""Depth in metres of a door's asset."""


def procthor_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes). House k is line k of
    ``houses.jsonl.gz``.
    """
    lines = b"".join(orjson.dumps(_house(layout)) + b"\n" for layout in layouts.values())
    yield "houses.jsonl.gz", gzip.compress(lines, mtime=0)
    yield "asset-database.json", orjson.dumps(_asset_database(), option=orjson.OPT_INDENT_2) + b"\n"


def _house(layout: Layout) -> Json:
    frame = UnityFrame.with_corner_at_origin(layout)
    number = {room.room_id: FIRST_ROOM + i for i, room in enumerate(layout.rooms)}
    outlines = [[frame.ground(x, z) for x, z in room.polygon] for room in layout.rooms]
    walls = [wall for i, outline in enumerate(outlines) for wall in house_walls(i, outline, outlines)]
    rooms = [
        record(
            "procthor room",
            number=FIRST_ROOM + i,
            type="".join(map(str.capitalize, room.label.split())),
            floor=[{"x": x, "y": 0, "z": z} for x, z in outlines[i]],
            layer=i % 4,
        )
        for i, room in enumerate(layout.rooms)
    ]
    doors = [door_record(door, number, walls, frame) for door in layout.doors]
    x, z = _widest_place(layout, frame)
    return record(
        "procthor house",
        rooms=rooms,
        doors=[*front_door(layout, number, walls, frame), *doors],
        objects=_objects(layout, number, frame),
        walls=wall_records(walls, layout.ceiling),
        count=len(layout.rooms),
        x=x,
        z=z,
    )


def _objects(layout: Layout, number: Mapping[str, int], frame: UnityFrame) -> list[Json]:
    """Return the object records of a house. Objects that stand on another object are children of its record, at any
    depth.
    """
    records: dict[str, Json] = {}
    tops = []
    for count, piece in enumerate(layout.furniture):
        room = number[piece.room_id]
        place = f"surface|{room}" if piece.parent else f"{room}"
        made: Json = record(
            "procthor object",
            label=native_labels()[piece.label].ai2thor,
            place=place,
            count=count,
            asset=_asset(piece.kind, piece.variant),
            position=frame.center(piece),
            rotation=frame.rotation(piece),
            kinematic=piece.parent is None,
        )
        records[piece.object_id] = made
        if piece.parent is None:
            tops.append(made)
        else:
            records[piece.parent].setdefault("children", []).append(made)
    return tops


def _widest_place(layout: Layout, frame: UnityFrame) -> Point:
    """Return the x and z of a start in the widest part of the floor."""
    spot = shapely.maximum_inscribed_circle(free_floor(layout), tolerance=0.05).coords[0]
    x, z = frame.ground(*spot)
    return round(x, 2), round(z, 2)


def _asset(kind: str, variant: int) -> str:
    # Assets are named like AI2-THOR's, by type and number; the kind distinguishes types with several kinds.
    return f"{native_labels()[catalogue()[kind].label].ai2thor}_{kind}_{variant + 1}"


def _asset_database() -> dict[str, list[Json]]:
    """Return all assets by object type. Every kind and size of the catalogue is included, so that the database is the
    same for all datasets.
    """
    database: dict[str, list[Json]] = {}
    for kind in catalogue().values():
        for variant, size in enumerate(kind.sizes):
            asset = _asset_record(
                _asset(kind.kind, variant), native_labels()[kind.label].ai2thor, size, primary_property(kind)
            )
            database.setdefault(asset["objectType"], []).append(asset)
    for width in (0.9, 0.95, 1.0, 1.2, 1.4, 1.6):
        kind_name = "Doorframe" if width > WIDE_DOORWAY else "Doorway"
        size = (round(width * 1000), round(DOOR_HEIGHT * 1000), round(DOOR_DEPTH * 1000))
        database.setdefault(kind_name, []).append(_asset_record(door_asset(width), kind_name, size, "Static"))
    return dict(sorted(database.items()))


def _asset_record(name: str, kind: str, size: tuple[int, int, int], movable: str) -> Json:
    box = dict(zip("xyz", (v / 1000 for v in size), strict=True))
    secondary = ["Receptacle"] if movable == "Moveable" else []
    return record("procthor asset", asset=name, box=box, kind=kind, movable=movable, secondary=secondary)


def primary_property(kind: Kind) -> str:
    """Return AI2-THOR's "primary property" for objects of this kind: what an agent can do with them."""
    if kind.turns:
        return "Moveable"
    if kind.front or kind.hang is not None:
        return "Static"
    return "CanPickup" if max(kind.sizes[0]) < 500 else "Moveable"
