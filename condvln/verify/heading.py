"""The direction that an agent faces, from its rotation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

__all__ = ["COMPASS", "heading_of", "yaw_of"]

COMPASS: Final = {
    name: 45.0 * k
    for k, name in enumerate(("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west"))
}
"""Degrees clockwise from north."""

UNIT: Final = 1e-6
"""How far a rotation's norm may be from 1, and its tilt from 0."""


def yaw_of(rotation: Sequence[float]) -> float | None:
    """Radians about +Y of a rotation ``[x, y, z, w]``; None where it is not a turn about the vertical."""
    x, y, z, w = rotation
    if abs(x) > UNIT or abs(z) > UNIT or abs(math.hypot(y, w) - 1.0) > UNIT:
        return None
    return 2.0 * math.atan2(y, w)


def heading_of(yaw: float) -> float:
    """Compass heading in [0, 360) degrees: yaw turns the other way round than a compass counts."""
    return math.degrees(-yaw) % 360.0
