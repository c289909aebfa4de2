"""Compare a scene's size with the configured limits before memory is allocated for it."""

from __future__ import annotations

from collections import Counter

from condvln.scene.scene import Scene
from schemas.config import LimitsConfig
from schemas.errors import LimitError

__all__ = ["check_limits"]


def check_limits(scene: Scene, limits: LimitsConfig) -> None:
    """Compare a scene's counts with the limits.

    Raises
    ------
    LimitError : a count exceeds its limit; the message names the room, both numbers and the key to change
    """
    _at_most(limits, "objects_per_scene", len(scene.objects), "objects", scene)
    _at_most(limits, "rooms_per_scene", len(scene.rooms), "rooms", scene)
    for room in scene.rooms:
        if room.polygon is not None:
            _at_most(limits, "corners_per_room", len(room.polygon), "corners of its outline", scene, room.room_id)
    counts = Counter(item.room_id for item in scene.objects)
    for room_id, count in sorted(counts.items(), key=lambda entry: (-entry[1], entry[0])):
        _at_most(limits, "objects_per_room", count, "objects", scene, room_id)
    pairs = sum(count * count for count in counts.values())
    _at_most(limits, "pairs_per_scene", pairs, "pairs of objects that share a room", scene)


def _at_most(limits: LimitsConfig, key: str, count: int, what: str, scene: Scene, room_id: str = "") -> None:
    limit: int = getattr(limits, key)
    if count <= limit:
        return
    raise LimitError(
        f"{count} {what}, and limits.{key} is {limit}",
        where=f"{scene.family}/{scene.scene_id}",
        place=f"room {room_id!r}" if room_id else "",
        remedy=f"Raise limits.{key} if this machine has the memory, or exclude the scene",
    )
