"""The footprint of an object: the floor area below it, as one or several rectangles in the XZ plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from condvln.arrays import F64
from condvln.scene import OrientedBox, SceneObject
from schemas.config.constants import UPRIGHT_COSINE

__all__ = ["Footprint", "Footprints", "Obstacles"]


ROUNDING: Final = 1e-6
"""Largest deviation in metres of a sampled curve from the exact one."""


CORNERS: Final = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])

_SIDES: Final = ((1, 2), (0, 2), (0, 1))
"""The axes of a box that are level if the axis of this number is upright."""


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
        steps = max(1, math.ceil(offset * math.pi / 2 / spacing))
        pieces = list[F64]()
        for k, (corner, side) in enumerate(zip(corners, np.roll(corners, -1, axis=0) - corners, strict=True)):
            # A quarter arc around each corner, then the straight side to the next one.
            angles = k * np.pi / 2 + np.arange(steps) * (np.pi / 2 / steps)
            pieces.append(corner + offset * np.column_stack([np.cos(angles), np.sin(angles)]))
            end = (k + 1) * np.pi / 2
            count = max(1, math.ceil(2.0 * self.half[k % 2] / spacing))
            away = corner + offset * np.array([np.cos(end), np.sin(end)])
            pieces.append(away + np.arange(count)[:, None] / count * side)
        return np.asarray(self.center + np.concatenate(pieces) @ self.axes, dtype=np.float64)


Obstacles = Sequence[tuple[SceneObject, Footprint]]
"""Furniture that the navmesh ignores, each thing with its footprint."""


class Footprints:
    """The footprints of several objects, tested together.

    Attributes
    ----------
    boxes : the b rectangles of all footprints: centres (b, 2), half extents (b, 2) and axes as columns (b, 2, 2)
    """

    def __init__(self, footprints: Sequence[Footprint]) -> None:
        boxes = [box for footprint in footprints for box in footprint.parts or (footprint,)]
        self.boxes = (
            np.array([box.center for box in boxes], np.float64).reshape(-1, 2),
            np.array([box.half for box in boxes], np.float64).reshape(-1, 2),
            np.ascontiguousarray(np.array([box.axes for box in boxes], np.float64).reshape(-1, 2, 2).swapaxes(1, 2)),
        )
