"""Write layouts as ProcTHOR houses: ``houses.jsonl.gz``, one house per line, and ``asset-database.json``.

The format follows real houses of schema 1.0.0 (or, on request, of the older 0.0.1): room outlines are clockwise in
(x, z), positions are centres of boxes, and objects on others are their children. Room types beyond ProcTHOR's four are
written in its spelling.
"""

from __future__ import annotations

import gzip
from collections.abc import Iterator, Mapping
from typing import Any, Final, Literal

import orjson
import shapely

from condvln.samples.catalogue import Kind, catalogue
from condvln.samples.free_floor import free_floor
from condvln.samples.layout import Layout
from condvln.samples.native_labels import native_labels
from condvln.samples.procthor_walls import (
    DOOR_HEIGHT,
    FIRST_ROOM,
    WIDE_DOORWAY,
    door_asset,
    door_record,
    front_door,
    house_walls,
    wall_records,
)
from condvln.samples.unity import UnityFrame

__all__ = ["primary_property", "procthor_files"]

AGENT_HEIGHT: Final = 0.95
"""Height in metres of the agent's start, the same in all houses."""

DOOR_DEPTH: Final = 0.17
"""Depth in metres of a door's asset."""

Json = dict[str, Any]
Schema = Literal["1.0.0", "0.0.1"]


def procthor_files(layouts: Mapping[str, Layout], schema: Schema = "1.0.0") -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes). House k is line k of
    ``houses.jsonl.gz``.
    """
    houses = (_house(layout) for layout in layouts.values())
    written = houses if schema == "1.0.0" else map(_older, houses)
    lines = b"".join(orjson.dumps(house) + b"\n" for house in written)
    yield "houses.jsonl.gz", gzip.compress(lines, mtime=0)
    yield "asset-database.json", orjson.dumps(_asset_database(), option=orjson.OPT_INDENT_2) + b"\n"


def _house(layout: Layout) -> Json:
    frame = UnityFrame.with_corner_at_origin(layout)
    number = {room.room_id: FIRST_ROOM + i for i, room in enumerate(layout.rooms)}
    outlines = [[frame.ground(x, z) for x, z in room.polygon] for room in layout.rooms]
    walls = [wall for i, outline in enumerate(outlines) for wall in house_walls(i, outline, outlines)]
    return {
        "rooms": [
            {
                "id": f"room|{FIRST_ROOM + i}",
                "roomType": _camel(room.label),
                "children": [],
                "ceilings": [],
                "floorPolygon": [{"x": x, "y": 0, "z": z} for x, z in outlines[i]],
                "floorMaterial": {"name": "WoodGrain_Brown"},
                "layer": f"Procedural{i % 4}",
            }
            for i, room in enumerate(layout.rooms)
        ],
        "doors": [
            *front_door(layout, number, walls, frame),
            *(door_record(d, number, walls, frame) for d in layout.doors),
        ],
        "windows": [],
        "objects": _objects(layout, number, frame),
        "walls": wall_records(walls, layout.ceiling),
        "proceduralParameters": {
            "floorColliderThickness": 1.0,
            "receptacleHeight": 0.7,
            "skyboxId": "Sky1",
            "ceilingMaterial": {"name": "PureWhite"},
            "lights": [],
            "reflections": [],
        },
        "metadata": {
            "agent": _agent(layout, frame),
            "roomSpecId": f"{len(layout.rooms)}-room",
            "schema": "1.0.0",
            "warnings": {},
        },
    }


def _older(house: Json) -> Json:
    """Return the same house in schema 0.0.1: no schema version, openings as boxes with an offset, materials by name
    only.
    """
    doors = []
    for door in house["doors"]:
        low, high = door["holePolygon"]
        # The asset fills its opening, so it has no offset from the opening's corner.
        box = {"boundingBox": {"min": low, "max": high}, "assetOffset": {"x": 0.0, "y": 0.0}}
        doors.append({key: value for key, value in door.items() if key not in ("holePolygon", "assetPosition")} | box)
    metadata = {key: value for key, value in house["metadata"].items() if key != "schema"}
    rooms = [room | {"floorMaterial": room["floorMaterial"]["name"]} for room in house["rooms"]]
    walls = [wall | {"material": wall["material"]["name"]} for wall in house["walls"]]
    return house | {"doors": doors, "metadata": metadata, "rooms": rooms, "walls": walls}


def _camel(label: str) -> str:
    return "".join(word.capitalize() for word in label.split())


def _objects(layout: Layout, number: Mapping[str, int], frame: UnityFrame) -> list[Json]:
    """Return the object records of a house. Objects that stand on another object are children of its record, at any
    depth.
    """
    records: dict[str, Json] = {}
    tops = []
    for count, piece in enumerate(layout.furniture):
        room = number[piece.room_id]
        place = f"surface|{room}" if piece.parent else f"{room}"
        record: Json = {
            "id": f"{native_labels()[piece.label].ai2thor}|{place}|{count}",
            "assetId": _asset(piece.kind, piece.variant),
            "position": frame.center(piece),
            "rotation": frame.rotation(piece),
            "kinematic": piece.parent is None,
            "layer": "Procedural0",
        }
        records[piece.object_id] = record
        if piece.parent is None:
            tops.append(record)
        else:
            records[piece.parent].setdefault("children", []).append(record)
    return tops


def _agent(layout: Layout, frame: UnityFrame) -> Json:
    """Return a start pose in the widest part of the floor."""
    floor = free_floor(layout)
    spot = shapely.maximum_inscribed_circle(floor, tolerance=0.05).coords[0]
    x, z = (round(c, 2) for c in frame.ground(*spot))
    return {
        "position": {"x": x, "y": AGENT_HEIGHT, "z": z},
        "rotation": {"x": 0, "y": 90, "z": 0},
        "horizon": 30,
        "standing": True,
    }


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
    return {
        "assetId": name,
        "boundingBox": dict(zip("xyz", (v / 1000 for v in size), strict=True)),
        "objectType": kind,
        "primaryProperty": movable,
        "secondaryProperties": ["Receptacle"] if movable == "Moveable" else [],
        "split": "train",
        "scenes": [],
        "states": {},
    }


def primary_property(kind: Kind) -> str:
    """Return AI2-THOR's "primary property" for objects of this kind: what an agent can do with them."""
    if kind.turns:
        return "Moveable"
    if kind.front or kind.hang is not None:
        return "Static"
    return "CanPickup" if max(kind.sizes[0]) < 500 else "Moveable"
