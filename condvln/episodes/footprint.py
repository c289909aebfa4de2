"""The floor area an object stands over, as a rectangle in the XZ plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from condvln.scene import SceneObject
from schemas.config.constants import UPRIGHT_COSINE

__all__ = ["Footprint", "Footprints"]

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class Footprint:
    """center (2,) as (x, z); half (2,) extents; axes (2, 2), its rows the rectangle's unit axes. Metres."""

    center: F64
    half: F64
    axes: F64

    @classmethod
    def of(cls, item: SceneObject) -> Footprint | None:
        """The tightest rectangle known of `item`: its upright oriented box, else its AABB; None without extent."""
        if item.obb is not None:
            vertical = np.abs(item.obb.rotation[1])
            up = int(np.argmax(vertical))
            if vertical[up] >= UPRIGHT_COSINE:
                sides = [k for k in range(3) if k != up]
                axes = item.obb.rotation[np.ix_([0, 2], sides)].T
                axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
                return cls(item.obb.center[[0, 2]], item.obb.half_extents[sides], axes)
        if item.aabb is None:
            return None
        low, high = item.aabb[0][[0, 2]], item.aabb[1][[0, 2]]
        return cls((low + high) / 2, (high - low) / 2, np.eye(2))

    @property
    def half_perimeter(self) -> float:
        """Half of the rectangle's perimeter in metres."""
        return float(2.0 * self.half.sum())

    def distance(self, points: F64) -> F64:
        """Horizontal distance (n,) from points (n, 3) to the rectangle; 0 inside."""
        local = np.abs((points[:, [0, 2]] - self.center) @ self.axes.T) - self.half
        return np.asarray(np.hypot(*np.maximum(local, 0.0).T), dtype=np.float64)

    def ring(self, offset: float, spacing: float) -> F64:
        """Points (n, 2) on the curve at `offset` metres outside the rectangle, at most `spacing` apart."""
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

    def __init__(self, boxes: Sequence[Footprint]) -> None:
        self._center = np.array([box.center for box in boxes]).reshape(-1, 1, 2)
        self._half = np.array([box.half for box in boxes]).reshape(-1, 1, 2)
        self._axes = np.array([box.axes for box in boxes]).reshape(-1, 2, 2).swapaxes(1, 2)

    def __len__(self) -> int:
        return len(self._center)

    def crossings(self, starts: F64, ends: F64) -> NDArray[np.bool_]:
        """(m, n): which of the m rectangles' insides each horizontal segment (n, 3)–(n, 3) passes through."""
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
        return np.asarray(first < last, dtype=np.bool_)
