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
"""Compass directions in degrees clockwise from north."""

UNIT: Final = 1e-6
"""Tolerance of a rotation's norm around 1, and of its tilt around 0."""


def yaw_of(rotation: Sequence[float]) -> float | None:
    """Return the yaw in radians about +Y of a rotation ``[x, y, z, w]``; None if its axis is not vertical."""
    x, y, z, w = rotation
    if abs(x) > UNIT or abs(z) > UNIT or abs(math.hypot(y, w) - 1.0) > UNIT:
        return None
    return 2.0 * math.atan2(y, w)


def heading_of(yaw: float) -> float:
    """Return the compass heading in [0, 360) degrees; yaw is counter-clockwise, headings are clockwise."""
    return math.degrees(-yaw) % 360.0
