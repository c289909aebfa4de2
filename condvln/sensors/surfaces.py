"""The triangles of a scene for rendering, with owners and materials, sorted along a space-filling curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.sensors.textures import Texels, stored

__all__ = ["BLOCK", "Material", "SurfaceBuilder", "Surfaces"]

BLOCK: Final = 64
"""Triangles per culling block."""
CURVE_BITS: Final = 10
"""Cells of the curve along each axis, as a power of two."""

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Material:
    """A surface material.

    factor : red, green and blue in [0, 1]; multiplied with texture and vertex colours
    texture : number of the texture, −1 for none
    wrap : wrap mode beyond the texture's border, horizontal and vertical: 0 repeats, 1 clamps to the edge, 2 mirrors
    """

    factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: int = -1
    wrap: tuple[int, int] = (0, 0)


@dataclass(frozen=True, eq=False, slots=True)
class Surfaces:
    """m triangles, counter-clockwise seen from outside. Each triangle's corners are stored separately, not shared by
    index.

    corners : (m, 3, 3) metres in Habitat's frame, relative to `origin` (3,)
    owner : (m,) index into the scene's ``objects`` of each triangle's object, `STRUCTURE` if it has none
    coordinates : (m, 3, 2) texture coordinates; (0, 0) is the upper left corner
    colours : (m, 3, 3) vertex colours, 255 for white
    material : (m,) index into `factors` (k, 3), `texture` (k,) and `wraps` (k, 2), see `Material`
    lows, highs : bounds of each block of `BLOCK` triangles, relative to `origin`
    notes : known deviations from a real view
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
    texture_bytes : memory used by the textures so far
    """

    def __init__(self) -> None:
        self._pieces: list[tuple[F64, int, Floats | None, Bytes | None, Ints]] = []
        self._materials: list[Material] = []
        self._number: dict[Material, int] = {}
        self._pictures: list[list[Bytes]] = []
        self.texture_bytes = 0

    def texture(self, levels: list[Bytes]) -> int:
        """Add a texture, given by its mipmap levels, and return its number."""
        self._pictures.append(levels)
        self.texture_bytes += sum(level.size for level in levels)
        return len(self._pictures) - 1

    def material(self, material: Material) -> int:
        """Return the number of a material; equal materials share a number."""
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
        """Add triangles (n, 3, 3), in metres, that belong to one owner; `material` is one number for all triangles, or
        one for each (n,).
        """
        numbers = np.broadcast_to(np.asarray(material, np.int32), len(corners))
        self._pieces.append((np.asarray(corners, np.float64), owner, coordinates, colours, numbers))

    def surfaces(self, notes: Sequence[str] = ()) -> Surfaces:
        """Return all triangles, materials and textures that were added."""
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
    """Return the indices that sort the triangles by the Morton code of their centres, so that triangles with similar
    indices are close together in space. The sort is stable.

    Large triangles come first, since they have no single location.
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
