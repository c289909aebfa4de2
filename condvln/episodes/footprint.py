"""The footprint of an object: the floor area below it, as one or several rectangles in the XZ plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.scene import OrientedBox, Scene, SceneObject
from schemas.config.constants import UPRIGHT_COSINE

__all__ = ["Footprint", "Footprints", "footprint_of"]

F64 = NDArray[np.float64]

ROUNDING: Final = 1e-6
"""Largest deviation in metres of a sampled curve from the exact one."""


CORNERS: Final = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])

_NEXT: Final = [1, 2, 3, 0]

_SIDES: Final = ((1, 2), (0, 2), (0, 1))
"""The axes of a box that are level if the axis of this number is upright."""


@lru_cache(maxsize=64)
def _arcs(offset: float, spacing: float) -> tuple[tuple[F64, F64], ...]:
    """Return, for each corner of a rectangle, points (n, 2) of the quarter circle with radius `offset` around the
    origin, and its last point (2,). The points are at most `spacing` apart.
    """
    steps = max(1, int(np.ceil(offset * np.pi / 2 / spacing)))
    found = []
    for k in range(4):
        start = k * np.pi / 2
        angles = start + np.arange(steps) * (np.pi / 2 / steps)
        normal = np.array([np.cos(start + np.pi / 2), np.sin(start + np.pi / 2)])
        found.append((offset * np.column_stack([np.cos(angles), np.sin(angles)]), offset * normal))
    return tuple(found)


@lru_cache(maxsize=1024)
def _ring(offset: float, spacing: float, counts: tuple[int, int]) -> tuple[NDArray[np.intp], F64, F64]:
    """Return for each point of a ring the corner of the rectangle (n,) that it belongs to, its offset (n, 2) from that
    corner, and the share (n, 1) of the side after the corner that is added. `counts` are the numbers of points on the
    sides after the first two corners, and after the other two.
    """
    corner, away, along = list[NDArray[np.intp]](), list[F64](), list[F64]()
    for k, (arc, normal) in enumerate(_arcs(offset, spacing)):
        # A quarter arc around each corner, then the straight side to the next one.
        count = counts[k % 2]
        corner.append(np.full(len(arc) + count, k))
        away += [arc, np.broadcast_to(normal, (count, 2))]
        along += [np.zeros((len(arc), 1)), np.arange(count)[:, None] / count]
    return np.concatenate(corner), np.concatenate(away), np.concatenate(along)


@dataclass(frozen=True, eq=False, slots=True)
class Footprint:
    """A rectangle in the XZ plane, in metres: `center` (2,) as (x, z), half extents `half` (2,), and `axes` (2, 2),
    whose rows are unit vectors.

    parts : the rectangles of a footprint that is not a single one; center, half and axes are then those of the largest
    """

    center: F64
    half: F64
    axes: F64
    parts: tuple[Footprint, ...] = ()

    @classmethod
    def of(cls, item: SceneObject) -> Footprint | None:
        """Return the footprint of `item`, made from its parts, else from its upright oriented box, else from its AABB;
        None if it has no extent.
        """
        own = [cls._upright(part) for part in item.parts]
        parts = tuple(part for part in own if part is not None)
        if parts and len(parts) == len(own):
            largest = max(parts, key=lambda part: float(part.half.prod()))
            return cls(largest.center, largest.half, largest.axes, parts)
        upright = None if item.obb is None else cls._upright(item.obb)
        if upright is not None:
            return upright
        if item.aabb is None:
            return None
        low, high = item.aabb[0][[0, 2]], item.aabb[1][[0, 2]]
        return cls((low + high) / 2, (high - low) / 2, np.eye(2))

    @classmethod
    def _upright(cls, box: OrientedBox) -> Footprint | None:
        """Return the rectangle below an upright box; None if the box is tilted."""
        # Plain numbers: there are thousands of boxes, each too small for arrays.
        x, y, z = box.rotation.tolist()
        vertical = [abs(value) for value in y]
        up = vertical.index(max(vertical))
        if vertical[up] < UPRIGHT_COSINE:
            return None
        one, other = _SIDES[up]
        a, b, c, d = x[one], z[one], x[other], z[other]
        first, second = math.sqrt(a * a + b * b), math.sqrt(c * c + d * d)
        axes = np.array([[a / first, c / second], [b / first, d / second]]).T
        half = box.half_extents.tolist()
        return cls(box.center[[0, 2]], np.array([half[one], half[other]]), axes)

    @property
    def half_perimeter(self) -> float:
        """Half of the perimeter in metres."""
        if self.parts:
            return float(shapely.unary_union([part.polygon for part in self.parts]).length / 2.0)
        return float(2.0 * self.half.sum())

    @property
    def polygon(self) -> shapely.Polygon:
        """The footprint as a polygon in the (x, z) plane."""
        return shapely.Polygon(self.center + (CORNERS * self.half) @ self.axes)

    def is_near(self, points: F64) -> NDArray[np.bool_]:
        """Return a mask (n,) of the points (n, 3) that may lie inside the footprint; all others are certainly outside.
        The test is coarse.
        """
        near = np.zeros(len(points), dtype=bool)
        for box in self.parts or (self,):
            reach = math.hypot(*box.half.tolist()) + ROUNDING
            near |= (np.abs(points[:, [0, 2]] - box.center) <= reach).all(axis=1)
        return near

    def distance(self, points: F64) -> F64:
        """Return the horizontal distance (n,) in metres from points (n, 3) to the footprint; 0 inside."""
        if self.parts:
            return np.asarray(np.min([part.distance(points) for part in self.parts], axis=0), dtype=np.float64)
        local = np.abs((points[:, [0, 2]] - self.center) @ self.axes.T) - self.half
        return np.asarray(np.hypot(*np.maximum(local, 0.0).T), dtype=np.float64)

    def ring(self, offset: float, spacing: float) -> F64:
        """Return points (n, 2) on the curve at `offset` metres outside the footprint, at most `spacing` metres
        apart.
        """
        if self.parts:
            around = np.concatenate([part.ring(offset, spacing) for part in self.parts])
            # Points closer than `offset` to another part lie inside the curve.
            return around[self.distance(np.insert(around, 1, 0.0, axis=1)) >= offset - ROUNDING]
        corners = CORNERS * self.half
        sides = corners[_NEXT] - corners
        wide, deep = (max(1, math.ceil(2.0 * half / spacing)) for half in self.half.tolist())
        corner, away, along = _ring(offset, spacing, (wide, deep))
        return np.asarray(self.center + (corners[corner] + away + along * sides[corner]) @ self.axes, dtype=np.float64)

    def crossed_by(self, starts: F64, ends: F64) -> NDArray[np.bool_]:
        """Return a mask (n,) of the horizontal segments that cross the footprint's interior. The n segments run from
        `starts` to `ends`, (n, 3) each; touching the edge does not count.
        """
        crossed: NDArray[np.bool_] = Footprints([self]).crossings(starts, ends)[0]
        return crossed


_KNOWN: Final[WeakKeyDictionary[Scene, dict[str, Footprint | None]]] = WeakKeyDictionary()
"""Footprints of the scenes in use, by object id."""


def footprint_of(scene: Scene, item: SceneObject) -> Footprint | None:
    """Return the footprint of an object of `scene` as `Footprint.of` does, found once for all stages."""
    known = _KNOWN.setdefault(scene, {})
    if item.object_id not in known:
        known[item.object_id] = Footprint.of(item)
    return known[item.object_id]


class Footprints:
    """The footprints of several objects, tested together.

    Attributes
    ----------
    boxes : the b rectangles of all footprints: centres (b, 2), half extents (b, 2) and axes as columns (b, 2, 2)
    """

    def __init__(self, footprints: Sequence[Footprint]) -> None:
        parts = [footprint.parts or (footprint,) for footprint in footprints]
        boxes = [box for own in parts for box in own]
        self._first = np.cumsum([0, *map(len, parts)])[:-1]
        self._center = np.array([box.center for box in boxes]).reshape(-1, 1, 2)
        self._half = np.array([box.half for box in boxes]).reshape(-1, 1, 2)
        self._axes = np.array([box.axes for box in boxes]).reshape(-1, 2, 2).swapaxes(1, 2)
        found = (self._center[:, 0], self._half[:, 0], self._axes)
        self.boxes = tuple(np.array(values, np.float64, order="C") for values in found)

    def __len__(self) -> int:
        return len(self._first)

    def crossings(self, starts: F64, ends: F64) -> NDArray[np.bool_]:
        """Return a mask (m, n): whether the interior of each of the m footprints is crossed by each of n horizontal
        segments. The segments run from `starts` to `ends`, (n, 3) each.
        """
        a = (starts[None][:, :, [0, 2]] - self._center) @ self._axes
        d = (ends[None][:, :, [0, 2]] - self._center) @ self._axes - a
        with np.errstate(divide="ignore", invalid="ignore"):
            t1, t2 = (-self._half - a) / d, (self._half - a) / d
        enter, leave = np.minimum(t1, t2), np.maximum(t1, t2)
        # A segment parallel to a slab lies inside it for its whole length or not at all.
        flat = d == 0.0
        inside = np.abs(a) < self._half
        enter = np.where(flat, np.where(inside, -np.inf, np.inf), enter)
        leave = np.where(flat, np.where(inside, np.inf, -np.inf), leave)
        first = np.maximum(enter.max(axis=2), 0.0)
        last = np.minimum(leave.min(axis=2), 1.0)
        crossed = np.asarray(first < last, dtype=np.bool_)
        return np.logical_or.reduceat(crossed, self._first, axis=0) if len(self._first) else crossed
