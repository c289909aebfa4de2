"""Points that callers give, checked and copied into the arrays that kernels take; seeded uniform points on the floor.

Detour's ``findRandomPoint`` uses libc's ``rand``, whose sequence can't be reproduced elsewhere. Its distribution can be
reproduced: choose a polygon by its area in the ground plane, then a uniform point inside it.

Paths are densified as ground truth for nDTW requires: nDTW depends on the sampling of its reference: a perfect walk in
0.25 m steps scores 0 against the corners only, and 1 against points 0.25 m apart.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.navigation.kernels.mesh import QueryMesh, clamp_to_polygon
from condvln.navigation.kernels.projection import ground_areas, points_on_polygons
from condvln.navigation.tile import Floats
from schemas.config.constants import PATH_SPACING
from schemas.errors import InputError, UsageError

__all__ = ["RandomSource", "Sampler", "densify", "densify_many", "many_points", "one_point", "paired_points"]

# Tolerance in units of the spacing, so that a segment of 2.5000000001 m is ten steps and not eleven.
_SLACK: Final = 1e-6

Array = npt.NDArray[np.float64]


def densify(points: npt.ArrayLike, spacing: float = PATH_SPACING) -> Array:
    """Return points along a polyline: its corners, with each segment divided evenly into parts of at most ``spacing``
    metres.

    Parameters
    ----------
    points : (n, 3) corners, metres, n ≥ 1
    spacing : metres

    Returns
    -------
    dense : (m, 3); corners equal to their predecessor are dropped
    """
    corners = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    return densify_many(corners, np.array([0, len(corners)], dtype=np.int64), spacing)[0]


def densify_many(
    points: Array, offsets: npt.NDArray[np.integer[Any]], spacing: float = PATH_SPACING
) -> tuple[Array, npt.NDArray[np.int64]]:
    """Densify many polylines, stored consecutively, as :func:`densify` does.

    Parameters
    ----------
    points : (n, 3) corners of all polylines
    offsets : (p + 1,) polyline ``i`` is ``points[offsets[i]:offsets[i + 1]]``

    Returns
    -------
    dense : (m, 3); offsets : (p + 1,) of the dense polylines
    """
    starts = np.asarray(offsets, dtype=np.int64)
    if len(points) == 0:
        return np.zeros((0, 3)), np.zeros(len(starts), dtype=np.int64)
    # A point starts the segment to its successor; the last point of a polyline starts one of length zero, kept as one
    # point.
    following = np.minimum(np.arange(1, len(points) + 1), len(points) - 1)
    is_last = np.zeros(len(points), dtype=bool)
    is_last[starts[1:][np.diff(starts) > 0] - 1] = True
    span = np.where(is_last[:, None], 0.0, points[following] - points)
    pieces = np.ceil(np.sqrt((span * span).sum(axis=1)) / spacing - _SLACK).astype(np.int64)
    pieces[is_last] = 1
    total = np.concatenate(([0], np.cumsum(pieces)))
    within = np.arange(total[-1]) - np.repeat(total[:-1], pieces)
    # Repeating rows takes half of the time of taking them by their numbers.
    dense = np.repeat(span, pieces, axis=0)
    dense *= (within / np.repeat(pieces, pieces))[:, None]
    dense += np.repeat(points, pieces, axis=0)
    return dense, total[starts]


# The copies matter: numba compiles a kernel again for read-only arrays or another memory layout.


def one_point(point: npt.ArrayLike) -> Floats:
    """Return a single point [x, y, z] as a float32 array of one row, (1, 3)."""
    array = np.array(point, np.float32, order="C")
    if array.shape != (3,):
        raise UsageError(f"a point must have the shape (3,), got {array.shape}", remedy="Give [x, y, z]")
    return array.reshape(1, 3)


def many_points(points: npt.ArrayLike) -> Floats:
    """Return points (n, 3) as float32; an empty list gives (0, 3)."""
    array = np.array(points, np.float32, order="C")
    if array.size == 0:
        return array.reshape(0, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        raise UsageError(f"points must have the shape (n, 3), got {array.shape}", remedy="Give a list of [x, y, z]")
    return array


def paired_points(starts: npt.ArrayLike, ends: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Return starts and ends as float32 arrays of rows, (n, 3) each. Either side may be a single point, (3,) or (1, 3),
    which becomes one row and is paired with all points of the other side.
    """
    first, second = (one_point(p) if np.ndim(p) == 1 and np.size(p) else many_points(p) for p in (starts, ends))
    if len(first) != len(second) and 1 not in (len(first), len(second)):
        raise UsageError(
            f"there are {len(first)} starts and {len(second)} ends",
            remedy="Give equal numbers of both, a single start or a single end",
        )
    return first, second


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
        """Return a random point (3,) that is uniform over the floor within ``radius`` metres of ``centre``. The point
        is NaN if none of ``max_tries`` draws is within the radius."""
        weights = self._weights_of(island) * self._within(centre, radius)
        nothing = np.full(3, np.nan, np.float32)
        if weights.sum() <= 0:
            return nothing
        tries = self._draw(max_tries, np.random.default_rng(rng), weights)
        near = np.linalg.norm(tries - centre, axis=1) <= radius
        return tries[np.argmax(near)] if near.any() else nothing

    def _weights_of(self, island: int | None) -> npt.NDArray[np.float64]:
        weights = self._weights if island is None else self._weights * (self._mesh.island == island)
        if weights.sum() <= 0:
            raise InputError("there is no floor to draw a point from", remedy="Choose another island or navmesh")
        return weights

    def _within(self, centre: Floats, radius: float) -> npt.NDArray[np.bool_]:
        near = [clamp_to_polygon(self._mesh, poly, tuple(centre)) for poly in range(len(self._weights))]
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
