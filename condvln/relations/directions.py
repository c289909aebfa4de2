"""Directions: those of the compass between two things, and those of a thing from an agent's pose.

Frame: Habitat's (+Y up, −Z north, +X east). Azimuth is measured counter-clockwise from east, as in mathematics.
Directions are those of c_subject − c_target, so that an edge reads as in English: "subject north of target".

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

from condvln.arrays import F64
from schemas.config import Thresholds

__all__ = [
    "BEARING_DEGREES",
    "CANONICAL",
    "COINCIDENT",
    "COMPASS",
    "SECTORS",
    "SECTOR_DEGREES",
    "Sighting",
    "bearing_status",
    "canonical_codes",
    "edge_azimuths",
    "sector_deviation",
    "sectors",
    "sighted",
]


SECTORS: Final = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")
"""The eight sectors counter-clockwise from east, seen from above."""

SECTOR_DEGREES: Final = 45.0

COMPASS: Final = tuple(f"{sector} of" for sector in SECTORS)
"""Predicates of pairs at the same level, by sector."""

_UPWARDS: Final = tuple(f"{sector}-and-up of" for sector in SECTORS)
_DOWNWARDS: Final = tuple(f"{sector}-and-down of" for sector in SECTORS)

CANONICAL: Final = (*COMPASS, *_UPWARDS, *_DOWNWARDS, "up of", "down of")
"""All canonical predicates; the code of a pair is an index into it. Eight for each of three levels, then two
vertical ones.
"""

COINCIDENT: Final = -1
"""Code of a pair whose centres coincide; it has no canonical predicate."""

_WEST: Final = SECTORS.index("west")
_EDGES: Final = np.arange(-157.5, 180.0, SECTOR_DEGREES)
"""Lower edges in degrees of the sectors from south-west on; azimuths below the first and above the last are west."""

_UP: Final = CANONICAL.index("up of")
_DOWN: Final = CANONICAL.index("down of")


def sectors(azimuth: F64) -> NDArray[np.int8]:
    """Return the sector index of azimuths in [−180, 180] degrees; a sector is [c − 22.5°, c + 22.5°). NaN gives −1."""
    # Compared with the edges directly: adding half a sector and dividing would round across an edge.
    passed = np.sum([azimuth >= edge for edge in _EDGES], axis=0, dtype=np.int8)
    return np.where(np.isnan(azimuth), -1, (passed + _WEST) % len(SECTORS)).astype(np.int8)


def sector_deviation(azimuth: F64, sector: int) -> F64:
    """Return the angles, in [0, 180] degrees, between azimuths and the centre of a sector. The azimuths are in [−180,
    180] degrees; NaN gives NaN.
    """
    turn = np.abs(azimuth - SECTOR_DEGREES * sector)
    deviation: F64 = np.minimum(turn, np.abs(360.0 - turn))
    return deviation


def edge_azimuths(centers: F64, low: F64, high: F64) -> tuple[F64, F64]:
    """Return two azimuths (n, n) in [−180, 180] degrees for each pair of n objects: of the subject's centre from the
    nearest point of the target's footprint, and of the nearest point of the subject's footprint from the target's
    centre. An object without a box counts as its centre. NaN where a centre is over the other's footprint.

    A chair in front of one end of a long counter is north-east of the counter's centre, but north of its nearest point.

    centers, low, high (n, 3) : whole millimetres, the corners NaN where unknown
    """
    low, high = (np.where(np.isnan(corner), centers, corner) for corner in (low, high))
    east, south = (
        centers[:, None, k] - np.clip(centers[:, None, k], low[None, :, k], high[None, :, k]) for k in (0, 2)
    )
    north = 0.0 - south
    azimuth = np.where((east != 0.0) | (north != 0.0), np.degrees(np.arctan2(north, east)), np.nan)
    back: F64 = np.where(azimuth > 0.0, azimuth - 180.0, azimuth + 180.0).T
    return azimuth, back


def canonical_codes(azimuth: F64, elevation: F64, dy: F64, level: float) -> NDArray[np.int8]:
    """Return, for each pair, the index of its canonical predicate in `CANONICAL`.

    azimuth : degrees, NaN where the horizontal distance is below 1 mm
    elevation : degrees of the subject above the target
    dy : metres of the subject above the target; decides pairs without azimuth
    level : degrees; pairs with a smaller absolute elevation are level
    """
    storey = (elevation >= level).astype(np.int8) + 2 * (elevation <= -level).astype(np.int8)
    vertical = np.where(dy > 0, _UP, np.where(dy < 0, _DOWN, COINCIDENT))
    return np.where(np.isnan(azimuth), vertical, storey * len(SECTORS) + sectors(azimuth)).astype(np.int8)


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
