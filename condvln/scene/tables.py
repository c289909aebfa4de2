"""Convert a scene to rows of the ``scenes``, ``rooms`` and ``objects`` tables, and back, without loss."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal

import numpy as np
import pyarrow as pa

from condvln.arrays import F64
from condvln.scene.boxes import aabb_of
from condvln.scene.rotations import stored_matrix, stored_quaternion
from condvln.scene.scene import MeshPart, NavmeshFile, OrientedBox, Room, Scene, SceneObject, SceneWarning
from schemas.base import Json as Row
from schemas.tables import OBJECTS, ROOMS, SCENES

__all__ = ["room_of", "scene_from_tables", "scene_tables"]


def scene_tables(
    scene: Scene, *, status: Literal["ok", "skipped"] = "ok", reason: str | None = None
) -> dict[str, pa.Table]:
    """Return the ``scenes`` (one row), ``rooms`` and ``objects`` tables of a scene, sorted by id.

    The family is not a column but the partition in which the tables are stored.
    """
    rooms = sorted(scene.rooms, key=lambda r: r.room_id)
    objects = sorted(scene.objects, key=lambda o: o.object_id)
    return {
        "scenes": pa.Table.from_pylist([_scene_row(scene, status, reason)], schema=SCENES),
        "rooms": pa.Table.from_pylist([_room_row(scene, room) for room in rooms], schema=ROOMS),
        "objects": pa.Table.from_pylist([_object_row(scene.scene_id, item) for item in objects], schema=OBJECTS),
    }


def scene_from_tables(tables: Mapping[str, pa.Table], root: Path, *, family: str) -> Scene:
    """Return the scene from which `scene_tables` made these tables; rooms and objects sorted by id.

    Parameters
    ----------
    root : folder that the paths of the scene are relative to
    family : partition that the tables were stored in
    """
    (row,) = tables["scenes"].to_pylist()
    return Scene(
        family=family,
        scene_id=row["scene_id"],
        root=root,
        rooms=tuple(room_of(r) for r in tables["rooms"].to_pylist()),
        objects=tuple(_object(r) for r in tables["objects"].to_pylist()),
        navmesh=_navmesh(row),
        stage=tuple(_part(p) for p in row["stage"]),
        warnings=tuple(SceneWarning(**w) for w in row["warnings"]),
    )


_NAVMESH: Final = {
    **{f"navmesh_{name}": name for name in ("path", "sha256", "built", "fits")},
    **{name: name for name in ("agent_radius", "agent_height", "agent_max_climb", "agent_max_slope")},
}
"""The columns of a scene's navmesh, and their fields."""
_OF_ROOM: Final = (
    *("room_id", "raw_label", "label", "level", "floor_y", "ceiling_y"),
    *("annotation", "complete", "asked"),
)
_OF_OBJECT: Final = (
    *("object_id", "room_id", "raw_label", "label", "radius", "static"),
    *("openness", "parent", "support", "hidden"),
)
"""Fields that are columns as they are."""


def _scene_row(scene: Scene, status: str, reason: str | None) -> Row:
    bounds = _bounds(scene)
    mesh = scene.navmesh
    return {
        "scene_id": scene.scene_id,
        "status": status,
        "reason": reason,
        "n_rooms": len(scene.rooms),
        "n_objects": len(scene.objects),
        "n_objects_without_extent": sum(o.aabb is None for o in scene.objects),
        **{column: None if mesh is None else getattr(mesh, name) for column, name in _NAVMESH.items()},
        "bounds_min": None if bounds is None else _point(bounds[0]),
        "bounds_max": None if bounds is None else _point(bounds[1]),
        "stage": [_part_row(p) for p in scene.stage],
        "warnings": [{"code": w.code, "where": w.where, "message": w.message} for w in scene.warnings],
    }


def _bounds(scene: Scene) -> F64 | None:
    """Return the (2, 3) box of all objects and room polygons; None if nothing has a position."""
    points = [o.center[None] if o.aabb is None else o.aabb for o in scene.objects]
    for room in scene.rooms:
        if room.polygon is not None:
            for height in (room.floor_y, room.ceiling_y):
                points.append(np.insert(room.polygon, 1, height, axis=1))
    return aabb_of(np.concatenate(points)) if points else None


def _navmesh(row: Row) -> NavmeshFile | None:
    if row["navmesh_path"] is None:
        return None
    return NavmeshFile(**{name: row[column] for column, name in _NAVMESH.items()})


def _room_row(scene: Scene, room: Room) -> Row:
    return {
        "scene_id": scene.scene_id,
        **{name: getattr(room, name) for name in _OF_ROOM},
        "polygon": None if room.polygon is None else [{"x": float(x), "z": float(z)} for x, z in room.polygon],
        "n_objects": sum(o.room_id == room.room_id for o in scene.objects),
    }


def room_of(row: Row) -> Room:
    """Return the room of a row of the table of rooms."""
    polygon = row["polygon"]
    corners = None if polygon is None else np.array([[c["x"], c["z"]] for c in polygon]).reshape(-1, 2)
    return Room(**{name: row[name] for name in _OF_ROOM}, polygon=corners)


def _object_row(scene_id: str, item: SceneObject) -> Row:
    return {
        "scene_id": scene_id,
        **{name: getattr(item, name) for name in _OF_OBJECT},
        "center": _point(item.center),
        "aabb_min": None if item.aabb is None else _point(item.aabb[0]),
        "aabb_max": None if item.aabb is None else _point(item.aabb[1]),
        "obb": None if item.obb is None else _box_row(item.obb),
        "size": None if item.size is None else _point(item.size),
        "geometry": item.geometry,
        "mesh": [_part_row(part) for part in item.mesh],
        "parts": [_box_row(box) for box in item.parts],
        "receptacles": item.receptacles,
    }


def _box_row(box: OrientedBox) -> Row:
    turned = dict(zip("xyzw", stored_quaternion(box.rotation), strict=True))
    return {"center": _point(box.center), "half_extents": _point(box.half_extents), "rotation": turned}


def _object(row: Row) -> SceneObject:
    low = row["aabb_min"]
    return SceneObject(
        **{name: row[name] for name in _OF_OBJECT},
        center=_vector(row["center"]),
        aabb=None if low is None else np.array([_vector(low), _vector(row["aabb_max"])]),
        obb=None if row["obb"] is None else _box(row["obb"]),
        mesh=tuple(_part(p) for p in row["mesh"]),
        parts=tuple(_box(box) for box in row["parts"]),
        receptacles=None if row["receptacles"] is None else tuple(row["receptacles"]),
    )


def _box(row: Row) -> OrientedBox:
    turned = row["rotation"]
    rotation = stored_matrix((turned["x"], turned["y"], turned["z"], turned["w"]))
    return OrientedBox(_vector(row["center"]), _vector(row["half_extents"]), rotation)


def _part_row(part: MeshPart) -> Row:
    return {"path": part.path, "transform": part.transform.ravel().tolist()}


def _part(row: Row) -> MeshPart:
    return MeshPart(row["path"], np.array(row["transform"], dtype=np.float64).reshape(4, 4))


def _point(values: F64) -> Row:
    return dict(zip("xyz", values.tolist(), strict=True))


def _vector(row: Row) -> F64:
    return np.array([row["x"], row["y"], row["z"]])
