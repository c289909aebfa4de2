"""The start pose of an episode: the direction that an agent faces, and whether objects are to its left, to its right,
ahead or behind. The code is independent of the generator's.

The agent's axes come from its rotation. An object is a rectangle on the ground, a direction is a wedge around one of
the axes, and the two shapes are tested for intersection.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from condvln.scene import Room
from condvln.verify.surroundings import Judgement, Thing, judged, whole_mm
from schemas.config import Thresholds
from schemas.config.constants import SINK
from schemas.evaluation import ManifestEpisode

__all__ = [
    "BEARINGS",
    "COMPASS",
    "Standpoint",
    "heading_of",
    "inside_outline",
    "yaw_of",
]

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


BEARINGS: Final = {"ahead": (1, 0), "right": (0, 1), "behind": (-1, 0), "left": (0, -1)}
"""(ahead, to the right) of the middle of each direction."""

_Point = tuple[float, float]


class Standpoint(NamedTuple):
    """The start pose of an episode: x, height and z in millimetres, and the heading as a unit vector on the ground
    (x, z).
    """

    x: float
    height: float
    z: float
    forward: _Point

    @classmethod
    def of(cls, row: ManifestEpisode) -> Standpoint | None:
        """Return the start pose of a row; None if its rotation is not about the vertical axis."""
        yaw = yaw_of(row.start_rotation)
        if yaw is None:
            return None
        x, y, z = (1000.0 * value for value in row.start_position)
        return cls(x, y, z, (-math.sin(yaw), -math.cos(yaw)))

    def is_in(self, room: Room) -> bool:
        """Return whether the start is inside a room's outline and at about the height of the room's floor. A room
        without an outline contains every start.
        """
        if room.polygon is None:
            return True
        outline = [(1000.0 * float(x), 1000.0 * float(z)) for x, z in room.polygon]
        return inside_outline(self.x, self.z, outline) and abs(self.height - 1000.0 * room.floor_y) <= whole_mm(SINK)

    def judge(self, direction: str, thing: Thing, t: Thresholds) -> Judgement:
        """Return the judgement on whether `thing` lies in a direction as seen from the start."""
        if thing.box is None:
            return judged(False, False, distance=None)
        (west, _, north), (east, _, south) = thing.box
        corners = [self._seen(x, z, direction) for x, z in ((west, north), (east, north), (east, south), (west, south))]
        middle = self._seen((west + east) / 2, (north + south) / 2, direction)
        distance, off = math.hypot(*middle), _off(middle)
        stands_in_it = west <= self.x <= east and north <= self.z <= south
        clear = not stands_in_it and distance >= whole_mm(t.bearing_distance)
        true = clear and off <= t.bearing_true and all(_off(corner) <= t.bearing_false for corner in corners)
        false = clear and off >= t.bearing_false and not _meets(corners, t.bearing_true)
        found = judged(true, false, distance=distance)
        return found._replace(numbers={**found.numbers, "degrees_off": round(off, 3)})

    def _seen(self, x: float, z: float, direction: str) -> _Point:
        """Return a point's offset from the start in millimetres, as seen when facing `direction`: (distance ahead,
        distance to the right).
        """
        dx, dz = x - self.x, z - self.z
        ahead = dx * self.forward[0] + dz * self.forward[1]
        right = -dx * self.forward[1] + dz * self.forward[0]
        a, r = BEARINGS[direction]
        return a * ahead + r * right, a * right - r * ahead


def _off(point: _Point) -> float:
    """Return the angle in degrees between a direction and the line to a point. `point` is what `_seen` returns for the
    point: (distance ahead, distance to the right).
    """
    return math.degrees(math.atan2(abs(point[1]), point[0]))


def _meets(corners: Sequence[_Point], half_width: float) -> bool:
    """Return whether a rectangle intersects the wedge of ± `half_width` degrees about an axis. The origin must be
    outside the rectangle.

    It does if a corner is in the wedge, or if one of the wedge's two edges crosses one of the rectangle's sides.
    """
    if any(_off(corner) < half_width for corner in corners):
        return True
    edge = math.radians(half_width)
    for ray in ((math.cos(edge), math.sin(edge)), (math.cos(edge), -math.sin(edge))):
        for one, other in zip(corners, (*corners[1:], corners[0]), strict=True):
            a = ray[0] * one[1] - ray[1] * one[0]
            b = ray[0] * other[1] - ray[1] * other[0]
            if (a < 0.0) != (b < 0.0):
                part = a / (a - b)
                along = [one[k] + part * (other[k] - one[k]) for k in (0, 1)]
                if along[0] * ray[0] + along[1] * ray[1] > 0.0:
                    return True
    return False


def inside_outline(x: float, z: float, outline: Sequence[_Point]) -> bool:
    """Return whether a point is inside a polygon, by the number of sides that a ray towards +x crosses."""
    inside = False
    for (x0, z0), (x1, z1) in zip(outline, (*outline[1:], outline[0]), strict=True):
        if (z0 > z) != (z1 > z) and x < x0 + (z - z0) / (z1 - z0) * (x1 - x0):
            inside = not inside
    return inside
