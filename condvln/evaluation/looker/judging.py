"""Decide whether a relation holds between objects, judged by what was seen of them. The decision is a score that is
positive if the relation holds.

The limits are between those at which text uses a relation as true and as false (`Thresholds`), since an object is never
seen completely: distances can only shrink as more is seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely import MultiPoint

from condvln.evaluation.looker.memory import GRAIN, Thing
from condvln.relations.bearing import BEARING_DEGREES
from condvln.relations.compass import COMPASS
from schemas.config import SECTOR_HALF_WIDTH, Thresholds
from schemas.program import Predicate

__all__ = ["Compared", "gap", "holds", "ranked"]

F64 = NDArray[np.float64]

Compared: Final = ("closest to", "bigger", "smaller")
"""Relations that compare an object with others of its label."""

TOUCH: Final = 0.1
"""Distance in metres below which surfaces seen from one side count as touching."""


def gap(one: Thing, other: Thing) -> float:
    """Return the least distance in metres between the seen points of two objects."""
    return float(cKDTree(other.points).query(one.points)[0].min())


def holds(predicate: Predicate, thing: Thing, anchors: Sequence[Thing], north: float | None, t: Thresholds) -> float:
    """Return a score that is positive if `predicate` holds between an object and its anchors. `predicate` must not be a
    relation of `Compared`.

    north : agent's heading at the start in degrees clockwise from north; None if the text does not state it
    """
    if predicate in BEARING_DEGREES:
        return 45.0 - abs(_turn(_bearing(thing.middle[[0, 2]]) - BEARING_DEGREES[predicate]))
    anchor = anchors[0]
    if predicate == "near":
        return (t.near_true + t.near_false) / 2 - gap(thing, anchor)
    if predicate == "far from":
        return gap(thing, anchor) - t.far
    if predicate in COMPASS:
        away = _centre(thing, north) - _centre(anchor, north)
        wanted = 90.0 - 45.0 * COMPASS.index(predicate)
        return SECTOR_HALF_WIDTH - abs(_turn(_bearing(away) + (north or 0.0) - wanted))
    if predicate == "between":
        return _between(thing, anchors[0], anchors[1])
    if predicate == "in":
        return _inside(thing, anchor)
    if predicate == "on":
        return _on(thing, anchor)
    if predicate == "under":
        return _covered(thing, anchor) - 0.4 if thing.box[1, 1] <= anchor.box[1, 1] + TOUCH else -1.0
    rise = float(thing.middle[1] - anchor.middle[1])
    if predicate in ("higher than", "lower than"):
        return (rise if predicate == "higher than" else -rise) - t.height
    if predicate == "below":
        thing, anchor, rise = anchor, thing, -rise
    apart = float(np.hypot(*(thing.middle - anchor.middle)[[0, 2]]))
    return min(rise - t.height, t.over_horizontal + 0.25 - apart, _covered(thing, anchor) - 0.05, -_on(thing, anchor))


def ranked(predicate: Predicate, things: Sequence[Thing], anchors: Sequence[Thing]) -> list[Thing]:
    """Sort objects of one label by a relation of `Compared`, such as "bigger". The relation holds for the first object
    of the result.
    """
    if predicate == "closest to":
        return sorted(things, key=lambda thing: gap(thing, anchors[0]))
    sign = -1.0 if predicate == "bigger" else 1.0
    return sorted(things, key=lambda thing: sign * float(np.prod(np.ptp(thing.box, axis=0))))


def _centre(thing: Thing, north: float | None) -> F64:
    """Return the centre (2,) on the ground of the object's bounding box, which is aligned with the compass if north is
    known.
    """
    angle = math.radians(north or 0.0)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    flat = thing.points[:, [0, 2]] @ turn.T
    return np.asarray((flat.min(axis=0) + flat.max(axis=0)) / 2 @ turn, np.float64)


def _bearing(away: F64) -> float:
    """Return the direction of the vector `away` (x, z) in degrees clockwise from the agent's heading at the start."""
    return math.degrees(math.atan2(away[0], -away[1]))


def _turn(degrees: float) -> float:
    return (degrees + 180.0) % 360.0 - 180.0


def _between(thing: Thing, one: Thing, other: Thing) -> float:
    a, b, p = (x.middle[[0, 2]] for x in (one, other, thing))
    along = b - a
    length = float(np.hypot(*along))
    if length < TOUCH:
        return -1.0
    share = float((p - a) @ along) / length**2
    aside = abs(float(along[0] * (p - a)[1] - along[1] * (p - a)[0])) / length
    return min(0.3 - abs(share - 0.5), 0.6 - aside, 4.0 - length + TOUCH)


def _covered(thing: Thing, anchor: Thing) -> float:
    """Return the share of `thing`'s footprint that overlaps the footprint of `anchor`. Footprints are the convex hulls
    of the seen points.
    """
    own = MultiPoint(thing.points[:, [0, 2]]).convex_hull.buffer(GRAIN / 2)
    return float(own.intersection(MultiPoint(anchor.points[:, [0, 2]]).convex_hull.buffer(GRAIN)).area / own.area)


def _inside(thing: Thing, anchor: Thing) -> float:
    low, high = anchor.box + np.array([[-TOUCH / 2], [TOUCH / 2]])
    points = thing.points
    return float(((points >= low) & (points <= high)).all(axis=1).mean()) - 0.6


def _on(thing: Thing, anchor: Thing) -> float:
    """Return the score of "on". It is positive if `thing` lies over the anchor's footprint, and the bottom of `thing`
    is at the anchor's top or lower. It may be lower than the top, since headboards and arm rests are higher than what a
    bed or sofa carries.

    Text never denies a true "on".
    """
    if thing.middle[1] <= anchor.box[0, 1] + TOUCH:
        return -1.0
    return min(_covered(thing, anchor) - 0.25, float(anchor.box[1, 1] - thing.box[0, 1]) + TOUCH)
