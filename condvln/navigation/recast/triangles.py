"""The input of a build: checked vertices and faces, and which faces are level enough to walk on."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.navigation.recast.arrays import Array
from schemas.errors import FormatError

__all__ = ["WALKABLE_AREA", "checked_triangles", "walkable_faces"]

# Recast's area id of a walkable surface.
WALKABLE_AREA = 63


def checked_triangles(vertices: npt.ArrayLike, faces: npt.ArrayLike) -> tuple[Array, Array]:
    """Return vertices as (n, 3) float32 and faces as (m, 3) int32, in the given order.

    Raises
    ------
    FormatError
        The shapes are wrong, there is no triangle, a vertex is NaN or infinite, or an index is out of range.
    """
    points = np.asarray(vertices)
    corners = np.asarray(faces)
    if (
        points.ndim != 2
        or points.shape[1] != 3
        or not np.issubdtype(points.dtype, np.number)
        or np.iscomplexobj(points)
    ):
        raise FormatError(
            f"vertices can't be {points.dtype} of shape {points.shape}",
            place="vertices",
            remedy="Give (n, 3) numbers in metres",
        )
    if corners.size == 0:
        raise FormatError(
            "the mesh has no triangles",
            place="faces",
            remedy="Check that the file holds geometry and not only empty nodes",
        )
    if corners.ndim != 2 or corners.shape[1] != 3 or not np.issubdtype(corners.dtype, np.integer):
        raise FormatError(
            f"faces can't be {corners.dtype} of shape {corners.shape}",
            place="faces",
            remedy="Give (m, 3) integer indices",
        )
    with np.errstate(over="ignore"):
        points = np.require(points, np.float32, ["C", "W"])  # kernels are compiled for plain arrays only
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        where = int(np.argmax(bad))
        raise FormatError(
            f"{int(bad.sum())} of {len(points)} vertices are NaN, infinite or beyond float32",
            place=f"vertex {where}",
            remedy="Repair or remove them",
        )
    bad = ((corners < 0) | (corners >= len(points))).any(axis=1)
    if bad.any():
        where = int(np.argmax(bad))
        raise FormatError(
            f"face {corners[where].tolist()} refers to a vertex outside 0..{len(points) - 1}",
            place=f"face {where}",
            remedy="Repair the mesh; indices count from 0",
        )
    return points, np.require(corners, np.int32, ["C", "W"])


def walkable_faces(vertices: Array, faces: Array, least_upward: np.float32) -> Array:
    """Return the area id of each face, (m,) uint8: WALKABLE_AREA if the unit normal's y exceeds ``least_upward``, else
    0.

    Follows ``rcMarkWalkableTriangles`` of Recast, in float32 throughout. A degenerate face has no normal and is not
    walkable.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    with np.errstate(all="ignore"):
        u, v = b - a, c - a
        x = u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1]
        y = u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2]
        z = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        upward = y * (np.float32(1) / np.sqrt((x * x + y * y) + z * z))
        return np.where(upward > least_upward, np.uint8(WALKABLE_AREA), np.uint8(0))
