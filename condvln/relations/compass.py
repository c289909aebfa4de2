"""Compass directions: azimuth, elevation, the eight sectors and the canonical predicate of a pair.

Frame: Habitat's (+Y up, −Z north, +X east). Azimuth is measured counter-clockwise from east, as in mathematics.
Directions are those of c_subject − c_target, so that an edge reads as in English: "subject north of target".
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "CANONICAL",
    "COINCIDENT",
    "COMPASS",
    "SECTORS",
    "SECTOR_DEGREES",
    "canonical_codes",
    "edge_azimuths",
    "sector_deviation",
    "sectors",
]

F64 = NDArray[np.float64]

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
