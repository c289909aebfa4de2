"""Convert a scene to rows of the ``scenes``, ``rooms`` and ``objects`` tables, and back, without loss."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.scene.boxes import aabb_of
from condvln.scene.quaternions import stored_matrix, stored_quaternion
from condvln.scene.scene import MeshPart, NavmeshFile, OrientedBox, Room, Scene, SceneObject, SceneWarning
from schemas.tables import MESH_PART, OBJECTS, ORIENTED_BOX, QUATERNION, ROOMS, SCENES, VEC3

__all__ = ["scene_from_tables", "scene_tables"]

F64 = NDArray[np.float64]
Row = dict[str, Any]
T = TypeVar("T")

_UNKNOWN: Final = np.full(3, np.nan)


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
        "objects": _objects_table(scene.scene_id, objects),
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
        rooms=tuple(_room(r) for r in tables["rooms"].to_pylist()),
        objects=tuple(_object(r) for r in tables["objects"].to_pylist()),
        navmesh=_navmesh(row),
        stage=tuple(_part(p) for p in row["stage"]),
        warnings=tuple(SceneWarning(**w) for w in row["warnings"]),
    )


def _scene_row(scene: Scene, status: str, reason: str | None) -> Row:
    bounds = _bounds(scene)
    mesh = scene.navmesh
    return {
        "scene_id": scene.scene_id,
        "status": status,
        "reason": reason,
        "n_rooms": len(scene.rooms),
        "n_objects": len(scene.objects),
        "n_objects_without_extent": sum(o.aabb is None and o.size is None for o in scene.objects),
        "navmesh_path": None if mesh is None else mesh.path,
        "navmesh_sha256": None if mesh is None else mesh.sha256,
        "navmesh_built": None if mesh is None else mesh.built,
        "navmesh_fits": None if mesh is None else mesh.fits,
        "agent_radius": None if mesh is None else mesh.agent_radius,
        "agent_height": None if mesh is None else mesh.agent_height,
        "agent_max_climb": None if mesh is None else mesh.agent_max_climb,
        "agent_max_slope": None if mesh is None else mesh.agent_max_slope,
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
    return NavmeshFile(
        path=row["navmesh_path"],
        sha256=row["navmesh_sha256"],
        built=row["navmesh_built"],
        fits=row["navmesh_fits"],
        agent_radius=row["agent_radius"],
        agent_height=row["agent_height"],
        agent_max_climb=row["agent_max_climb"],
        agent_max_slope=row["agent_max_slope"],
    )


def _room_row(scene: Scene, room: Room) -> Row:
    return {
        "scene_id": scene.scene_id,
        "room_id": room.room_id,
        "raw_label": room.raw_label,
        "label": room.label,
        "level": room.level,
        "floor_y": room.floor_y,
        "ceiling_y": room.ceiling_y,
        "polygon": None if room.polygon is None else [{"x": float(x), "z": float(z)} for x, z in room.polygon],
        "annotation": room.annotation,
        "complete": room.complete,
        "asked": room.asked,
        "n_objects": sum(o.room_id == room.room_id for o in scene.objects),
    }


def _room(row: Row) -> Room:
    polygon = row["polygon"]
    return Room(
        room_id=row["room_id"],
        raw_label=row["raw_label"],
        label=row["label"],
        level=row["level"],
        floor_y=row["floor_y"],
        ceiling_y=row["ceiling_y"],
        polygon=None if polygon is None else np.array([[c["x"], c["z"]] for c in polygon]).reshape(-1, 2),
        annotation=row["annotation"],
        complete=row["complete"],
        asked=row["asked"],
    )


def _objects_table(scene_id: str, items: Sequence[SceneObject]) -> pa.Table:
    """Return the rows of a scene's objects, made by column: a row of Python objects takes three times as long."""
    columns: dict[str, Any] = {
        "scene_id": [scene_id] * len(items),
        "center": _points([item.center for item in items]),
        "aabb_min": _points([None if item.aabb is None else item.aabb[0] for item in items]),
        "aabb_max": _points([None if item.aabb is None else item.aabb[1] for item in items]),
        "obb": _boxes([item.obb for item in items]),
        "size": _points([item.size for item in items]),
        "mesh": _lists("mesh", [item.mesh for item in items], _mesh_parts),
        "parts": _lists("parts", [item.parts for item in items], _boxes),
    }
    arrays = []
    for field in OBJECTS:
        values = columns[field.name] if field.name in columns else [getattr(item, field.name) for item in items]
        arrays.append(values if isinstance(values, pa.Array) else pa.array(values, field.type))
    return pa.table(arrays, schema=OBJECTS)


def _points(points: Sequence[F64 | None]) -> pa.Array:
    """Return points (3,) as structs; None as null."""
    values = np.array([_UNKNOWN if point is None else point for point in points]).reshape(-1, 3)
    return _structs(VEC3, [pa.array(axis) for axis in values.T], points)


def _boxes(boxes: Sequence[OrientedBox | None]) -> pa.Array:
    """Return oriented boxes as structs; None as null."""
    turned = [(0.0, 0.0, 0.0, 1.0) if box is None else stored_quaternion(box.rotation) for box in boxes]
    columns = [
        _points([None if box is None else box.center for box in boxes]),
        _points([None if box is None else box.half_extents for box in boxes]),
        _structs(QUATERNION, [pa.array(axis) for axis in np.array(turned).reshape(-1, 4).T], boxes),
    ]
    return _structs(ORIENTED_BOX, columns, boxes)


def _mesh_parts(parts: Sequence[MeshPart]) -> pa.Array:
    values = np.concatenate([np.empty(0), *(part.transform.ravel() for part in parts)])
    ends = pa.array(np.arange(len(parts) + 1, dtype=np.int32) * 16)
    transforms = pa.ListArray.from_arrays(ends, pa.array(values), type=MESH_PART.field("transform").type)
    return _structs(MESH_PART, [pa.array([part.path for part in parts], pa.string()), transforms], parts)


def _structs(kind: pa.DataType, columns: Sequence[pa.Array], values: Sequence[object]) -> pa.Array:
    """Return structs with these columns; null where the value is None."""
    unknown = pa.array([value is None for value in values], pa.bool_())
    return pa.StructArray.from_arrays(columns, fields=list(kind), mask=unknown)


def _lists(name: str, rows: Sequence[Sequence[T]], made: Callable[[Sequence[T]], pa.Array]) -> pa.Array:
    """Return the lists of the column of objects called `name`, whose elements are `made` together."""
    ends = pa.array(accumulate(map(len, rows), initial=0), pa.int32())
    return pa.ListArray.from_arrays(ends, made([one for row in rows for one in row]), type=OBJECTS.field(name).type)


def _object(row: Row) -> SceneObject:
    low = row["aabb_min"]
    return SceneObject(
        object_id=row["object_id"],
        room_id=row["room_id"],
        raw_label=row["raw_label"],
        label=row["label"],
        center=_vector(row["center"]),
        aabb=None if low is None else np.array([_vector(low), _vector(row["aabb_max"])]),
        obb=None if row["obb"] is None else _box(row["obb"]),
        size=None if row["size"] is None else _vector(row["size"]),
        radius=row["radius"],
        mesh=tuple(_part(p) for p in row["mesh"]),
        static=row["static"],
        parts=tuple(_box(box) for box in row["parts"]),
        receptacles=None if row["receptacles"] is None else tuple(row["receptacles"]),
        openness=row["openness"],
        parent=row["parent"],
        support=row["support"],
        hidden=row["hidden"],
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
