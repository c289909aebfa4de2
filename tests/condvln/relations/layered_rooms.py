"""Rooms as people furnish them, at random: furniture on the floor, things on, in, over and under it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from condvln.scene import OrientedBox, SceneObject, round_mm
from condvln.scene.quaternions import rotation_y

FURNITURE = ("table", "desk", "bed", "sofa", "chair", "dresser", "trash can", "basket", "sink", "bookshelf")
SMALL = ("book", "lamp", "vase", "bowl", "clock", "picture", "chair", "plant")


def layered_room(rng: np.random.Generator, count: int = 14) -> list[SceneObject]:
    """Objects of one room whose floor is at 0, with gaps and overlaps near the thresholds."""
    objects: list[SceneObject] = []
    while len(objects) < count:
        name = f"o{len(objects):02d}"
        base = objects[int(rng.integers(len(objects)))] if objects else None
        if base is None or base.box is None or rng.random() < 0.5:
            half = rng.uniform(0.1, 0.8, 3)
            centre = [rng.uniform(-2.5, 2.5), half[1] + rng.choice([0.0, 0.0, 0.1, 0.4]), rng.uniform(-2.5, 2.5)]
            label = str(rng.choice(FURNITURE))
        else:
            low, high = base.box
            size, half = high - low, rng.uniform(0.02, 0.25, 3)
            middle, way = (low + high) / 2, rng.integers(4)
            side = rng.uniform(-0.6, 0.6, 3) * size
            gap = rng.choice([0.0, 0.02, 0.03, 0.031, 0.09, 0.1, 0.15, 0.3, 0.6])
            heights = [high[1] + half[1] + gap, low[1] + half[1] + 0.01, low[1] - half[1] - gap, middle[1]]
            centre = [middle[0] + side[0], heights[way], middle[2] + side[2]]
            label = str(rng.choice(SMALL))
        objects.append(_object(name, label, centre, half, rng))
    return objects


def _object(name: str, label: str, centre: Sequence[float], half: np.ndarray, rng: np.random.Generator) -> SceneObject:
    middle, half = round_mm(centre), round_mm(half)
    kind = rng.random()
    if kind < 0.04:
        return SceneObject(name, "room", label, label, middle)
    if kind < 0.08:
        return SceneObject(name, "room", label, label, middle, radius=float(half[0]))
    if kind < 0.4:
        turn = rotation_y(float(rng.uniform(0, np.pi)))
        reach = np.abs(turn) @ half
        box = round_mm([middle - reach, middle + reach])
        return SceneObject(name, "room", label, label, middle, box, OrientedBox(middle, half, turn))
    return SceneObject(name, "room", label, label, middle, aabb=round_mm([middle - half, middle + half]))
