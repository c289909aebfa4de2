"""A generated apartment before conversion to a file format: rooms, doors and furniture as plain values.

Frame: Habitat's (metres, +Y up, −Z north), floor at y = 0. All plan coordinates and half sizes are whole millimetres,
so every centre and box corner is on the millimetre grid that scenes are rounded to. A layout is therefore read back
unchanged from any format, also translated or mirrored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
import shapely

from condvln.arrays import F64

__all__ = ["WALL_THICKNESS", "Door", "Furniture", "Layout", "Room", "Yaw"]


WALL_THICKNESS: Final = 0.10
"""Wall thickness in metres. Room polygons meet at the middle of their walls; a wall's surface is half of this away."""

YAW_DENOMINATOR: Final = 25
"""Yaws have cosine and sine in 25ths: multiples of 90°, and the angles of the 3-4-5 and 7-24-25 triangles. They are
rational, so the axis-aligned box of a rotated piece stays on the millimetre grid if its half sizes are multiples of
25 mm.
"""


@dataclass(frozen=True, slots=True)
class Yaw:
    """A rotation about +Y, stored as its cosine and sine in units of 1/25. At yaw 0 a piece faces +Z (south), at 90° +X
    (east).
    """

    cosine25: int = YAW_DENOMINATOR
    sine25: int = 0

    def __post_init__(self) -> None:
        if self.cosine25**2 + self.sine25**2 != YAW_DENOMINATOR**2:
            raise ValueError(f"({self.cosine25}, {self.sine25})/{YAW_DENOMINATOR} is not a rotation")

    @property
    def cosine(self) -> float:
        """Cosine of the angle."""
        return self.cosine25 / YAW_DENOMINATOR

    @property
    def sine(self) -> float:
        """Sine of the angle."""
        return self.sine25 / YAW_DENOMINATOR

    @property
    def radians(self) -> float:
        """The angle in radians in (−π, π], counter-clockwise seen from above."""
        return math.atan2(self.sine25, self.cosine25)

    @property
    def square(self) -> bool:
        """Whether the angle is a multiple of 90°."""
        return 0 in (self.cosine25, self.sine25)

    def turned(self, by: Yaw) -> Yaw:
        """Return this rotation followed by `by`. One of the two must be a multiple of 90°, or the sine and cosine of
        the result would not be multiples of 1/25.
        """
        cosine = self.cosine25 * by.cosine25 - self.sine25 * by.sine25
        sine = self.sine25 * by.cosine25 + self.cosine25 * by.sine25
        return Yaw(cosine // YAW_DENOMINATOR, sine // YAW_DENOMINATOR)

    def apply(self, x: float, z: float) -> tuple[float, float]:
        """Convert a point (x, z) from a piece's own frame to the scene's frame."""
        return self.cosine * x + self.sine * z, -self.sine * x + self.cosine * z

    def rectangle(self, size: tuple[float, float, float]) -> list[tuple[float, float]]:
        """Return the corners on the ground of a turned box of this size around the origin."""
        half_x, half_z = size[0] / 2, size[2] / 2
        return [self.apply(sx * half_x, sz * half_z) for sx, sz in ((-1, -1), (1, -1), (1, 1), (-1, 1))]

    @property
    def matrix(self) -> F64:
        """The (3, 3) rotation matrix."""
        c, s = self.cosine, self.sine
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """The quaternion [x, y, z, w]."""
        half = self.radians / 2
        return 0.0, math.sin(half), 0.0, math.cos(half)


@dataclass(frozen=True, slots=True)
class Room:
    """A room: `label` in everyday words, and `polygon`, the (x, z) corners in metres of its outline along the walls'
    centre lines.

    The shoelace sum of the corners over (x, z) is positive; the outline is rectilinear, convex or L-shaped.
    """

    room_id: str
    label: str
    polygon: tuple[tuple[float, float], ...]

    @property
    def area(self) -> float:
        """Area in square metres, to the middle of the walls."""
        return float(self.shape.area)

    @property
    def shape(self) -> shapely.Polygon:
        """The outline on the ground (x, z) in metres."""
        return shapely.Polygon(self.polygon)


@dataclass(frozen=True, slots=True)
class Door:
    """An opening without a door leaf in the wall between two rooms, from `start` to `end` on the wall's centre line.

    The segment runs along x or z in ascending order; `height` is that of the opening. Metres.
    """

    rooms: tuple[str, str]
    start: tuple[float, float]
    end: tuple[float, float]
    height: float

    @property
    def width(self) -> float:
        """Width of the opening in metres."""
        return round(math.dist(self.start, self.end), 6)

    @property
    def center(self) -> tuple[float, float]:
        """(x, z) of the middle of the opening."""
        return (self.start[0] + self.end[0]) / 2, (self.start[1] + self.end[1]) / 2

    @property
    def along_x(self) -> bool:
        """Whether the door's wall runs along x."""
        return self.start[1] == self.end[1]


@dataclass(frozen=True, slots=True)
class Furniture:
    """One object: a box of `size` (width x, height y, depth z) in its own frame, rotated by `yaw` about its `center`;
    metres.

    `kind` is its row in the catalogue, `variant` the size within it; `parent` is the object it stands on.
    """

    object_id: str
    kind: str
    variant: int
    label: str
    room_id: str
    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: Yaw = field(default_factory=Yaw)
    parent: str | None = None

    @property
    def model(self) -> str:
        """Name of the model: kind and variant."""
        return f"{self.kind}_{self.variant:02d}"

    @property
    def extent(self) -> tuple[float, float, float]:
        """Full size of the axis-aligned box in the scene."""
        width, height, depth = self.size
        c, s = abs(self.yaw.cosine), abs(self.yaw.sine)
        return c * width + s * depth, height, s * width + c * depth

    @property
    def aabb(self) -> F64:
        """(2, 3) lower and upper corner of the axis-aligned box in the scene."""
        center, half = np.array(self.center), np.array(self.extent) / 2
        # without floating-point noise in the last bits
        return np.asarray(np.round(np.stack([center - half, center + half]), 6))

    @property
    def footprint(self) -> shapely.Polygon:
        """The rotated rectangle over (x, z)."""
        corners = self.yaw.rectangle(self.size)
        return shapely.Polygon([(round(self.center[0] + x, 6), round(self.center[2] + z, 6)) for x, z in corners])


@dataclass(frozen=True)
class Layout:
    """A whole apartment. `ceiling` : height of the walls in metres; `seed` : the seed it was generated from."""

    seed: int
    ceiling: float
    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]
    furniture: tuple[Furniture, ...]

    @cached_property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """((min x, min z), (max x, max z)) over the room polygons."""
        corners = np.array([corner for room in self.rooms for corner in room.polygon])
        low, high = corners.min(axis=0), corners.max(axis=0)
        return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))

    @cached_property
    def room_of(self) -> dict[str, Room]:
        """Rooms by id."""
        return {room.room_id: room for room in self.rooms}

    @cached_property
    def furniture_of(self) -> dict[str, Furniture]:
        """Furniture by id."""
        return {piece.object_id: piece for piece in self.furniture}

    def in_room(self, room_id: str) -> tuple[Furniture, ...]:
        """Return the furniture of one room, in order of creation."""
        return tuple(piece for piece in self.furniture if piece.room_id == room_id)
