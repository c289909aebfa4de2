"""Axis-aligned rectangles of the ground plan, in whole millimetres."""

from __future__ import annotations

from typing import NamedTuple

import shapely

__all__ = ["Rect", "metres"]


def metres(millimetres: float) -> float:
    """Return millimetres as metres, correctly rounded."""
    return millimetres / 1000


class Rect(NamedTuple):
    """A rectangle over (x, z) in millimetres, given by its lower and upper corner."""

    x0: int
    z0: int
    x1: int
    z1: int

    @property
    def width(self) -> int:
        """Extent along x."""
        return self.x1 - self.x0

    @property
    def depth(self) -> int:
        """Extent along z."""
        return self.z1 - self.z0

    @property
    def area(self) -> int:
        """Area in square millimetres."""
        return self.width * self.depth

    def grown(self, by: int) -> Rect:
        """Return the rectangle with every side moved outwards by `by` (inwards if negative)."""
        return Rect(self.x0 - by, self.z0 - by, self.x1 + by, self.z1 + by)

    def overlap(self, other: Rect) -> int:
        """Return the area of the intersection in square millimetres; 0 if the rectangles only touch."""
        width = min(self.x1, other.x1) - max(self.x0, other.x0)
        depth = min(self.z1, other.z1) - max(self.z0, other.z0)
        return width * depth if width > 0 and depth > 0 else 0

    def moved(self, dx: int, dz: int) -> Rect:
        """Return the rectangle moved by (dx, dz)."""
        return Rect(self.x0 + dx, self.z0 + dz, self.x1 + dx, self.z1 + dz)

    def transposed(self) -> Rect:
        """Return the rectangle with x and z exchanged."""
        return Rect(self.z0, self.x0, self.z1, self.x1)

    def mirrored(self) -> Rect:
        """Return the rectangle with x negated."""
        return Rect(-self.x1, self.z0, -self.x0, self.z1)

    @property
    def polygon(self) -> shapely.Polygon:
        """The rectangle as a polygon over (x, z), in millimetres."""
        return shapely.box(self.x0, self.z0, self.x1, self.z1)
