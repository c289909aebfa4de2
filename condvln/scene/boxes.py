"""Axis-aligned and oriented boxes, and 4×4 transforms."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from condvln.arrays import F64
from condvln.scene.rotations import stored_matrix, stored_quaternion
from condvln.scene.scene import OrientedBox, SceneObject, round_mm

__all__ = [
    "aabb_of",
    "box_corners",
    "corners",
    "oriented_box",
    "placement",
    "rounded_box",
    "transform_points",
    "with_box",
]


_SIGNS: Final = np.array(list(product((-1.0, 1.0), repeat=3)))
_IDENTITY: Final = np.eye(3)
_SHEAR: Final = 1e-6 + 1e-5 * _IDENTITY
"""(3, 3) largest difference of a rotation's RᵀR from the identity; where it is larger, the body is sheared."""


def placement(
    rotation: ArrayLike | None = None, translation: ArrayLike | None = None, scale: ArrayLike | None = None
) -> F64:
    """Return the (4, 4) transform that first scales (by one factor or three), then applies the rotation (3, 3), then
    the translation (3,) in metres.
    """
    matrix = np.eye(4)
    if rotation is not None:
        matrix[:3, :3] = rotation
    if scale is not None:
        matrix[:3, :3] *= np.asarray(scale, dtype=np.float64)
    if translation is not None:
        matrix[:3, 3] = translation
    return matrix


def transform_points(matrix: F64, points: ArrayLike) -> F64:
    """Return points (n, 3) transformed by a (4, 4) affine matrix."""
    moved: F64 = np.asarray(points, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def aabb_of(points: ArrayLike) -> F64:
    """Return the (2, 3) [min, max] of points (n, 3), n ≥ 1."""
    array = np.asarray(points, dtype=np.float64)
    return np.array([array.min(axis=0), array.max(axis=0)])


def corners(aabb: ArrayLike) -> F64:
    """Return the (8, 3) corners of an axis-aligned box (2, 3)."""
    box = np.asarray(aabb, dtype=np.float64)
    centre, half = (box[0] + box[1]) / 2, (box[1] - box[0]) / 2
    points: F64 = centre + _SIGNS * half
    return points


def box_corners(box: OrientedBox) -> F64:
    """Return the (8, 3) corners of an oriented box in the scene's frame."""
    points: F64 = box.center + (_SIGNS * box.half_extents) @ box.rotation.T
    return points


def oriented_box(local: ArrayLike, transform: F64) -> OrientedBox | None:
    """Convert a body's axis-aligned box `local` (2, 3), given in the body's own frame, to an oriented box in the
    scene's frame. Return None if `transform` shears the body.

    Scale along the body's axes goes into the half extents; mirroring gives the same box.
    """
    box = np.asarray(local, dtype=np.float64)
    linear = transform[:3, :3]
    scale = np.sqrt((linear * linear).sum(axis=0))
    if not (scale > 0).all():
        return None
    rotation = linear / scale
    if not (np.abs(rotation.T @ rotation - _IDENTITY) <= _SHEAR).all():
        return None
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    if a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) < 0:
        rotation = rotation * np.array([1.0, 1.0, -1.0])
    centre = transform_points(transform, (box[0] + box[1])[None] / 2)[0]
    return OrientedBox(centre, (box[1] - box[0]) / 2 * scale, rotation)


def with_box(item: SceneObject, box: OrientedBox) -> SceneObject:
    """Return the object with the oriented box and what follows from it: the upright box and the radius."""
    radius = float(np.ceil(np.linalg.norm(box.half_extents) * 1000) / 1000)
    return replace(item, aabb=round_mm(aabb_of(box_corners(box))), obb=rounded_box(box), radius=radius)


def rounded_box(box: OrientedBox) -> OrientedBox:
    """Return the box as it is stored: centre and half extents are rounded to 1 mm, and the rotation as a quaternion."""
    rotation = stored_matrix(stored_quaternion(box.rotation))
    return OrientedBox(round_mm(box.center), round_mm(box.half_extents), rotation)
