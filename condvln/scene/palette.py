"""Colours of objects drawn without a mesh: one per label, the same in every scene and picture."""

from __future__ import annotations

import hashlib
from typing import Final

__all__ = ["FLOOR_COLOUR", "WALL_COLOUR", "Colour", "label_colour"]

Colour = tuple[float, float, float]
"""Red, green and blue in [0, 1]."""

FLOOR_COLOUR: Final[Colour] = (0.62, 0.55, 0.47)
WALL_COLOUR: Final[Colour] = (0.88, 0.87, 0.84)
PALE: Final = 0.35
"""Least brightness of an object's colour; hue and saturation follow from its label."""


def label_colour(label: str) -> Colour:
    """Return the colour of a label."""
    red, green, blue = (PALE + (1 - PALE) * b / 255 for b in hashlib.sha256(label.encode()).digest()[:3])
    return round(red, 3), round(green, 3), round(blue, 3)
