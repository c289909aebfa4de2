"""A scene as the page draws it: from above, with rooms, footprints of furniture and the navmesh, and its relation graph
as columns. The page draws the part of the graph around a chosen object.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.episodes.footprint import Footprint
from condvln.labels import vocabulary
from condvln.navigation.tile import NavMeshTile
from condvln.scene import Room, Scene, SceneObject
from schemas.base import Json

__all__ = ["floor_document", "graph_document", "plan_document"]

F64 = NDArray[np.float64]
_DECIMALS: Final = 3


def plan_document(
    scene: Scene, tile: NavMeshTile | None = None, seen: Mapping[str, Mapping[str, Any]] | None = None
) -> Json:
    """Return a scene's plan. Coordinates are metres in Habitat's frame, rounded to 1 mm.

    Parameters
    ----------
    tile : the navmesh; None where it is not there
    seen : rows of the table ``visibility`` by object id
    """
    numbers = {room.room_id: number for number, room in enumerate(scene.rooms)}
    return {
        "rooms": [_room(room) for room in scene.rooms],
        "objects": [_object(item, numbers, (seen or {}).get(item.object_id, {})) for item in scene.objects],
        "floor": floor_document(tile),
    }


def floor_document(tile: NavMeshTile | None) -> list[list[float]]:
    """Return the polygons of a navmesh, each as ``[y, x, z, x, z, …]`` with y the mean height; rounded to 1 cm."""
    if tile is None:
        return []
    found = []
    for poly in tile.polys:
        count = int(poly["vert_count"])
        if count < 3:  # an off-mesh connection
            continue
        corners = np.asarray(tile.verts[poly["verts"][:count]], dtype=np.float64)
        outline = corners[:, [0, 2]].ravel()
        found.append([round(float(value), 2) for value in (corners[:, 1].mean(), *outline)])
    return found


def _room(room: Room) -> Json:
    return {
        "id": room.room_id,
        "label": room.label,
        "level": room.level,
        "floor": _number(room.floor_y),
        "polygon": None if room.polygon is None else [_row(corner) for corner in room.polygon],
    }


def _object(item: SceneObject, rooms: Mapping[str, int], seen: Mapping[str, Any]) -> Json:
    footprint = Footprint.of(item)
    rectangles = [] if footprint is None else [_corners(part) for part in footprint.parts or (footprint,)]
    box = item.box
    return {
        "id": item.object_id,
        "label": item.label,
        "raw": item.raw_label,
        "room": rooms.get(item.room_id, -1),
        "center": _row(item.center),
        "shape": rectangles,
        "low": None if box is None else _number(box[0][1]),
        "high": None if box is None else _number(box[1][1]),
        "geometry": item.geometry,
        "parent": item.parent,
        "support": item.support,
        "hidden": item.hidden,
        "structure": vocabulary.is_structure(item.label),
        **{name: seen.get(name) for name in _SEEN},
    }


def _corners(box: Footprint) -> list[float]:
    corners = box.center + (np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * box.half) @ box.axes
    return _row(corners.ravel())


def _row(values: Sequence[float] | F64) -> list[float]:
    return [round(float(value), _DECIMALS) for value in values]


def _number(value: float) -> float | None:
    return round(float(value), _DECIMALS) if np.isfinite(value) else None


_SEEN: Final = ("seeable", "share", "places", "from_places", "nearest_view")
_METRICS: Final = ("used_distance", "surface_distance", "horizontal_distance")
_SEMANTIC: Final = "semantic"


def graph_document(relations: Iterable[Mapping[str, Any]], objects: Iterable[str]) -> dict[str, Any]:
    """Return the edges between objects of a scene.

    Parameters
    ----------
    relations : rows of the table ``relations`` of the scene, points as lists
    objects : ids in the order of the plan; edges refer to them by number

    Returns
    -------
    ``predicates`` and, one entry per edge, ``subject``, ``target``, ``predicate`` (numbers), ``semantic``, ``in_text``,
    ``margin``, ``height`` (how much higher the subject's centre is, metres) and the metrics of the table by name.
    """
    numbers = {name: number for number, name in enumerate(objects)}
    predicates: dict[str, int] = {}
    names = ("subject", "target", "predicate", "semantic", "in_text", "margin", "height", *_METRICS)
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for row in relations:
        subject, target = numbers.get(row["subject"]), numbers.get(row["target"])
        if row["kind"] == "containment" or subject is None or target is None:
            continue
        columns["subject"].append(subject)
        columns["target"].append(target)
        columns["predicate"].append(predicates.setdefault(row["predicate"], len(predicates)))
        columns["semantic"].append(int(row["kind"] == _SEMANTIC))
        columns["in_text"].append(int(row["true_in_text"]))
        columns["margin"].append(_short(row["margin"], 2))
        columns["height"].append(None if row["delta"] is None else _short(-row["delta"][1], 3))
        for name in _METRICS:
            columns[name].append(_short(row[name], 3))
    return {"predicates": [*predicates], **columns}


def _short(value: float | None, decimals: int) -> float | None:
    return None if value is None else round(value, decimals)
