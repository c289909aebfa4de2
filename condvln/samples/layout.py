"""A made apartment before any file format: rooms, doors and furniture, as plain values.

Frame: Habitat's (metres, +Y up, −Z north), floor at y = 0. All plan coordinates are whole millimetres and all half
sizes too, so every centre and every box corner lies on the millimetre grid that scenes are rounded to: a layout reads
back the same from any format, translated or mirrored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["WALL_THICKNESS", "Door", "Furniture", "Layout", "Room", "Yaw"]

F64 = NDArray[np.float64]

WALL_THICKNESS: Final = 0.10
"""Metres. Room polygons meet at the middle of their walls; the free side of a wall is half of this from it."""

YAW_DENOMINATOR: Final = 25
"""Yaws have cosine and sine in 25ths (multiples of 90°, and the 3-4-5 and 7-24-25 triangles): rational, so that the
axis-aligned box of a turned piece stays on the millimetre grid where its half sizes are multiples of 25 mm."""


@dataclass(frozen=True, slots=True)
class Yaw:
    """Rotation about +Y as (cosine, sine) in 25ths. At zero a piece faces +Z (south), at 90° +X (east)."""

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
        """The angle in (−π, π], counter-clockwise seen from above."""
        return math.atan2(self.sine25, self.cosine25)

    @property
    def square(self) -> bool:
        """Is this a multiple of 90°?"""
        return 0 in (self.cosine25, self.sine25)

    def turned(self, by: Yaw) -> Yaw:
        """This rotation followed by `by`, where one of the two is a multiple of 90° (else it leaves the 25ths)."""
        cosine = self.cosine25 * by.cosine25 - self.sine25 * by.sine25
        sine = self.sine25 * by.cosine25 + self.cosine25 * by.sine25
        return Yaw(cosine // YAW_DENOMINATOR, sine // YAW_DENOMINATOR)

    def apply(self, x: float, z: float) -> tuple[float, float]:
        """(x, z) of a piece's own frame in the scene's."""
        return self.cosine * x + self.sine * z, -self.sine * x + self.cosine * z

    @property
    def matrix(self) -> F64:
        """(3, 3) rotation."""
        c, s = self.cosine, self.sine
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """[x, y, z, w]."""
        half = self.radians / 2
        return 0.0, math.sin(half), 0.0, math.cos(half)


def _clean(metres: F64) -> F64:
    """Coordinates without the noise of their last bits."""
    return np.asarray(np.round(metres, 6), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Room:
    """A room: `label` in everyday words, `polygon` the (x, z) corners at the middle of its walls.

    Corners run so that the shoelace sum over (x, z) is positive; rectilinear, convex or L-shaped.
    """

    room_id: str
    label: str
    polygon: tuple[tuple[float, float], ...]

    @property
    def area(self) -> float:
        """Square metres, to the middle of the walls."""
        return float(self.shape.area)

    @property
    def shape(self) -> shapely.Polygon:
        """The outline on the ground (x, z) in metres."""
        return shapely.Polygon(self.polygon)


@dataclass(frozen=True, slots=True)
class Door:
    """An opening without a leaf in the wall between two rooms: from `start` to `end` on the wall's middle line.

    The segment runs along x or along z in ascending order; `height` is that of the opening.
    """

    door_id: str
    rooms: tuple[str, str]
    start: tuple[float, float]
    end: tuple[float, float]
    height: float

    @property
    def width(self) -> float:
        """Metres."""
        return round(math.dist(self.start, self.end), 6)

    @property
    def center(self) -> tuple[float, float]:
        """(x, z) of the middle of the opening."""
        return (self.start[0] + self.end[0]) / 2, (self.start[1] + self.end[1]) / 2

    @property
    def along_x(self) -> bool:
        """Does its wall run along x?"""
        return self.start[1] == self.end[1]


@dataclass(frozen=True, slots=True)
class Furniture:
    """One object: a box of `size` (width x, height y, depth z) in its own frame, turned by `yaw` about its `center`.

    `kind` names the row of the catalogue, `variant` the size within it; `parent` is the object it stands on.
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
        return _clean(np.stack([center - half, center + half]))

    @property
    def footprint(self) -> shapely.Polygon:
        """The turned rectangle over (x, z)."""
        half_x, half_z = self.size[0] / 2, self.size[2] / 2
        corners = [
            self.yaw.apply(x, z)
            for x, z in ((-half_x, -half_z), (half_x, -half_z), (half_x, half_z), (-half_x, half_z))
        ]
        return shapely.Polygon([(round(self.center[0] + x, 6), round(self.center[2] + z, 6)) for x, z in corners])


@dataclass(frozen=True)
class Layout:
    """A whole apartment. `ceiling` is the height of the walls; `seed` the number it was made from."""

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
        """The furniture of one room, in order of making."""
        return tuple(piece for piece in self.furniture if piece.room_id == room_id)
