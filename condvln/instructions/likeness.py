"""Objects that people can't tell apart, or would not name by their label, judging by boxes.

Two boxes of a scan may be the same object; an unlabelled object may have the label of a labelled one of its size; a
high table may be called a counter; and nobody looks for a fallen object under its label.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.labels.roles import labels_with_role
from condvln.relations.metrics import millimetres
from condvln.scene import RoomArrays, SceneObject
from schemas.config.constants import (
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
)

__all__ = ["SCANS", "called_counters", "doubles", "fallen", "look_alikes"]

Bools = NDArray[np.bool_]

SCANS: Final = ("gibson", "mp3d")
"""Families whose boxes were drawn into a scan, where one object may have two boxes."""


def doubles(arrays: RoomArrays, meant: Bools) -> Bools:
    """Return a mask (n,) of the objects that may be the same thing as another object, annotated twice with a box each.
    Two objects count only if a word for one of them might mean the other.

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
    one &= meant | meant.T
    np.fill_diagonal(one, False)
    return np.asarray(one.any(axis=1))


def look_alikes(arrays: RoomArrays, vague: Bools) -> tuple[frozenset[str], ...]:
    """Return, for each of n objects in the mask `vague` (n,) of unlabelled objects, the labels of the labelled objects
    of similar size and height. The result of all other objects is empty.
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
    """Return a mask (n,) of the objects that people may call a counter: long tables that are as high as a counter and
    as large as the smallest of the room's counters, if any.
    """
    low, high = millimetres(arrays.aabb_min), millimetres(arrays.aabb_max)
    worktop = np.isin(arrays.labels, sorted(labels_with_role("worktop")))
    worktop &= high[:, 1] - millimetres(arrays.floor_y) >= 1000.0 * COUNTER_HEIGHT
    sides = high[:, [0, 2]] - low[:, [0, 2]]
    worktop &= sides.max(axis=1, initial=-np.inf) >= 1000.0 * COUNTER_LENGTH
    area = sides.prod(axis=1)
    counters = area[np.array([label == "counter" for label in arrays.labels], dtype=bool)]
    return np.asarray(worktop & (area >= np.fmin.reduce(counters, initial=np.inf if len(counters) else 0.0)))


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
