"""Merge objects that an annotation cut into pieces at the border of two regions.

Matterport's annotators labelled the scan region by region, so a refrigerator on a border is one object in each region
that it extends into. Two objects are slices of one if all of the following hold:

* they have the same category, and stand in different regions of one level;
* their boxes touch or overlap: no more than ``GAP`` apart;
* seen along the way from one to the other, the smaller is covered by the other to at least ``COVER``: a cut leaves the
  same cross-section on both sides, while separate objects side by side rarely do;
* both reach the border: each box comes within ``GAP`` of the other's region.

Chains of slices are merged too. The merged object is in the region that contains most of its volume.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.scene import OrientedBox, Room, SceneObject, SceneWarning, round_mm
from condvln.scene.boxes import box_corners, rounded_box

__all__ = ["COVER", "GAP", "joined_slices"]

F64 = NDArray[np.float64]

GAP: Final = 0.05
"""Largest distance in metres between the boxes of two slices, and from a slice to the other one's region."""

COVER: Final = 0.6
"""Least share of the smaller cross-section that the other one covers."""


def joined_slices(
    objects: Sequence[SceneObject], rooms: Mapping[str, Room], kept_apart: frozenset[str] = frozenset()
) -> tuple[list[SceneObject], list[SceneWarning]]:
    """Merge the slices of each cut object into one object. Return all objects in the given order, and a warning for
    each merged object.

    Parameters
    ----------
    objects : with their rooms and boxes; objects without a box are unchanged
    kept_apart : labels that are never merged, because they continue across regions or name no single object: walls,
        "unknown"
    """
    of_label: defaultdict[str, list[int]] = defaultdict(list)
    for k, item in enumerate(objects):
        if item.aabb is not None and item.label not in kept_apart and rooms[item.room_id].polygon is not None:
            of_label[item.raw_label].append(k)
    floors = {name: shapely.Polygon(room.polygon) for name, room in rooms.items() if room.polygon is not None}
    whole = list(range(len(objects)))
    for members in of_label.values():
        boxes = np.array([objects[k].aabb for k in members])
        for at, i in enumerate(members):
            for j in np.flatnonzero(_fit(boxes[at], boxes[at + 1 :])) + at + 1:
                one, other = objects[i], objects[members[j]]
                same_level = rooms[one.room_id].level == rooms[other.room_id].level
                if one.room_id != other.room_id and same_level and _at_the_border(one, other, floors):
                    _unite(whole, i, members[j])
    parts: defaultdict[int, list[int]] = defaultdict(list)
    for k in range(len(objects)):
        parts[_root(whole, k)].append(k)
    found: list[SceneObject] = []
    said: list[SceneWarning] = []
    for members in parts.values():
        if len(members) == 1:
            found.append(objects[members[0]])
            continue
        item = _joined([objects[k] for k in members])
        found.append(item)
        others = ", ".join(sorted(objects[k].object_id for k in members if objects[k].object_id != item.object_id))
        said.append(SceneWarning("object_cut", item.object_id, f"put together with its slices {others}"))
    return found, said


def _fit(box: F64, others: F64) -> NDArray[np.bool_]:
    """Return a mask (n,): whether each of `others` (n, 2, 3) fits `box` (2, 3). Two boxes fit if they touch, and one of
    the two touching faces nearly covers the other.
    """
    shared = np.minimum(box[1], others[:, 1]) - np.maximum(box[0], others[:, 0])  # below zero where they are apart
    # They are side by side on the ground, along the horizontal axis on which they overlap least.
    along_x = shared[:, 0] <= shared[:, 2]
    smaller = np.minimum(np.maximum(box[1] - box[0], 1e-3), np.maximum(others[:, 1] - others[:, 0], 1e-3))
    covered = np.maximum(shared, 0.0) / smaller
    across = np.where(along_x, covered[:, 2], covered[:, 0])
    return np.asarray((shared.min(axis=1) >= -GAP) & (np.minimum(covered[:, 1], across) >= COVER))


def _at_the_border(one: SceneObject, other: SceneObject, floors: Mapping[str, shapely.Polygon]) -> bool:
    """Return whether each of two objects is within `GAP` of the region that the other object is in."""
    return all(_shadow(item).distance(floors[region.room_id]) <= GAP for item, region in ((one, other), (other, one)))


def _shadow(item: SceneObject) -> shapely.Polygon:
    assert item.aabb is not None
    (x0, _, z0), (x1, _, z1) = item.aabb
    return shapely.box(x0, z0, x1, z1)


def _joined(slices: Sequence[SceneObject]) -> SceneObject:
    """Merge several objects into one with the id and axes of the largest, in the region with most of its volume."""
    volume: defaultdict[str, float] = defaultdict(float)
    for item in slices:
        volume[item.room_id] += _volume(item)
    room_id = min(volume, key=lambda name: (-volume[name], name))
    largest = min(slices, key=lambda item: (-_volume(item), item.object_id))
    aabbs = np.array([item.aabb for item in slices])
    aabb = round_mm(np.array([aabbs[:, 0].min(axis=0), aabbs[:, 1].max(axis=0)]))
    box = None
    if largest.obb is not None:
        axes = largest.obb.rotation
        corners = np.concatenate([_corners(item) for item in slices]) @ axes
        low, high = corners.min(axis=0), corners.max(axis=0)
        box = rounded_box(OrientedBox(axes @ ((low + high) / 2), (high - low) / 2, axes))
    half = (aabb[1] - aabb[0]) / 2 if box is None else box.half_extents
    return replace(
        largest,
        room_id=room_id,
        center=round_mm(aabb.mean(axis=0) if box is None else box.center),
        aabb=aabb,
        obb=box,
        size=round_mm(aabb[1] - aabb[0]),
        radius=float(np.ceil(np.linalg.norm(half) * 1000) / 1000),
    )


def _corners(item: SceneObject) -> F64:
    assert item.aabb is not None
    if item.obb is not None:
        return box_corners(item.obb)
    return box_corners(OrientedBox(item.aabb.mean(axis=0), (item.aabb[1] - item.aabb[0]) / 2, np.eye(3)))


def _volume(item: SceneObject) -> float:
    assert item.aabb is not None
    if item.obb is not None:
        return float(np.prod(item.obb.half_extents)) * 8.0
    return float(np.prod(item.aabb[1] - item.aabb[0]))


def _root(whole: list[int], k: int) -> int:
    while whole[k] != k:
        k = whole[k]
    return k


def _unite(whole: list[int], i: int, j: int) -> None:
    """Merge the sets that contain the indices `i` and `j` (union-find). The least index is the root, so that the order
    of merges does not matter.
    """
    low, high = sorted((_root(whole, i), _root(whole, j)))
    whole[high] = low
