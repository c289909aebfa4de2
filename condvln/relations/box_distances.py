"""Distances of oriented boxes in closed form.

Boxes are not measured with FCL's triangle hierarchies: FCL's distance of two coplanar triangles is sometimes wrongly 0,
and a flat box has such triangles (its sides have no area).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["box_distances"]

F64 = NDArray[np.float64]

SIGNS: Final = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
"""(8, 3) signs of the corners: corner k has the sign of bit 2 for x, of bit 1 for y, of bit 0 for z."""

PAIRS_AT_ONCE: Final = 4096
"""Pairs of boxes per block; a block takes about 50 MB of temporaries."""

PARALLEL: Final = 1e-12
"""Sine of the angle below which two edges count as parallel; a corner then gives their distance."""

# The four edges along each axis begin at the corners whose sign on that axis is negative.
_EDGE_STARTS: Final = np.array([np.flatnonzero(SIGNS[:, axis] < 0) for axis in range(3)])


def box_distances(first: tuple[F64, F64, F64], second: tuple[F64, F64, F64]) -> F64:
    """Return the distances (p,) in metres between the boxes of p pairs; 0 where they overlap or one contains the other.

    first, second : centers (p, 3), half extents (p, 3), both in metres, extents may be 0; rotations (p, 3, 3) with the
        boxes' axes as columns

    Two boxes are apart if one of 15 axes separates them (Gottschalk, Lin and Manocha, 1996). The least distance is then
    that of a corner to the other box, or of two edges at interior points of both.
    """
    count = len(first[0])
    found = np.empty(count)
    for start in range(0, count, PAIRS_AT_ONCE):
        part = slice(start, start + PAIRS_AT_ONCE)
        found[part] = _distances(*(array[part] for array in first), *(array[part] for array in second))
    return found


def _distances(a: F64, half_a: F64, axes_a: F64, b: F64, half_b: F64, axes_b: F64) -> F64:
    between = b - a
    normals = _cross(axes_a.transpose(0, 2, 1)[:, :, None], axes_b.transpose(0, 2, 1)[:, None])  # (p, 3, 3, 3)
    sines = np.linalg.norm(normals, axis=-1)
    skew = sines > PARALLEL
    normals = normals / np.where(skew, sines, 1.0)[..., None]
    axes = np.concatenate(
        [axes_a.transpose(0, 2, 1), axes_b.transpose(0, 2, 1), normals.reshape(len(a), 9, 3)], axis=1
    )  # (p, 15, 3)
    reach = np.einsum("pki,pij->pkj", np.abs(axes @ axes_a), half_a[:, :, None])[..., 0]
    reach += np.einsum("pki,pij->pkj", np.abs(axes @ axes_b), half_b[:, :, None])[..., 0]
    gap = (np.abs(np.einsum("pki,pi->pk", axes, between)) - reach).max(axis=1)

    corners_a = a[:, None] + (SIGNS * half_a[:, None]) @ axes_a.transpose(0, 2, 1)
    corners_b = b[:, None] + (SIGNS * half_b[:, None]) @ axes_b.transpose(0, 2, 1)
    least = np.minimum(_corners_to_box(corners_a, b, half_b, axes_b), _corners_to_box(corners_b, a, half_a, axes_a))
    for i in range(3):
        for j in range(3):
            edges = _edges(
                corners_a[:, _EDGE_STARTS[i]],
                axes_a[:, :, i] * 2 * half_a[:, i, None],
                corners_b[:, _EDGE_STARTS[j]],
                axes_b[:, :, j] * 2 * half_b[:, j, None],
                normals[:, i, j],
            )
            least = np.minimum(least, np.where(skew[:, i, j], edges, np.inf))
    distances: F64 = np.where(gap > 0.0, least, 0.0)
    return distances


def _cross(one: F64, other: F64) -> F64:
    """Return the vector product (…, 3) of vectors (…, 3), with less ado than NumPy's."""
    x, y, z = (one[..., k] for k in range(3))
    u, v, w = (other[..., k] for k in range(3))
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def _corners_to_box(corners: F64, center: F64, half: F64, axes: F64) -> F64:
    """Return, for each of p pairs of boxes, the least distance (p,) from one of the `corners` (p, 8, 3) of the first
    box to the second box.
    """
    beyond = np.maximum(np.abs((corners - center[:, None]) @ axes) - half[:, None], 0.0)
    least: F64 = np.linalg.norm(beyond, axis=-1).min(axis=1)
    return least


def _edges(from_a: F64, along_a: F64, from_b: F64, along_b: F64, normal: F64) -> F64:
    """Return, for each of p pairs of boxes, the least distance (p,) between four edges of one box and four edges of the
    other. Two edges count only if the points at which their lines are nearest to each other lie on the edges; the
    distance is infinite if no two edges count.

    from_a, from_b : (p, 4, 3) where they begin; along_a, along_b : (p, 3) vectors to their ends
    normal : (p, 3) perpendicular to both
    """
    between = from_b[:, None] - from_a[:, :, None]  # (p, 4, 4, 3)
    side_a, side_b = _cross(along_b, normal), _cross(along_a, normal)
    # Seen along the normal, the lines cross where the rest of `between` is s along_a - t along_b.
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.einsum("pijk,pk->pij", between, side_a) / (along_a * side_a).sum(axis=1)[:, None, None]
        t = -np.einsum("pijk,pk->pij", between, side_b) / (along_b * side_b).sum(axis=1)[:, None, None]
    inside = (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    apart = np.abs(np.einsum("pijk,pk->pij", between, normal))
    least: F64 = np.where(inside, apart, np.inf).min(axis=(1, 2))
    return least
