"""The floor area an object stands over, as a rectangle in the XZ plane, or several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.scene import OrientedBox, SceneObject
from schemas.config.constants import UPRIGHT_COSINE

__all__ = ["Footprint", "Footprints"]

F64 = NDArray[np.float64]

ROUNDING: Final = 1e-6
"""Metres by which points of a curve may miss it."""


@dataclass(frozen=True, eq=False, slots=True)
class Footprint:
    """center (2,) as (x, z); half (2,) extents; axes (2, 2), its rows the rectangle's unit axes. Metres.

    parts : rectangles that make up the footprint where it is not one; center is then that of the largest
    """

    center: F64
    half: F64
    axes: F64
    parts: tuple[Footprint, ...] = ()

    @classmethod
    def of(cls, item: SceneObject) -> Footprint | None:
        """Footprint of `item`: from its parts, else its upright oriented box, else its AABB; None without extent."""
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
        """The rectangle below an upright box; None where it is tilted."""
        vertical = np.abs(box.rotation[1])
        up = int(np.argmax(vertical))
        if vertical[up] < UPRIGHT_COSINE:
            return None
        sides = [k for k in range(3) if k != up]
        axes = box.rotation[np.ix_([0, 2], sides)].T
        axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        return cls(box.center[[0, 2]], box.half_extents[sides], axes)

    @property
    def half_perimeter(self) -> float:
        """Half of the perimeter in metres."""
        if self.parts:
            return float(shapely.unary_union([part.polygon for part in self.parts]).length / 2.0)
        return float(2.0 * self.half.sum())

    @property
    def polygon(self) -> shapely.Polygon:
        """The rectangle in the (x, z) plane."""
        return shapely.Polygon(self.center + (np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * self.half) @ self.axes)

    def distance(self, points: F64) -> F64:
        """Horizontal distance (n,) from points (n, 3) to the footprint; 0 inside."""
        if self.parts:
            return np.asarray(np.min([part.distance(points) for part in self.parts], axis=0), dtype=np.float64)
        local = np.abs((points[:, [0, 2]] - self.center) @ self.axes.T) - self.half
        return np.asarray(np.hypot(*np.maximum(local, 0.0).T), dtype=np.float64)

    def ring(self, offset: float, spacing: float) -> F64:
        """Points (n, 2) on the curve at `offset` metres outside the footprint, at most `spacing` apart."""
        if self.parts:
            around = np.concatenate([part.ring(offset, spacing) for part in self.parts])
            # What is nearer to another part is inside of the curve.
            return around[self.distance(np.insert(around, 1, 0.0, axis=1)) >= offset - ROUNDING]
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * self.half
        points = []
        for k, corner in enumerate(corners):
            # A quarter arc around each corner, then the straight side to the next one.
            start = k * np.pi / 2
            steps = max(1, int(np.ceil(offset * np.pi / 2 / spacing)))
            angles = start + np.arange(steps) * (np.pi / 2 / steps)
            points.append(corner + offset * np.column_stack([np.cos(angles), np.sin(angles)]))
            following = corners[(k + 1) % 4]
            normal = np.array([np.cos(start + np.pi / 2), np.sin(start + np.pi / 2)])
            count = max(1, int(np.ceil(np.linalg.norm(following - corner) / spacing)))
            t = np.arange(count)[:, None] / count
            points.append(corner + offset * normal + t * (following - corner))
        return np.asarray(self.center + np.concatenate(points) @ self.axes, dtype=np.float64)

    def crossed_by(self, starts: F64, ends: F64) -> NDArray[np.bool_]:
        """Which horizontal segments (n, 3)–(n, 3) pass through the rectangle's inside (touching its edge does not)."""
        crossed: NDArray[np.bool_] = Footprints([self]).crossings(starts, ends)[0]
        return crossed


class Footprints:
    """Several footprints at once."""

    def __init__(self, footprints: Sequence[Footprint]) -> None:
        parts = [footprint.parts or (footprint,) for footprint in footprints]
        boxes = [box for own in parts for box in own]
        self._first = np.cumsum([0, *map(len, parts)])[:-1]
        self._center = np.array([box.center for box in boxes]).reshape(-1, 1, 2)
        self._half = np.array([box.half for box in boxes]).reshape(-1, 1, 2)
        self._axes = np.array([box.axes for box in boxes]).reshape(-1, 2, 2).swapaxes(1, 2)

    def __len__(self) -> int:
        return len(self._first)

    def crossings(self, starts: F64, ends: F64) -> NDArray[np.bool_]:
        """(m, n): which of the m footprints' insides each horizontal segment (n, 3)–(n, 3) passes through."""
        a = (starts[None][:, :, [0, 2]] - self._center) @ self._axes
        d = (ends[None][:, :, [0, 2]] - self._center) @ self._axes - a
        with np.errstate(divide="ignore", invalid="ignore"):
            t1, t2 = (-self._half - a) / d, (self._half - a) / d
        enter, leave = np.minimum(t1, t2), np.maximum(t1, t2)
        # A segment parallel to a slab is inside it throughout or not at all.
        flat = d == 0.0
        inside = np.abs(a) < self._half
        enter = np.where(flat, np.where(inside, -np.inf, np.inf), enter)
        leave = np.where(flat, np.where(inside, np.inf, -np.inf), leave)
        first = np.maximum(enter.max(axis=2), 0.0)
        last = np.minimum(leave.min(axis=2), 1.0)
        crossed = np.asarray(first < last, dtype=np.bool_)
        return np.logical_or.reduceat(crossed, self._first, axis=0) if len(self._first) else crossed
