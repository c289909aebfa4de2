"""Detect objects that an annotation has cut into pieces at the border of two regions; a text must not treat the pieces
as separate objects.

The source merges such pieces. Here it is checked that none was left, with stricter bounds, so that pieces that the
source kept apart near its own bounds are not reported.
"""

from __future__ import annotations

from typing import Final

import shapely

from condvln.scene import Room, Scene, SceneObject

__all__ = ["left_apart"]

TOUCHING: Final = 0.02
"""Largest distance in metres between the boxes of two pieces, and from a piece to the other's region."""
SAME_SECTION: Final = 0.8
"""Least share of the smaller cross-section that the other one covers."""
CUT_FAMILIES: Final = ("mp3d",)
"""Families that are annotated region by region."""


def left_apart(scene: Scene) -> frozenset[str]:
    """Return the ids of all objects that look like a piece of a larger object whose other pieces are in other regions
    of the same level.

    An object that the source has merged (warning ``object_cut``) is larger than its pieces, and is not compared again.
    """
    if scene.family not in CUT_FAMILIES:
        return frozenset()
    joined = {warning.where for warning in scene.warnings if warning.code == "object_cut"}
    things = [item for item in scene.objects if item.aabb is not None and item.object_id not in joined]
    found: set[str] = set()
    for k, one in enumerate(things):
        for other in things[k + 1 :]:
            if one.raw_label != other.raw_label or one.room_id == other.room_id:
                continue
            rooms = scene.room_of.get(one.room_id), scene.room_of.get(other.room_id)
            if rooms[0] is None or rooms[1] is None or rooms[0].level != rooms[1].level:
                continue
            if _continues(one, other) and _reaches(one, rooms[1]) and _reaches(other, rooms[0]):
                found |= {one.object_id, other.object_id}
    return frozenset(found)


def _continues(one: SceneObject, other: SceneObject) -> bool:
    """Return whether two boxes touch and one continues the other with the same cross-section."""
    assert one.aabb is not None
    assert other.aabb is not None
    shared = [float(min(one.aabb[1][k], other.aabb[1][k]) - max(one.aabb[0][k], other.aabb[0][k])) for k in range(3)]
    if min(shared) < -TOUCHING - 1e-9:
        return False
    across = 2 if shared[0] <= shared[2] else 0
    for k in (1, across):
        smaller = min(float(item.aabb[1][k] - item.aabb[0][k]) for item in (one, other))  # type: ignore[index]
        if max(shared[k], 0.0) < SAME_SECTION * max(smaller, 0.001):
            return False
    return True


def _reaches(item: SceneObject, region: Room) -> bool:
    assert item.aabb is not None
    if region.polygon is None:
        return False
    (x0, _, z0), (x1, _, z1) = item.aabb.tolist()
    return bool(shapely.box(x0, z0, x1, z1).distance(shapely.Polygon(region.polygon)) <= TOUCHING)
