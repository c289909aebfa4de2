"""Seeded sample points on the surface of an object, for visibility tests.

The points depend only on surface, count and seed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from condvln.arrays import F64
from schemas.errors import UsageError

__all__ = ["DEFAULT_SAMPLES", "box_samples", "mesh_samples"]


DEFAULT_SAMPLES = 64
"""Number of points per object: all miss a visible twentieth of its surface once in 27 times."""

# The six faces of a unit box from -1 to 1: the axis perpendicular to each, and its sign.
_FACE_AXIS = np.array([0, 0, 1, 1, 2, 2])
_FACE_SIDE = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
_OTHER_AXES = np.array([[1, 2], [0, 2], [0, 1]])[_FACE_AXIS]


def box_samples(
    center: npt.ArrayLike,
    half_extents: npt.ArrayLike,
    rotation: npt.ArrayLike | None = None,
    count: int = DEFAULT_SAMPLES,
    seed: int = 0,
) -> F64:
    """Return points (count, 3) on the faces of a box, distributed by area. The points of a flat box are on its two
    large faces.

    Parameters
    ----------
    center, half_extents : (3,) metres
    rotation : (3, 3), its columns the box's axes; None for an axis-aligned box

    Raises
    ------
    UsageError : an extent is negative or not finite, or ``count`` below 1
    """
    middle, half = (np.asarray(values, np.float64) for values in (center, half_extents))
    axes = np.eye(3) if rotation is None else np.asarray(rotation, np.float64)
    if middle.shape != (3,) or half.shape != (3,) or axes.shape != (3, 3):
        raise UsageError(f"a box needs shapes (3,), (3,) and (3, 3), got {middle.shape}, {half.shape} and {axes.shape}")
    if not (np.isfinite([middle, half, *axes]).all() and (half >= 0).all()):
        raise UsageError(
            f"a box has a number that is NaN or infinite, or a negative extent: centre {middle}, half extents {half}"
        )
    area = half[_OTHER_AXES].prod(axis=1)
    if not area.any():  # degenerate box (a line or a point): any face will do
        area = np.ones(6)
    slices, drawn = _draws(count, seed, "box")
    face, place = _by_area(area, slices), drawn.copy()
    place[np.arange(count), _FACE_AXIS[face]] = _FACE_SIDE[face]
    points: F64 = middle + (place * half) @ axes.T
    return points


def mesh_samples(vertices: npt.ArrayLike, faces: npt.ArrayLike, count: int = DEFAULT_SAMPLES, seed: int = 0) -> F64:
    """Return points (count, 3) on a triangle mesh, distributed by area.

    Parameters
    ----------
    vertices : (n, 3) metres
    faces : (m, 3) int, m > 0, every index below n

    Raises
    ------
    UsageError : there is no triangle, or ``count`` is below 1
    """
    corners = np.asarray(vertices, np.float64)[np.asarray(faces, np.int64).reshape(-1, 3)]
    if not len(corners) or not np.isfinite(corners).all():
        raise UsageError("the mesh has no triangles, or vertices that are not finite")
    along, across = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(along, across), axis=1)
    if not area.any():
        area = np.ones(len(corners))
    slices, drawn = _draws(count, seed, "mesh")
    face, (u, v) = _by_area(area, slices), drawn
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points: F64 = corners[face, 0] + u * along[face] + v * across[face]
    return points


def _by_area(area: F64, slices: F64) -> npt.NDArray[np.int64]:
    """Choose a face for each of the random points, in proportion to the areas of the faces. Return the indices of the
    faces. `slices` (n,) are shares of the total area, one in each of n equal parts.
    """
    upto = np.cumsum(area)
    chosen = np.searchsorted(upto, slices * upto[-1], side="right")
    return np.asarray(np.minimum(chosen, len(area) - 1), dtype=np.int64)


@lru_cache(maxsize=64)
def _draws(count: int, seed: int, kind: Literal["box", "mesh"]) -> tuple[F64, F64]:
    """Return the random numbers of ``count`` points, which are equal for all surfaces: a share of the total area for
    each (n,), in one of n equal parts each, and where the point lies on its face: (n, 3) from -1 to 1 for a box, twice
    (n, 1) from 0 to 1 for a mesh.
    """
    if count < 1:
        raise UsageError(f"the number of samples must be positive, got {count}", remedy="Request at least one")
    rng = np.random.default_rng(seed)
    slices = (np.arange(count) + rng.uniform(0.0, 1.0, count)) / count
    drawn = rng.uniform(-1.0, 1.0, (count, 3)) if kind == "box" else rng.uniform(0.0, 1.0, (2, count, 1))
    for array in (slices, drawn):
        array.flags.writeable = False
    return slices, drawn
