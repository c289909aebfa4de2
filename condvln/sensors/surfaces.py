"""What a camera looks at: the triangles of a scene with their owners and materials, sorted along a curve in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.sensors.textures import Texels, stored

__all__ = ["BLOCK", "Material", "SurfaceBuilder", "Surfaces"]

BLOCK: Final = 64
"""Triangles that are left out of a view together."""
CURVE_BITS: Final = 10
"""Cells of the curve along each axis, as a power of two."""

F64 = NDArray[np.float64]
Floats = NDArray[np.float32]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Material:
    """factor : red, green and blue, 0 to 1, that texture and vertex colours are multiplied by
    texture : number of the texture, −1 for none
    wrap : how the texture goes on beyond its border, sideways and up: 0 repeats it, 1 holds its edge, 2 mirrors it
    """

    factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: int = -1
    wrap: tuple[int, int] = (0, 0)


@dataclass(frozen=True, eq=False, slots=True)
class Surfaces:
    """Triangles (m), counter-clockwise seen from outside, each with corners of its own.

    corners : (m, 3, 3) metres in Habitat's frame, from `origin` (3,)
    owner : (m,) index into the scene's ``objects`` of what a triangle belongs to, `STRUCTURE` where to none
    coordinates : (m, 3, 2) of the texture, (0, 0) its upper left corner
    colours : (m, 3, 3) vertex colours, 255 for white
    material : (m,) index into `factors` (k, 3), `texture` (k,) and `wraps` (k, 2), see `Material`
    lows, highs : bounds of each `BLOCK` triangles, from `origin`
    notes : what is not as it would be seen, for whoever reads the images
    """

    corners: Floats
    origin: F64
    owner: Ints
    coordinates: Floats
    colours: Bytes
    material: Ints
    factors: Floats
    texture: Ints
    wraps: Ints
    texels: Texels
    lows: Floats
    highs: Floats
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Surfaces({len(self.corners)} triangles, {len(self.texels.levels)} textures)"


class SurfaceBuilder:
    """Collects triangles, materials and textures.

    Attributes
    ----------
    texture_bytes : what the textures take so far
    """

    def __init__(self) -> None:
        self._pieces: list[tuple[F64, int, Floats | None, Bytes | None, Ints]] = []
        self._materials: list[Material] = []
        self._number: dict[Material, int] = {}
        self._pictures: list[list[Bytes]] = []
        self.texture_bytes = 0

    def texture(self, levels: list[Bytes]) -> int:
        """Takes in a texture, by its levels; gives its number."""
        self._pictures.append(levels)
        self.texture_bytes += sum(level.size for level in levels)
        return len(self._pictures) - 1

    def material(self, material: Material) -> int:
        """The number of a material; equal ones have the same."""
        if material not in self._number:
            self._number[material] = len(self._materials)
            self._materials.append(material)
        return self._number[material]

    def add(
        self,
        corners: F64,
        owner: int,
        material: int | NDArray[Any],
        coordinates: Floats | None = None,
        colours: Bytes | None = None,
    ) -> None:
        """Takes in triangles (n, 3, 3) of one owner, metres; the material is one for all, or (n,)."""
        numbers = np.broadcast_to(np.asarray(material, np.int32), len(corners))
        self._pieces.append((np.asarray(corners, np.float64), owner, coordinates, colours, numbers))

    def surfaces(self, notes: Sequence[str] = ()) -> Surfaces:
        """All that was taken in."""
        corners = np.concatenate([np.zeros((0, 3, 3)), *(p[0] for p in self._pieces)])
        origin = np.round(corners.reshape(-1, 3).mean(axis=0)) if len(corners) else np.zeros(3)
        corners = (corners - origin).astype(np.float32)
        coordinates = np.concatenate(
            [np.zeros((0, 3, 2), np.float32)]
            + [np.zeros((len(p[0]), 3, 2), np.float32) if p[2] is None else p[2] for p in self._pieces]
        )
        colours = np.concatenate(
            [np.zeros((0, 3, 3), np.uint8)]
            + [np.full((len(p[0]), 3, 3), 255, np.uint8) if p[3] is None else p[3] for p in self._pieces]
        )
        owner = np.repeat(np.array([p[1] for p in self._pieces], np.int32), [len(p[0]) for p in self._pieces])
        material = np.concatenate([np.zeros(0, np.int32), *(p[4] for p in self._pieces)])
        order = _along_curve(corners)
        corners = np.ascontiguousarray(corners[order])
        lows, highs = _bounds(corners)
        return Surfaces(
            corners=corners,
            origin=origin,
            owner=owner[order],
            coordinates=np.ascontiguousarray(coordinates[order], np.float32),
            colours=np.ascontiguousarray(colours[order]),
            material=material[order],
            factors=np.array([m.factor for m in self._materials], np.float32).reshape(-1, 3),
            texture=np.array([m.texture for m in self._materials], np.int32),
            wraps=np.array([m.wrap for m in self._materials], np.int32).reshape(-1, 2),
            texels=stored(self._pictures),
            lows=lows,
            highs=highs,
            notes=tuple(dict.fromkeys(notes)),
        )


def _along_curve(corners: Floats) -> NDArray[np.int64]:
    """An order in which neighbours follow each other: by the Morton number of a triangle's middle, then as they came.

    Large triangles come first, as they belong to no place.
    """
    if not len(corners):
        return np.zeros(0, np.int64)
    low, high = corners.min(axis=1), corners.max(axis=1)
    middle = (low + high) / 2
    start, extent = middle.min(axis=0), np.ptp(middle, axis=0)
    cells = ((middle - start) / np.maximum(extent, 1e-9) * ((1 << CURVE_BITS) - 1)).astype(np.int64)
    key = np.zeros(len(corners), np.int64)
    for bit in range(CURVE_BITS):
        for axis in range(3):
            key |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    large = (high - low).max(axis=1) > max(float(extent.max()) / 8, 1e-9)
    return np.lexsort((np.arange(len(corners)), key, ~large))


def _bounds(corners: Floats) -> tuple[Floats, Floats]:
    starts = np.arange(0, len(corners), BLOCK)
    if not len(starts):
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    low = np.minimum.reduceat(corners.min(axis=1), starts)
    high = np.maximum.reduceat(corners.max(axis=1), starts)
    return low, high
