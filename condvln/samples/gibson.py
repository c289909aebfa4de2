"""Write layouts as Gibson buildings with 3D scene graphs, in both of their formats.

Even scenes are ``verified/<name>.scn``, the JSON written by habitat-sim's ``npz2scn.py``; odd scenes are the original
``verified/3DSceneGraph_<name>.npz``, whose one array is a pickled dictionary. Both formats are z-up with (x, −z, y) for
(x, y, z), and have only axis-aligned boxes: no room outlines, no angles. As in the originals, ``floor_area`` is a
perimeter and ``floor_number`` a letter. ``<name>.glb``, also z-up, and ``<name>.navmesh``, in Habitat's frame, are in
the same folder.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
import orjson

from condvln.arrays import F64
from condvln.navigation.navmesh_file import NavMeshFile
from condvln.navigation.settings import NavMeshSettings
from condvln.samples.catalogue import native_labels, record
from condvln.samples.floor_mesh import navmesh_of
from condvln.samples.layout import Furniture, Layout, Room
from condvln.samples.models import Z_UP
from condvln.samples.solid import layout_glb
from schemas.base import Json

__all__ = ["gibson_files", "version_1"]


CATEGORIES: Final = {"hallway": "corridor", "office": "home_office"}
"""Gibson's names of room types; other types use our names with underscores."""


def gibson_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes); scene graphs in both formats, in turn."""
    for number, (name, layout) in enumerate(layouts.items()):
        rooms, objects = _records(layout, building=number + 1)
        if number % 2 == 0:
            document = {"objects": objects, "rooms": rooms}
            yield f"verified/{name}.scn", orjson.dumps(document, option=orjson.OPT_INDENT_2)
        else:
            yield f"verified/3DSceneGraph_{name}.npz", _npz(name, number + 1, layout, rooms, objects)
        yield f"{name}.glb", layout_glb(layout, Z_UP)
        yield f"{name}.navmesh", version_1(navmesh_of(layout, NavMeshSettings())).to_bytes()


def version_1(navmesh: NavMeshFile) -> NavMeshFile:
    """Return the same navmesh in version 1 of the file format, which has no settings. The released scans have this
    version.
    """
    return dataclasses.replace(navmesh, version=1, settings=None)


def _records(layout: Layout, building: int) -> tuple[list[Json], list[Json]]:
    """Return the records of a building's rooms and of its objects, both with ids from 1."""
    rooms = [_room(room, layout.ceiling, i, building) for i, room in enumerate(layout.rooms, start=1)]
    number = {room.room_id: i for i, room in enumerate(layout.rooms, start=1)}
    return rooms, [_object(piece, i, number[piece.room_id]) for i, piece in enumerate(layout.furniture, start=1)]


def _z_up(vector: F64) -> list[float]:
    x, y, z = np.round(vector, 6).tolist()
    return [x, -z + 0.0, y]


def _size(extent: F64) -> list[float]:
    x, y, z = np.round(extent, 6).tolist()
    return [x, z, y]


def _room(room: Room, ceiling: float, number: int, building: int) -> Json:
    x0, z0, x1, z1 = room.shape.bounds
    low, high = np.array([x0, 0.0, z0]), np.array([x1, ceiling, z1])
    hull = room.shape.convex_hull
    return record(
        "gibson room",
        perimeter=hull.length,
        number=number,
        location=_z_up((low + high) / 2),
        category=CATEGORIES.get(room.label, room.label.replace(" ", "_")),
        size=_size(high - low),
        volume=hull.area * ceiling,
        building=building,
    )


def _object(piece: Furniture, number: int, room: int) -> Json:
    extent = np.array(piece.extent)
    hull = piece.footprint
    return record(
        "gibson object",
        perimeter=hull.length,
        area=hull.area,
        label=native_labels()[piece.label].gibson,
        number=number,
        location=_z_up(np.array(piece.center)),
        material=None if number % 3 == 0 else ["wood", None] if number % 3 == 1 else ["wood"],
        size=_size(extent),
        volume=hull.area * piece.size[1],
        room=room,
    )


def _npz(name: str, number: int, layout: Layout, rooms: list[Json], objects: list[Json]) -> bytes:
    """Return a building in the original format (``.npz``). Vectors are arrays, entries are keyed by id, and the
    building's own arrays are included.
    """
    (x0, z0), (x1, z1) = layout.bounds
    low, high = np.array([x0, 0.0, z0]), np.array([x1, layout.ceiling, z1])
    building = {
        "area": sum(room.area for room in layout.rooms),
        "floor_area": 2 * float(x1 - x0 + z1 - z0),
        "function": "residential",
        "gibson_split": "tiny",
        "id": number,
        "name": name,
        "num_cameras": 0,
        "num_floors": 1,
        "num_objects": len(objects),
        "num_rooms": len(rooms),
        "reference_point": np.zeros(3),
        "size": np.array(_size(high - low)),
        "volume": float(np.prod(high - low)),
        "voxel_size": 0.1,
        "voxel_centers": np.zeros((0, 3)),
        "voxel_resolution": np.zeros(3, dtype=np.int64),
        "object_inst_segmentation": np.zeros((0, 1)),
        "room_inst_segmentation": np.zeros((0, 1)),
        "object_voxel_occupancy": np.zeros((0, 1)),
        "room_voxel_occupancy": np.zeros((0, 1)),
    }
    output = {
        "building": building,
        "room": {room["id"]: _with_arrays(room) for room in rooms},
        "object": {item["id"]: _with_arrays(item) for item in objects},
        "camera": {},
        "panorama": {},
    }
    buffer = io.BytesIO()
    np.savez(buffer, output=np.array(output, dtype=object))
    return buffer.getvalue()


def _with_arrays(record: Json) -> Json:
    return {**record, "location": np.array(record["location"]), "size": np.array(record["size"])}
