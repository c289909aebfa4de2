"""Left, right, ahead and behind: where a thing lies for an agent that stands at a place and faces a heading.

A bearing is an angle in degrees clockwise from where the agent faces, so that right is 90. It goes by the centre of the
thing's box on the ground, and by how wide the box looks from there: what reaches from the left to the front is neither
surely on the left nor surely not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.config import Thresholds

__all__ = ["BEARING_DEGREES", "Sighting", "bearing_status", "sighted"]

F64 = NDArray[np.float64]

BEARING_DEGREES: Final[Mapping[str, float]] = {"ahead": 0.0, "right": 90.0, "behind": 180.0, "left": -90.0}
"""Degrees clockwise from the heading of the middle of each bearing."""

SLACK: Final = 1e-6
"""Degrees that a fact must hold by, so that who computes it again from a stored rotation finds it too."""


@dataclass(frozen=True, eq=False, slots=True)
class Sighting:
    """How one thing looks from places.

    azimuth (s,) : degrees clockwise from north of its centre
    low, high (s,) : how far its box reaches to the left (≤ 0) and to the right (≥ 0) of that, in degrees
    clear (s,) : the place is outside of its box, and far enough from its centre
    """

    azimuth: F64
    low: F64
    high: F64
    clear: NDArray[np.bool_]


def sighted(places: F64, box: F64, thresholds: Thresholds) -> Sighting:
    """A thing with an axis-aligned box (2, 3) from places (s, 3)."""
    x, z = places[:, 0], places[:, 2]
    (west, north), (east, south) = box[0, [0, 2]], box[1, [0, 2]]
    east_of, north_of = (west + east) / 2 - x, z - (north + south) / 2
    azimuth = _azimuth(east_of, north_of)
    corners = [_turn(_azimuth(cx - x, z - cz) - azimuth) for cx in (west, east) for cz in (north, south)]
    outside = (x < west) | (x > east) | (z < north) | (z > south)
    far = np.hypot(east_of, north_of) >= thresholds.bearing_distance
    return Sighting(azimuth, np.min(corners, axis=0), np.max(corners, axis=0), np.asarray(outside & far))


def bearing_status(seen: Sighting, direction: str, headings: Sequence[float] | F64, t: Thresholds) -> NDArray[np.int8]:
    """(s, h): 1 where a thing surely lies in a direction, −1 where it surely does not, else 0.

    headings (h,) : degrees clockwise from north
    """
    off = _turn(seen.azimuth[:, None] - np.asarray(headings)[None, :] - BEARING_DEGREES[direction])
    low, high = off + seen.low[:, None], off + seen.high[:, None]
    strict, loose = t.bearing_true, t.bearing_false
    true = (np.abs(off) <= strict - SLACK) & (low >= SLACK - loose) & (high <= loose - SLACK)
    # Round the circle both ways: the box must end before the direction begins again.
    right = (off >= loose + SLACK) & (low >= strict + SLACK) & (high <= 360.0 - strict - SLACK)
    left = (off <= -loose - SLACK) & (high <= -strict - SLACK) & (low >= strict + SLACK - 360.0)
    status = true.astype(np.int8) - (left | right).astype(np.int8)
    return np.where(seen.clear[:, None], status, 0).astype(np.int8)


def _azimuth(east: F64, north: F64) -> F64:
    return np.asarray(np.degrees(np.arctan2(east, north)), dtype=np.float64)


def _turn(degrees: F64) -> F64:
    """The same angle in [−180, 180)."""
    turned: F64 = (degrees + 180.0) % 360.0 - 180.0
    return turned
