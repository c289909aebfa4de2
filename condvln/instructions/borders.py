"""Find the objects of a scan that are on the border between two rooms.

The rooms of a scan have no walls here, only outlines, which overlap where rooms are open to each other. A bowl on the
counter between kitchen and dining room is in neither for a person who reads "the dining room".
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.likeness import SCANS
from condvln.labels import vocabulary
from condvln.labels.roles import labels_with_role
from condvln.relations.metrics import millimetres
from condvln.scene import Room, Scene, SceneObject
from schemas.config.constants import BORDER_SHARE

__all__ = ["NO_BORDER", "Border", "borders", "share_inside"]

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Border:
    """What is on the borders of one room.

    own : ids of the room's objects that may belong to another room
    labels : labels of the objects of other rooms that may belong to this one
    """

    own: frozenset[str] = frozenset()
    labels: frozenset[str] = frozenset()


NO_BORDER: Final = Border()
"""A room whose borders are certain."""


def borders(scene: Scene) -> Mapping[str, Border]:
    """Return, by room id, which objects are on the borders of a room; rooms with no such objects are left out."""
    own: dict[str, set[str]] = {}
    labels: dict[str, set[str]] = {}
    for item, other in _astride(scene):
        own.setdefault(item.room_id, set()).add(item.object_id)
        labels.setdefault(other.room_id, set()).add(item.label)
    return {
        name: Border(frozenset(own.get(name, ())), frozenset(labels.get(name, ()))) for name in sorted({*own, *labels})
    }


def _astride(scene: Scene) -> Iterator[tuple[SceneObject, Room]]:
    """Yield each object with each other room that it may belong to. Built-in objects are left out, since it is plain to
    see which room they are in.
    """
    if scene.family not in SCANS:
        return
    fixed = labels_with_role("fixed")
    outlines = [(room, millimetres(room.polygon)) for room in scene.rooms if room.polygon is not None]
    for item in scene.objects:
        if item.box is None or item.label in fixed or not vocabulary.fit_for_text(item.label):
            continue
        low, high = millimetres(item.box)
        for room, ring in outlines:
            if room.room_id == item.room_id or low[1] >= 1000.0 * room.ceiling_y or high[1] <= 1000.0 * room.floor_y:
                continue
            if share_inside(low[[0, 2]], high[[0, 2]], ring) >= BORDER_SHARE - 1e-9:
                yield item, room


def share_inside(low: F64, high: F64, ring: F64) -> float:
    """Return the share of the rectangle from `low` (2,) to `high` (2,) that is inside the polygon `ring` (n, 2); 0 if
    the rectangle has no area.

    Method: the polygon is clipped at each side of the rectangle (Sutherland & Hodgman 1974). Edges of the result may
    coincide, but its area is right.
    """
    area = float((high - low).prod())
    if area <= 0.0 or (ring.max(axis=0) <= low).any() or (ring.min(axis=0) >= high).any():
        return 0.0
    points = [(float(x), float(z)) for x, z in ring]
    for axis, bound, sign in ((0, low[0], 1.0), (0, high[0], -1.0), (1, low[1], 1.0), (1, high[1], -1.0)):
        points = _clipped(points, axis, float(bound), sign)
    doubled = math.fsum(
        x0 * z1 - x1 * z0 for (x0, z0), (x1, z1) in zip(points, [*points[1:], *points[:1]], strict=True)
    )
    return abs(doubled) / 2.0 / area


def _clipped(points: list[tuple[float, float]], axis: int, bound: float, sign: float) -> list[tuple[float, float]]:
    """Return the part of a polygon where the coordinate along `axis` is at least `bound` (`sign` 1) or at most `bound`
    (`sign` −1).
    """
    found: list[tuple[float, float]] = []
    for one, other in zip(points, [*points[1:], *points[:1]], strict=True):
        inside = [sign * (point[axis] - bound) >= 0.0 for point in (one, other)]
        if inside[0]:
            found.append(one)
        if inside[0] != inside[1]:
            part = (bound - one[axis]) / (other[axis] - one[axis])
            cut = [one[k] + part * (other[k] - one[k]) for k in (0, 1)]
            cut[axis] = bound
            found.append((cut[0], cut[1]))
    return found
