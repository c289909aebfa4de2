"""Directions: azimuth, elevation, the eight sectors and the canonical predicate of a pair.

Frame: Habitat's (+Y up, −Z north, +X east). Azimuth is measured from east towards north, as in mathematics; an edge
reads as English, so directions are those of c_subject − c_target.
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
    "sector_deviation",
    "sectors",
]

F64 = NDArray[np.float64]

SECTORS: Final = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")
"""Sectors counter-clockwise from east, seen from above."""

SECTOR_DEGREES: Final = 45.0

COMPASS: Final = tuple(f"{sector} of" for sector in SECTORS)
"""Predicates of level pairs, by sector."""

_UPWARDS: Final = tuple(f"{sector}-and-up of" for sector in SECTORS)
_DOWNWARDS: Final = tuple(f"{sector}-and-down of" for sector in SECTORS)

CANONICAL: Final = (*COMPASS, *_UPWARDS, *_DOWNWARDS, "up of", "down of")
"""All canonical predicates; the code of a pair is an index into this. 8 a level, then the two vertical ones."""

COINCIDENT: Final = -1
"""Code of a pair whose centres coincide: it has no canonical predicate."""

_WEST: Final = SECTORS.index("west")
_EDGES: Final = np.arange(-157.5, 180.0, SECTOR_DEGREES)
"""Lower edges of the sectors from south-west on; what lies below the first and above the last is west."""

_UP: Final = CANONICAL.index("up of")
_DOWN: Final = CANONICAL.index("down of")


def sectors(azimuth: F64) -> NDArray[np.int8]:
    """Sector index of azimuths in [−180, 180] degrees; half-open [c − 22.5°, c + 22.5°). NaN gives −1."""
    # Compared with the edges themselves: adding half a sector and dividing would round across an edge.
    passed = np.sum([azimuth >= edge for edge in _EDGES], axis=0, dtype=np.int8)
    return np.where(np.isnan(azimuth), -1, (passed + _WEST) % len(SECTORS)).astype(np.int8)


def sector_deviation(azimuth: F64, sector: int) -> F64:
    """Angles in [0, 180] degrees between azimuths in [−180, 180] and the centre of a sector; NaN without azimuth."""
    turn = np.abs(azimuth - SECTOR_DEGREES * sector)
    deviation: F64 = np.minimum(turn, np.abs(360.0 - turn))
    return deviation


def canonical_codes(azimuth: F64, elevation: F64, dy: F64, level: float) -> NDArray[np.int8]:
    """Index into `CANONICAL` per pair.

    azimuth : degrees, NaN where the horizontal distance is below 1 mm
    elevation : degrees of subject above target
    dy : metres of subject above target; decides the pairs without azimuth
    level : elevations of smaller size are level
    """
    storey = (elevation >= level).astype(np.int8) + 2 * (elevation <= -level).astype(np.int8)
    vertical = np.where(dy > 0, _UP, np.where(dy < 0, _DOWN, COINCIDENT))
    return np.where(np.isnan(azimuth), vertical, storey * len(SECTORS) + sectors(azimuth)).astype(np.int8)
