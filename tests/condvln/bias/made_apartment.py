"""Made apartments of one room, in which things of one size stand on the floor."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from condvln.scene import Room, Scene, SceneObject, round_mm

__all__ = ["made_apartment"]


def made_apartment(scene_id: str, things: Iterable[tuple[str, float, float]]) -> Scene:
    """An apartment with the things (label, x, z) at these places."""
    objects = []
    for label, x, z in things:
        box = round_mm(np.array([[x - 0.3, 0.0, z - 0.3], [x + 0.3, 0.8, z + 0.3]]))
        objects.append(SceneObject(label, "r0", label, label, round_mm(box.mean(axis=0)), aabb=box))
    return Scene(
        family="made",
        scene_id=scene_id,
        root=Path("."),
        rooms=(Room("r0", "apartment", "apartment", 0, 0.0, 2.5, None, "scene", True),),
        objects=tuple(objects),
    )
