"""Objects that, judged by their boxes, people can't tell apart or would not name by their label.

Two boxes of a scan may be the same object, and one box may hold two; an unlabelled object may have the label of a
labelled one of its size; a high table may be called a counter, a short one a side table; and nobody looks for a fallen
object, or for a compartment of other furniture, under its label.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.labels import vocabulary
from condvln.labels.lists import Role, also_called, have_role, labels_with_role, plausible_sizes
from condvln.relations.metrics import millimetres
from condvln.scene import Room, RoomArrays, Scene, SceneObject
from schemas.config.constants import (
    BORDER_SHARE,
    COUNTER_HEIGHT,
    COUNTER_LENGTH,
    DOUBLE_CENTRES,
    DOUBLE_FOOTPRINT,
    DOUBLE_GAP,
    FALLEN_DEGREES,
    FALLEN_OFF_FLOOR,
    FALLEN_SUNK,
    LIKE_HEIGHT,
    LIKE_SIZE,
    PART_INSIDE,
    SCREEN_TO_KEYBOARD,
    SEAT_LENGTH,
    SEAT_LONGEST,
    SEAT_RATIO,
    SIDE_TABLE_LENGTH,
    THIN_GAP,
    THIN_SHARE,
    TWIN_HEIGHT,
)

__all__ = [
    "NO_BORDER",
    "SCANS",
    "Border",
    "borders",
    "called_counters",
    "called_otherwise",
    "called_side_tables",
    "doubles",
    "fallen",
    "look_alikes",
    "mistakable",
    "parts",
    "share_inside",
    "twins",
]

Bools = NDArray[np.bool_]

SCANS: Final = ("gibson", "hm3d", "mp3d")
"""Families whose boxes were drawn into a scan, where one object may have two boxes."""


def doubles(arrays: RoomArrays, meant: Bools) -> Bools:
    """Return a mask (n,) of the objects that may be duplicates: one thing in the room that was annotated as two
    objects, each with its own box. Two objects count only if a word for one of them might mean the other.

    meant (n, n) : a word for i might mean j
    """
    low, high, centre = millimetres(arrays.aabb_min), millimetres(arrays.aabb_max), millimetres(arrays.centers)
    meets = [
        np.maximum(np.minimum(high[:, None, k], high[None, :, k]) - np.maximum(low[:, None, k], low[None, :, k]), 0.0)
        for k in (0, 2)
    ]
    area = (high[:, 0] - low[:, 0]) * (high[:, 2] - low[:, 2])
    smaller = np.minimum(area[:, None], area[None, :])
    gap = np.maximum(low[:, None, 1] - high[None, :, 1], low[None, :, 1] - high[:, None, 1])
    one = (smaller > 0.0) & (meets[0] * meets[1] >= DOUBLE_FOOTPRINT * smaller) & (gap <= 1000.0 * DOUBLE_GAP)
    between = centre[:, None] - centre[None, :]
    one |= (between * between).sum(axis=2) <= (1000.0 * DOUBLE_CENTRES) ** 2
    one |= _thin_beside(low, high, gap)
    one &= meant | meant.T
    np.fill_diagonal(one, False)
    return np.asarray(one.any(axis=1))


def _thin_beside(low: NDArray[np.float64], high: NDArray[np.float64], gap: NDArray[np.float64]) -> Bools:
    """Return a mask (n, n) of the pairs of boxes that are side by side, almost touching, with one much thinner than the
    other. A hole in a scan can split one object into two such boxes.

    low, high (n, 3) : millimetres; gap (n, n) : the vertical gap between the boxes
    """
    beyond = [np.maximum(low[:, None, k] - high[None, :, k], low[None, :, k] - high[:, None, k]) for k in (0, 2)]
    away = np.hypot(np.maximum(beyond[0], 0.0), np.maximum(beyond[1], 0.0))
    short = (high - low)[:, [0, 2]].min(axis=1)
    thinner = np.minimum(short[:, None], short[None, :])
    thin = (thinner > 0.0) & (thinner <= THIN_SHARE * np.maximum(short[:, None], short[None, :]))
    return np.asarray(thin & (away <= 1000.0 * THIN_GAP) & (gap < 0.0))


def look_alikes(arrays: RoomArrays, vague: Bools) -> tuple[frozenset[str], ...]:
    """Return, for each of n objects, the labels of the labelled objects of similar size and height. Only the unlabelled
    objects, marked in the mask `vague` (n,), get such labels; for all others the set is empty.
    """
    none: frozenset[str] = frozenset()
    if not vague.any():
        return (none,) * len(arrays)
    low, high = millimetres(arrays.aabb_min), millimetres(arrays.aabb_max)
    size = high - low
    sides = np.stack([size[:, [0, 2]].min(axis=1), size[:, [0, 2]].max(axis=1), size[:, 1]], axis=1)
    larger = np.maximum(sides[:, None], sides[None, :])
    alike = (larger <= LIKE_SIZE * np.minimum(sides[:, None], sides[None, :])).all(axis=2)
    alike &= np.abs(low[:, None, 1] - low[None, :, 1]) <= 1000.0 * LIKE_HEIGHT
    alike &= vague[:, None] & ~vague[None, :]
    return tuple(frozenset(arrays.labels[j] for j in np.flatnonzero(row)) for row in alike)


def called_counters(arrays: RoomArrays) -> Bools:
    """Return a mask (n,) of the objects that people may call a counter: long tables that are at least as high as a
    counter and, if the room has counters, at least as large as the smallest of them.
    """
    low, high = millimetres(arrays.aabb_min), millimetres(arrays.aabb_max)
    worktop = _with_role(arrays, "worktop")
    worktop &= high[:, 1] - millimetres(arrays.floor_y) >= 1000.0 * COUNTER_HEIGHT
    sides = high[:, [0, 2]] - low[:, [0, 2]]
    worktop &= sides.max(axis=1, initial=-np.inf) >= 1000.0 * COUNTER_LENGTH
    area = sides.prod(axis=1)
    counters = area[np.array([label == "counter" for label in arrays.labels], dtype=bool)]
    return np.asarray(worktop & (area >= np.fmin.reduce(counters, initial=np.inf if len(counters) else 0.0)))


def called_side_tables(arrays: RoomArrays) -> Bools:
    """Return a mask (n,) of the objects that people may call a side table: short tables of any kind."""
    sides = (millimetres(arrays.aabb_max) - millimetres(arrays.aabb_min))[:, [0, 2]]
    short = sides.max(axis=1, initial=-np.inf) <= 1000.0 * SIDE_TABLE_LENGTH
    return np.asarray(_with_role(arrays, "worktop") & short)


def called_otherwise(arrays: RoomArrays) -> tuple[frozenset[str], ...]:
    """Return, for each of n objects, the other labels by which some people would call it: a low vase is a bowl to them.
    They do not make the names of other objects ambiguous, but prevent the claim that no such thing is there.
    """
    sizes = millimetres(arrays.aabb_max) - millimetres(arrays.aabb_min)
    low = sizes[:, 1] <= sizes[:, [0, 2]].max(axis=1, initial=-np.inf)  # False where the extent is unknown
    return tuple(
        also_called(low=flat).get(label, frozenset()) for label, flat in zip(arrays.labels, low.tolist(), strict=True)
    )


def parts(arrays: RoomArrays) -> Bools:
    """Return a mask (n,) of the objects that are parts of other furniture, such as a compartment of a television stand.
    A shelf or a drawer counts as such a part if most of its box is inside the box of a larger object of another kind.
    """
    part = _with_role(arrays, "part")
    if not part.any():
        return np.asarray(part)
    own = np.flatnonzero(part)
    held = ~part & np.array([vocabulary.fit_for_text(label) for label in arrays.labels], dtype=bool)
    low, high = millimetres(arrays.aabb_min), millimetres(arrays.aabb_max)
    shared = np.maximum(np.minimum(high[own, None], high[None]) - np.maximum(low[own, None], low[None]), 0.0)
    volume = (high - low).prod(axis=1)
    inside = (shared.prod(axis=2) >= PART_INSIDE * volume[own, None]) & (volume[None, :] > volume[own, None])
    part[own] = (inside & held[None, :] & (volume[own, None] > 0.0)).any(axis=1)
    return np.asarray(part)


def mistakable(arrays: RoomArrays) -> Bools:
    """Return a mask (n,) of the objects that, in a scan, may be something else than their label says: a television that
    may be a monitor, a chair that may be two, a book as large as a table.
    """
    low, high = millimetres(arrays.aabb_min), millimetres(arrays.aabb_max)
    ground = (high - low)[:, [0, 2]]
    short, long = ground.min(axis=1, initial=np.inf), ground.max(axis=1, initial=-np.inf)
    pair = (long >= 1000.0 * SEAT_LENGTH) & (long >= SEAT_RATIO * short)
    pair = _with_role(arrays, "seat") & (pair | (long >= 1000.0 * SEAT_LONGEST))
    screen, desktop = _with_role(arrays, "screen"), np.flatnonzero(_with_role(arrays, "desktop"))
    sides = [(low[:, None, k] - high[None, desktop, k], low[None, desktop, k] - high[:, None, k]) for k in (0, 2)]
    beyond = [np.maximum(np.maximum(one, other), 0.0) for one, other in sides]
    away = np.hypot(beyond[0], beyond[1])
    before = (away <= 1000.0 * SCREEN_TO_KEYBOARD).any(axis=1)
    screen &= before | (high[:, 1] - low[:, 1] > long)
    return np.asarray(pair | screen | np.array([_is_odd_sized(item) for item in arrays.objects], dtype=bool))


def _is_odd_sized(item: SceneObject) -> bool:
    """Return whether the size or the shape of an object's box is not one that its label allows."""
    bounds = plausible_sizes().get(item.label)
    if bounds is None or (item.box is None and item.obb is None):
        return False
    sides = 2.0 * item.obb.half_extents if item.obb is not None else item.box[1] - item.box[0]  # type: ignore[index]
    least, most = (round(1000.0 * bound) for bound in (bounds.least, bounds.most))
    own = millimetres(sides)
    if not least <= float(own.max()) <= most or float(own.min()) > 1000.0 * bounds.thickness:
        return True
    if item.box is None:
        return False
    width, height, depth = (millimetres(item.box)[1] - millimetres(item.box)[0]).tolist()
    if not 1000.0 * bounds.low <= height <= 1000.0 * bounds.high:
        return True
    short, long = sorted((width, depth))
    return long > bounds.ratio * short or (bounds.upright and height < long)


def twins(arrays: RoomArrays, rival: Bools, unclear: Bools) -> Bools:
    """Return a mask (n,) of the objects whose size can't be compared with that of a rival in a scan: a rival with the
    same label is about as tall, so that the smaller box may show an object that was scanned only in part; or the box of
    a rival is `unclear` (n,), such as that of a chair of which only the back was scanned.
    """
    labels = np.array(arrays.labels, dtype=object)
    height = millimetres(arrays.aabb_max)[:, 1] - millimetres(arrays.aabb_min)[:, 1]
    larger, smaller = np.maximum(height[:, None], height[None, :]), np.minimum(height[:, None], height[None, :])
    alike = (labels[:, None] == labels[None, :]) & (larger <= TWIN_HEIGHT * smaller)
    return np.asarray((rival & (alike | unclear)).any(axis=1))


def fallen(arrays: RoomArrays) -> Bools:
    """Return a mask (n,) of the objects that extend far below the floor, or lie on the floor though their model stands
    upright.
    """
    return np.array([_has_fallen(item, arrays.floor_y) for item in arrays.objects], dtype=bool)


def _has_fallen(item: SceneObject, floor: float) -> bool:
    # The parts of an object with several parts do not show its orientation; without a mesh, the model is unknown.
    if len(item.mesh) != 1 or item.box is None or math.isnan(floor):
        return False
    lift = (float(item.box[0, 1]) - floor) * 1000.0
    if round(lift) < -1000.0 * FALLEN_SUNK:
        return True
    upwards: Sequence[float] = item.mesh[0].transform[:3, 1].tolist()
    tilted = upwards[1] < math.cos(math.radians(FALLEN_DEGREES)) * math.hypot(*upwards)
    return tilted and round(lift) <= 1000.0 * FALLEN_OFF_FLOOR


def _with_role(arrays: RoomArrays, role: Role) -> Bools:
    return have_role(arrays.labels, role)


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
