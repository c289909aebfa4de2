"""A room while it is being furnished: the pieces placed so far, and whether another piece fits at a position.

All lengths are millimetres. A piece fits if its box overlaps no other box, leaves doorways and the space in front of
other pieces free, and keeps the floor connected for the agent, with passages for people between all doors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import shapely

from condvln.samples.catalogue import Kind
from condvln.samples.floor_plan import Rect
from condvln.samples.layout import Yaw

__all__ = ["BLOCKING_HEIGHT", "DoorZone", "Edge", "Piece", "RoomSpace", "opened"]

GAP: Final = 20
"""Least distance between the boxes of two pieces, seen from above."""

WALL_GAP: Final = 20
"""Distance of a piece's back from the wall it stands against."""

HANG_GAP: Final = 10
"""Distance of a wall-mounted piece's back from its wall."""

HALF_WALL: Final = 50
"""Half the thickness of a wall."""

DOOR_DEPTH: Final = 800
"""Depth of the floor kept free on either side of a doorway."""

AGENT_RADIUS: Final = 100
"""Radius of the agent for which the floor must stay connected."""

PASSAGE_RADIUS: Final = 240
"""Radius of a person for whom all doorways of a room must stay connected."""

BLOCKING_HEIGHT: Final = 50
"""Height up to which objects (rugs, mats) can be walked over."""

AGENT_HEIGHT: Final = 1500
"""Height from which objects can be walked under."""

SLIT: Final = 50
"""Strips of free floor narrower than this don't count as floor."""


def opened(floor: shapely.Geometry, slit: float = SLIT, grid: float = 1.0) -> shapely.Geometry:
    """Return `floor` without its parts that are narrower than `slit`, with coordinates on a grid of size `grid`. This
    is a morphological opening with square corners.
    """
    # GEOS handles parallel edges when computing the mitre, but leaves numpy's warning flags raised.
    with np.errstate(divide="ignore", invalid="ignore"):
        wide = floor.buffer(-slit / 2, join_style="mitre").buffer(slit / 2, join_style="mitre")
    # If shrinking removes a short edge, the mitre of its neighbours would extend beyond the floor.
    return shapely.intersection(wide, floor, grid_size=grid)


class Edge(NamedTuple):
    """The free side of a wall. It begins at (x, z) and is `length` long in the direction (dx, dz); its normal points
    into the room.
    """

    x: int
    z: int
    dx: int
    dz: int
    length: int

    @property
    def normal(self) -> tuple[int, int]:
        """Unit vector into the room."""
        return -self.dz, self.dx

    @property
    def yaw(self) -> Yaw:
        """Yaw of a piece that stands against this wall and faces the room."""
        nx, nz = self.normal
        return Yaw(25 * nz, 25 * nx)

    def point(self, along: int, away: int) -> tuple[int, int]:
        """Return the point (x, z) that is `along` mm from the start of the wall, measured along it, and `away` mm from
        the wall.
        """
        nx, nz = self.normal
        return self.x + self.dx * along + nx * away, self.z + self.dz * along + nz * away


class DoorZone(NamedTuple):
    """The floor in front of a doorway, and a point in it that must stay reachable."""

    rect: Rect
    point: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Piece:
    """A placed piece of furniture: centre (x, z) and lower edge, in millimetres."""

    kind: Kind
    variant: int
    x: int
    z: int
    bottom: int
    yaw: Yaw
    parent: int | None = None
    against: Edge | None = None
    soft: bool = False

    @property
    def size(self) -> tuple[int, int, int]:
        """Width, height and depth in the piece's own frame."""
        return self.kind.sizes[self.variant]

    @property
    def top(self) -> int:
        """Height of the piece's upper edge."""
        return self.bottom + self.size[1]

    @property
    def rect(self) -> Rect:
        """The piece's axis-aligned box seen from above."""
        return self.rect_of(0, 0)

    def rect_of(self, back: int, front: int) -> Rect:
        """Return the piece's box, extended by `back` behind and by `front` in front of the piece (the yaw must be a
        multiple of 90°).
        """
        width, _, depth = self.size
        c, s = abs(self.yaw.cosine25), abs(self.yaw.sine25)
        half_x, half_z = (c * width + s * depth) // 50, (s * width + c * depth) // 50
        rect = Rect(self.x - half_x, self.z - half_z, self.x + half_x, self.z + half_z)
        if not back and not front:
            return rect
        fx, fz = self.facing
        reach = [max(f, 0) * front + max(-f, 0) * back for f in (fx, fz, -fx, -fz)]
        return Rect(rect.x0 - reach[2], rect.z0 - reach[3], rect.x1 + reach[0], rect.z1 + reach[1])

    @property
    def facing(self) -> tuple[int, int]:
        """Unit vector (x, z) in the direction of the piece's front; the piece's yaw is a multiple of 90°."""
        return self.yaw.sine25 // 25, self.yaw.cosine25 // 25

    @property
    def front_zone(self) -> Rect | None:
        """The floor that must stay free in front of the piece; None if the piece needs no free floor."""
        if not self.kind.front or not self.yaw.square or self.soft:
            return None
        whole, own = self.rect_of(0, self.kind.front), self.rect
        fx, fz = self.facing
        if fx:
            return whole._replace(x0=own.x1) if fx > 0 else whole._replace(x1=own.x0)
        return whole._replace(z0=own.z1) if fz > 0 else whole._replace(z1=own.z0)

    @property
    def footprint(self) -> shapely.Polygon:
        """The rotated rectangle over (x, z)."""
        if self.yaw.square:
            return self.rect.polygon
        corners = self.yaw.rectangle(self.size)
        return shapely.Polygon([(self.x + x, self.z + z) for x, z in corners])

    @property
    def blocks(self) -> bool:
        """Whether the piece is an obstacle for the agent."""
        return self.top > BLOCKING_HEIGHT and self.bottom < AGENT_HEIGHT


@dataclass
class RoomSpace:
    """A room that is being furnished: its free wall sides, its door zones, and the pieces placed so far."""

    label: str
    polygon: shapely.Polygon
    doors: tuple[DoorZone, ...]
    pieces: list[Piece] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.inner: shapely.Polygon = self.polygon.buffer(-HALF_WALL, join_style="mitre")
        shapely.prepare(self.inner)
        self.edges: tuple[Edge, ...] = tuple(_edges(self.inner))
        self._points = [shapely.Point(door.point) for door in self.doors]
        self._measure_floor()

    def _measure_floor(self) -> None:
        self._floor = self.inner.buffer(-AGENT_RADIUS, join_style="mitre")
        self._passage = self.inner.buffer(-PASSAGE_RADIUS, join_style="mitre")
        for piece in self.pieces:
            if piece.blocks:
                self._floor, self._passage = self._floor_without(piece)

    def _floor_without(self, piece: Piece) -> tuple[shapely.Geometry, shapely.Geometry]:
        footprint = piece.footprint
        return (
            self._floor.difference(footprint.buffer(AGENT_RADIUS, join_style="mitre")),
            self._passage.difference(footprint.buffer(PASSAGE_RADIUS, join_style="mitre")),
        )

    @property
    def corners(self) -> Iterator[tuple[Edge, Edge]]:
        """Yield pairs of walls that meet in a convex corner of the room."""
        for one, other in zip(self.edges, (*self.edges[1:], self.edges[0]), strict=True):
            if one.dx * other.dz - one.dz * other.dx > 0:
                yield one, other

    def of_kind(self, kinds: Sequence[str]) -> list[int]:
        """Return the indices of the pieces of these kinds."""
        return [index for index, piece in enumerate(self.pieces) if piece.kind.kind in kinds]

    def add(self, piece: Piece) -> bool:
        """Add `piece` at its position if it fits; return whether it was added."""
        if not self._box_fits(piece) or not self._zones_fit(piece):
            return False
        if piece.blocks:
            floor, passage = self._floor_without(piece)
            if opened(floor).geom_type != "Polygon" or not self._doors_joined(passage):
                return False
            self._floor, self._passage = floor, passage
        self.pieces.append(piece)
        return True

    def restore(self, pieces: list[Piece]) -> None:
        """Restore an earlier list of pieces."""
        self.pieces = pieces
        self._measure_floor()

    def _box_fits(self, piece: Piece) -> bool:
        rect = piece.rect
        if not self.inner.covers(rect.polygon) or any(rect.overlap(door.rect) for door in self.doors):
            return False
        if piece.parent is not None and not _inside(rect, self.pieces[piece.parent].rect):
            return False
        near = rect.grown(GAP)
        return not any(
            near.overlap(other.rect) and piece.bottom < other.top and other.bottom < piece.top for other in self.pieces
        )

    def _zones_fit(self, piece: Piece) -> bool:
        if not piece.blocks or piece.parent is not None:
            return True
        rect, zone = piece.rect, piece.front_zone
        if not piece.soft and any(other.front_zone and rect.overlap(other.front_zone) for other in self.pieces):
            return False
        if zone is None:
            return True
        if not self.inner.covers(zone.polygon):
            return False
        return not any(zone.overlap(other.rect) and other.blocks and not other.soft for other in self.pieces)

    def _doors_joined(self, passage: shapely.Geometry) -> bool:
        parts = shapely.get_parts(passage)
        return any(all(part.covers(point) for point in self._points) for part in parts)


def _inside(rect: Rect, outer: Rect) -> bool:
    return outer.x0 <= rect.x0 and outer.z0 <= rect.z0 and rect.x1 <= outer.x1 and rect.z1 <= outer.z1


def _edges(inner: shapely.Polygon) -> Iterator[Edge]:
    ring = [(round(x), round(z)) for x, z in shapely.geometry.polygon.orient(inner.simplify(0), 1.0).exterior.coords]
    for (x0, z0), (x1, z1) in pairwise(ring):
        length = abs(x1 - x0) + abs(z1 - z0)
        yield Edge(x0, z0, (x1 - x0) // length, (z1 - z0) // length, length)
