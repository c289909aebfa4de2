"""Seeded uniform sampling of the floor.

Detour's ``findRandomPoint`` uses libc's ``rand``, whose sequence can't be reproduced elsewhere. Its distribution can be
reproduced: choose a polygon by its area in the ground plane, then a uniform point inside it.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.navigation.kernels.geometry import clamp_to_polygon
from condvln.navigation.kernels.mesh import QueryMesh
from condvln.navigation.kernels.sampling import ground_areas, points_on_polygons
from condvln.navigation.tile import Floats
from schemas.errors import InputError

__all__ = ["RandomSource", "Sampler"]

RandomSource: TypeAlias = np.random.Generator | int

# Rounding can put a drawn point off its polygon; then it is drawn again. If this many rounds fail, the mesh has only
# slivers.
MAX_REDRAWS = 100


class Sampler:
    """Random points on one mesh."""

    def __init__(self, mesh: QueryMesh) -> None:
        self._mesh = mesh
        self._weights = ground_areas(mesh).astype(np.float64)

    def draw(self, count: int, rng: RandomSource, island: int | None = None) -> Floats:
        """Return ``count`` uniform points (count, 3) on the mesh or on one island.

        Raises
        ------
        InputError : there is no floor to draw from
        """
        points = self._draw(count, np.random.default_rng(rng), self._weights_of(island))
        if np.isnan(points).any():
            raise InputError("the polygons are too thin to draw a point from", remedy="Rebuild the navmesh")
        return points

    def draw_near(self, centre: Floats, radius: float, rng: RandomSource, max_tries: int, island: int | None) -> Floats:
        """Return a random point (3,) that is uniform over the floor within ``radius`` metres of ``centre`` in the
        ground plane. The point is NaN if none of ``max_tries`` draws is within the radius."""
        weights = self._weights_of(island) * self._within(centre, radius)
        nothing = np.full(3, np.nan, np.float32)
        if weights.sum() <= 0:
            return nothing
        tries = self._draw(max_tries, np.random.default_rng(rng), weights)
        near = np.hypot(tries[:, 0] - centre[0], tries[:, 2] - centre[2]) < radius
        return tries[np.argmax(near)] if near.any() else nothing

    def _weights_of(self, island: int | None) -> npt.NDArray[np.float64]:
        weights = self._weights if island is None else self._weights * (self._mesh.island == island)
        if weights.sum() <= 0:
            raise InputError("there is no floor to draw a point from", remedy="Choose another island or navmesh")
        return weights

    def _within(self, centre: Floats, radius: float) -> npt.NDArray[np.bool_]:
        corners = self._mesh.verts, self._mesh.poly_verts, self._mesh.poly_size
        near = [clamp_to_polygon(*corners, poly, *centre) for poly in range(len(self._weights))]
        return np.array([np.hypot(x - centre[0], z - centre[2]) < radius for x, _, z in near], bool)

    def _draw(self, count: int, rng: np.random.Generator, weights: npt.NDArray[np.float64]) -> Floats:
        reach = np.cumsum(weights)
        points = np.full((count, 3), np.nan, np.float32)
        for _ in range(MAX_REDRAWS):
            missing = np.flatnonzero(np.isnan(points[:, 0]))
            if not len(missing):
                break
            draws = rng.random((len(missing), 3))
            polys = np.searchsorted(reach, draws[:, 0] * reach[-1], side="right")
            polys = np.minimum(polys, np.flatnonzero(weights)[-1]).astype(np.int64)
            picks, spreads = draws[:, 1].astype(np.float32), draws[:, 2].astype(np.float32)
            points[missing] = points_on_polygons(self._mesh, polys, picks, spreads)
        return points
