"""Objects of a scan that lie within the outlines of two rooms, so that people may look for such an object in either
room.
"""

from __future__ import annotations

from collections.abc import Callable

import shapely

from condvln.scene import Scene, SceneObject
from condvln.verify.containment import FROM_SCANS
from condvln.verify.words import Words
from schemas.config.constants import BORDER_SHARE

__all__ = ["astride_rooms"]


def astride_rooms(
    scene: Scene, label_of: Callable[[SceneObject], str], meaning: Words
) -> list[tuple[SceneObject, frozenset[str]]]:
    """Return (object, ids of the other rooms) for each object whose footprint extends into the outlines of other rooms
    at the same height. Fixed objects, and objects that text never names, are left out.
    """
    if scene.family not in FROM_SCANS:
        return []
    outlines = [(room, shapely.Polygon(room.polygon).buffer(0.0)) for room in scene.rooms if room.polygon is not None]
    found = []
    for item in scene.objects:
        label = label_of(item)
        if item.box is None or label not in meaning.nouns or label in meaning.roles["fixed"]:
            continue
        (x0, bottom, z0), (x1, top, z1) = item.box.tolist()
        ground = shapely.box(x0, z0, x1, z1)
        others = {
            room.room_id
            for room, outline in outlines
            if room.room_id != item.room_id
            and not (bottom >= room.ceiling_y or top <= room.floor_y)
            and ground.area > 0.0
            and ground.intersection(outline).area / ground.area >= BORDER_SHARE - 1e-9
        }
        if others:
            found.append((item, frozenset(others)))
    return found
