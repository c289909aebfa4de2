"""Write layouts as AI2-THOR controller metadata: iTHOR's one-room floor plans, RoboTHOR's apartments without rooms.

There is one JSON file per scene: ``{"sceneName", "objects"}``. Every object has its axis-aligned box, and an oriented
box if an agent can pick it up or move it; ``position`` is the prefab's pivot, not the centre of its box; structure has
no asset. Angles and axes are Unity's (``condvln.samples.procthor``).
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
import orjson
import shapely

from condvln.arrays import F64
from condvln.samples.catalogue import catalogue, native_labels, record
from condvln.samples.floor_mesh import free_floor
from condvln.samples.layout import WALL_THICKNESS, Furniture, Layout, Room
from condvln.samples.procthor import UnityFrame, primary_property
from condvln.samples.solid import wall_boxes
from schemas.base import Json
from schemas.errors import UsageError

__all__ = ["ithor_files", "robothor_files"]

FLOOR_PLANS: Final = {"kitchen": 0, "living room": 200, "bedroom": 300, "bathroom": 400}
"""Offset of iTHOR's floor plan numbers by room type; it has thirty plans of each, and no other types."""

PLANS_OF_A_TYPE: Final = 30

ROBOTHOR_SCENES: Final = tuple(
    f"FloorPlan_{part}{number}_{variant}"
    for part, numbers in (("Train", range(1, 13)), ("Val", range(1, 4)))
    for number in numbers
    for variant in range(1, 6)
)
"""The scene names of RoboTHOR."""

FLOOR_SLAB: Final = 0.2
"""Thickness in metres of the floor's box; its upper side is at y = 0."""

REACHABLE_STEP: Final = 0.25
REACHABLE_RADIUS: Final = 0.2
"""Grid spacing of reachable positions, and the radius of AI2-THOR's agent, in metres."""


def ithor_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield (file name, content) of the files of one floor plan for each kitchen, living room, bedroom and bathroom.
    The floor plans of each room type are numbered in the order of the layouts.

    Files: ``FloorPlan<N>.json`` and ``FloorPlan<N>-reachable.npy``, (n, 2) of (x, z) on a 0.25 m grid. Doorways are
    open; what is behind them, and rooms of other types, are left out.

    Raises
    ------
    UsageError : more than thirty rooms of one type
    """
    made = dict.fromkeys(FLOOR_PLANS, 0)
    for layout in layouts.values():
        floor = free_floor(layout, REACHABLE_RADIUS)
        for room in layout.rooms:
            if room.label not in FLOOR_PLANS:
                continue
            made[room.label] += 1
            if made[room.label] > PLANS_OF_A_TYPE:
                raise UsageError(
                    f"iTHOR has {PLANS_OF_A_TYPE} rooms of a type, but the scenes have more {room.label}s",
                    place="scenes",
                    remedy="Ask for fewer scenes.",
                )
            name = f"FloorPlan{FLOOR_PLANS[room.label] + made[room.label]}"
            objects = [_floor(room.shape.bounds), *(_object(p, layout) for p in layout.in_room(room.room_id))]
            yield f"{name}.json", orjson.dumps({"sceneName": name, "objects": objects})
            yield f"{name}-reachable.npy", _npy(_reachable(shapely.intersection(floor, _inside(room))))


def robothor_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield (file name, content) of the files of each layout. Each layout becomes one scene without rooms and with
    panels as walls; the scenes get the names in ``ROBOTHOR_SCENES``.

    Raises
    ------
    UsageError : more layouts than RoboTHOR has scenes
    """
    if len(layouts) > len(ROBOTHOR_SCENES):
        raise UsageError(
            f"RoboTHOR has names for {len(ROBOTHOR_SCENES)} scenes, not {len(layouts)}",
            place="scenes",
            remedy="Ask for fewer scenes.",
        )
    for name, layout in zip(ROBOTHOR_SCENES, layouts.values(), strict=False):
        (x0, z0), (x1, z1) = layout.bounds
        walls = [_structure("Wall", box) for box in wall_boxes(layout)]
        objects = [_floor((x0, z0, x1, z1)), *walls, *(_object(piece, layout) for piece in layout.furniture)]
        yield f"{name}.json", orjson.dumps({"sceneName": name, "objects": objects})
        yield f"{name}-reachable.npy", _npy(_reachable(free_floor(layout, REACHABLE_RADIUS)))


def _inside(room: Room) -> shapely.Polygon:
    return room.shape.buffer(-WALL_THICKNESS / 2, join_style="mitre")


def _reachable(floor: shapely.Geometry) -> F64:
    """Return grid points in Unity's frame on the largest connected part of `floor`."""
    part = max(shapely.get_parts(floor), key=lambda p: p.area)
    x0, z0, x1, z1 = (v / REACHABLE_STEP for v in part.bounds)
    xs = np.arange(np.ceil(x0), np.floor(x1) + 1) * REACHABLE_STEP
    zs = np.arange(np.ceil(z0), np.floor(z1) + 1) * REACHABLE_STEP
    grid = np.stack(np.meshgrid(xs, zs, indexing="ij"), axis=-1).reshape(-1, 2)
    on = grid[shapely.covers(part, shapely.points(grid))]
    unity: F64 = on * np.array([1.0, -1.0]) + 0.0
    return unity


def _npy(array: F64) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _floor(bounds: tuple[float, float, float, float]) -> Json:
    x0, z0, x1, z1 = bounds
    return _structure("Floor", np.array([[x0, -FLOOR_SLAB, z0], [x1, 0.0, z1]]))


def _structure(kind: str, box: F64) -> Json:
    center = UnityFrame().point(*((box[0] + box[1]) / 2).tolist())
    return _record(kind, center, {"x": 0.0, "y": 0.0, "z": 0.0}, box) | {"assetId": ""}


def _object(piece: Furniture, layout: Layout) -> Json:
    movable = primary_property(catalogue()[piece.kind])
    name = native_labels()[piece.label].ai2thor
    parent = None if piece.parent is None else layout.furniture_of[piece.parent]
    carried = [_object_id(other) for other in layout.furniture if other.parent == piece.object_id]
    return _record(name, _pivot(piece), UnityFrame().rotation(piece), piece.aabb) | {
        "assetId": f"{name}_{piece.kind}_{piece.variant + 1}",
        "pickupable": movable == "CanPickup",
        "moveable": movable == "Moveable",
        "receptacle": bool(carried),
        "parentReceptacles": None if parent is None else [_object_id(parent)],
        "receptacleObjectIds": carried or None,
        "objectOrientedBoundingBox": {"cornerPoints": _oriented(piece)} if movable != "Static" else None,
    }


def _pivot(piece: Furniture) -> dict[str, float]:
    """Return the pivot of a piece, here the middle of its lower face. In real prefabs the pivot can be anywhere."""
    return UnityFrame().point(piece.center[0], float(piece.aabb[0, 1]), piece.center[2])


def _object_id(piece: Furniture) -> str:
    return _id(native_labels()[piece.label].ai2thor, _pivot(piece))


def _id(kind: str, place: Mapping[str, float]) -> str:
    return "|".join([kind, *(f"{place[axis]:+06.2f}" for axis in "xyz")])


def _record(kind: str, pivot: Mapping[str, float], rotation: Json, box: F64) -> Json:
    """Return an object's record with only the keys that all objects have; `box` is in the layout's frame."""
    frame = UnityFrame()
    low, high = box.tolist()
    corners = [[x, y, -z + 0.0] for x in (high[0], low[0]) for y in (high[1], low[1]) for z in (low[2], high[2])]
    size = dict(zip("xyz", np.round(box[1] - box[0], 6).tolist(), strict=True))
    found: Json = record(
        "thor object",
        name=_id(kind, pivot).replace("|", "_"),
        id=_id(kind, pivot),
        kind=kind,
        pivot=dict(pivot),
        rotation=rotation,
        corners=corners,
        center=frame.point(*((box[0] + box[1]) / 2).tolist()),
        size=size,
    )
    return found


def _oriented(piece: Furniture) -> list[list[float]]:
    """Return the eight corners of the rotated box, the lower four first."""
    half = np.array(piece.size) / 2
    signs = np.array([[x, y, z] for y in (-1, 1) for x, z in ((1, -1), (-1, -1), (-1, 1), (1, 1))])
    corners = (signs * half) @ piece.yaw.matrix.T + np.array(piece.center)
    unity: list[list[float]] = (np.round(corners, 6) * np.array([1.0, 1.0, -1.0]) + 0.0).tolist()
    return unity
