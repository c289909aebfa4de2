"""Egocentric directions: whether an object is on the left or right, ahead of or behind an agent in a given pose.

A bearing is an angle in degrees clockwise from the agent's heading, so that right is 90. The bearing of an object is
the bearing of its box's centre, seen from above. The box's angular width counts too: an object that extends from the
left to the front is neither surely left nor surely not left.
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
"""Bearing in degrees of the middle of each direction, clockwise from the heading."""

SLACK: Final = 1e-6
"""Safety margin in degrees, so that the same fact follows from a stored, rounded rotation."""


@dataclass(frozen=True, eq=False, slots=True)
class Sighting:
    """The direction and angular width of one object, seen from s positions.

    azimuth (s,) : of its centre, degrees clockwise from north
    low, high (s,) : angular extent of its box to the left (≤ 0) and to the right (≥ 0) of the centre, degrees
    clear (s,) : the position is outside its box and far enough from its centre
    """

    azimuth: F64
    low: F64
    high: F64
    clear: NDArray[np.bool_]


def sighted(places: F64, box: F64, thresholds: Thresholds) -> Sighting:
    """Return the direction and angular width of an axis-aligned box (2, 3), as seen from each of the positions (s, 3)
    in metres.
    """
    x, z = places[:, 0], places[:, 2]
    (west, north), (east, south) = box[0, [0, 2]], box[1, [0, 2]]
    east_of, north_of = (west + east) / 2 - x, z - (north + south) / 2
    azimuth = _azimuth(east_of, north_of)
    corners = [_turn(_azimuth(cx - x, z - cz) - azimuth) for cx in (west, east) for cz in (north, south)]
    outside = (x < west) | (x > east) | (z < north) | (z > south)
    far = np.hypot(east_of, north_of) >= thresholds.bearing_distance
    return Sighting(azimuth, np.min(corners, axis=0), np.max(corners, axis=0), np.asarray(outside & far))


def bearing_status(seen: Sighting, direction: str, headings: Sequence[float] | F64, t: Thresholds) -> NDArray[np.int8]:
    """Return a status (s, h) for each of s positions and h headings: 1 if the object surely lies in `direction`, −1 if
    it surely does not, else 0.

    headings (h,) : degrees clockwise from north
    """
    off = _turn(seen.azimuth[:, None] - np.asarray(headings)[None, :] - BEARING_DEGREES[direction])
    low, high = off + seen.low[:, None], off + seen.high[:, None]
    strict, loose = t.bearing_true, t.bearing_false
    true = (np.abs(off) <= strict - SLACK) & (low >= SLACK - loose) & (high <= loose - SLACK)
    # Checked both ways around the circle: the box must end before the direction's range begins again.
    right = (off >= loose + SLACK) & (low >= strict + SLACK) & (high <= 360.0 - strict - SLACK)
    left = (off <= -loose - SLACK) & (high <= -strict - SLACK) & (low >= strict + SLACK - 360.0)
    status = true.astype(np.int8) - (left | right).astype(np.int8)
    return np.where(seen.clear[:, None], status, 0).astype(np.int8)


def _azimuth(east: F64, north: F64) -> F64:
    return np.asarray(np.degrees(np.arctan2(east, north)), dtype=np.float64)


def _turn(degrees: F64) -> F64:
    """Return angles in degrees, brought into the range [−180, 180) by whole turns."""
    turned: F64 = (degrees + 180.0) % 360.0 - 180.0
    return turned
