"""Rooms as people furnish them, at random: furniture on the floor, things on, in, over and under it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from condvln.scene import OrientedBox, SceneObject, round_mm
from condvln.scene.boxes import aabb_of, box_corners
from condvln.scene.rotations import rotation_y

FURNITURE = ("table", "desk", "bed", "sofa", "chair", "dresser", "trash can", "basket", "sink", "bookshelf")
CORNERED = ("desk", "sofa", "table", "chair")
"""Those of them that may have a corner."""
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
            if base.parts and rng.random() < 0.7:
                low, high = aabb_of(box_corners(base.parts[rng.integers(2)]))
            size, half = high - low, rng.uniform(0.02, 0.25, 3)
            middle, way = (low + high) / 2, rng.integers(4)
            side = rng.uniform(-0.6, 0.6, 3) * size
            gap = rng.choice([0.0, 0.02, 0.03, 0.031, 0.09, 0.1, 0.15, 0.3, 0.6])
            heights = [high[1] + half[1] + gap, low[1] + half[1] + 0.01, low[1] - half[1] - gap, middle[1]]
            centre = [middle[0] + side[0], heights[way], middle[2] + side[2]]
            label = str(rng.choice(SMALL))
        objects.append(_object(name, label, centre, half, rng))
    return [_said(item, objects, rng) for item in objects]


def grouped_room(rng: np.random.Generator) -> list[SceneObject]:
    """The same with rugs and coffee tables, at which things form groups."""
    labels = {"bookshelf": "rug", "dresser": "coffee table"}
    room = [(item, labels.get(item.label, item.label)) for item in layered_room(rng)]
    return [replace(item, label=label, raw_label=label) for item, label in room]


def _said(item: SceneObject, objects: Sequence[SceneObject], rng: np.random.Generator) -> SceneObject:
    """The object with what its source might say of it, be it right or wrong."""
    if rng.random() < 0.7:
        return item
    others = [x.object_id for x in objects if x is not item] + ["elsewhere"]
    named = tuple(str(x) for x in rng.choice(others, int(rng.integers(3)), replace=False))
    openness = float(rng.choice([0.0, 0.49, 0.5, 1.0])) if rng.random() < 0.5 else None
    return replace(item, receptacles=named, openness=openness)


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
    box = round_mm([middle - half, middle + half])
    if label in CORNERED and (half[[0, 2]] > 0.3).all():
        # Arms along two sides, one of them turned by a right angle.
        along, across = half.copy(), half[[2, 1, 0]].copy()
        along[2] = across[2] = 0.125
        turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
        parts = (
            OrientedBox(round_mm(middle - np.array([0, 0, half[2] - 0.125])), along, np.eye(3)),
            OrientedBox(round_mm(middle + np.array([half[0] - 0.125, 0, 0])), across, turn),
        )
        return SceneObject(name, "room", label, label, middle, box, parts=parts)
    return SceneObject(name, "room", label, label, middle, aabb=box)
