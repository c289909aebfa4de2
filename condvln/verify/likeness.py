"""Doubts that boxes alone can't settle: two boxes may be one object, an unlabelled object may have a certain label, a
table may pass for a counter, an object may have fallen over.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from condvln.verify.containment import FROM_SCANS
from condvln.verify.surroundings import Thing, shared_sides
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

__all__ = ["has_fallen", "looks_like", "may_be_one", "passes_for_a_counter"]


def may_be_one(one: Thing, other: Thing, family: str) -> bool:
    """Return whether the boxes of two objects in a scan may belong to one object. The caller passes objects whose
    labels share a word.
    """
    if family not in FROM_SCANS:
        return False
    if math.dist(one.centre, other.centre) <= 1000.0 * DOUBLE_CENTRES:
        return True
    if one.box is None or other.box is None:
        return False
    smaller = min(math.prod(one.ground_sides()), math.prod(other.ground_sides()))
    x, _, z = shared_sides(one, other)
    air = max(one.box[0][1] - other.box[1][1], other.box[0][1] - one.box[1][1])
    return smaller > 0 and x * z >= DOUBLE_FOOTPRINT * smaller and air <= 1000.0 * DOUBLE_GAP


def looks_like(nameless: Thing, named: Thing) -> bool:
    """Return whether an unlabelled object has about the same side lengths as a labelled one, and its bottom at about
    the same height.
    """
    if nameless.box is None or named.box is None:
        return False
    for one, other in zip(_sides(nameless), _sides(named), strict=True):
        if max(one, other) > LIKE_SIZE * min(one, other):
            return False
    return abs(nameless.box[0][1] - named.box[0][1]) <= 1000.0 * LIKE_HEIGHT


def passes_for_a_counter(table: Thing, worktops: Iterable[str], things: Sequence[Thing], floor: float) -> bool:
    """Return whether a long table is as high as a counter and, if the room has counters, as large as one of them."""
    if table.label not in worktops or table.box is None or math.isnan(floor):
        return False
    if table.box[1][1] - round(floor * 1000.0) < 1000.0 * COUNTER_HEIGHT:
        return False
    if max(table.ground_sides()) < 1000.0 * COUNTER_LENGTH:
        return False
    counters = [thing for thing in things if thing.label == "counter"]
    areas = [math.prod(thing.ground_sides()) for thing in counters if thing.box is not None]
    if not areas:
        return not counters
    return math.prod(table.ground_sides()) >= min(areas)


def has_fallen(thing: Thing, floor: float) -> bool:
    """Return whether an object has fallen: it lies on the floor although its model stands upright, or it extends far
    below the floor.
    """
    if len(thing.item.mesh) != 1 or thing.box is None or math.isnan(floor):
        return False
    lift = round((thing.box[0][1] / 1000.0 - floor) * 1000.0)
    if lift < -1000.0 * FALLEN_SUNK:
        return True
    up = thing.item.mesh[0].transform[:3, :3] @ np.array([0.0, 1.0, 0.0])
    tilt = math.degrees(math.atan2(math.hypot(float(up[0]), float(up[2])), float(up[1])))
    return tilt > FALLEN_DEGREES and lift <= 1000.0 * FALLEN_OFF_FLOOR


def _sides(thing: Thing) -> tuple[int, int, int]:
    """Return the shorter and the longer side of the footprint, and the height, in millimetres."""
    assert thing.box is not None
    short, long = sorted(thing.ground_sides())
    return short, long, thing.box[1][1] - thing.box[0][1]
