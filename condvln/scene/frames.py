"""Convert the coordinate frames of the sources to Habitat's (metres, right-handed, +Y up, −Z north)."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from condvln.scene.quaternions import rotation_x, rotation_y, rotation_z

__all__ = ["UNITY_TO_HABITAT", "Z_UP_TO_HABITAT", "asset_frame", "unity_point", "unity_rotation"]

F64 = NDArray[np.float64]

UNITY_TO_HABITAT: Final[F64] = np.diag([1.0, 1.0, -1.0])
"""Unity is left-handed with +Z forward: (x, y, z) → (x, y, −z). This mirrors, so polygon and face windings are
reversed.
"""

Z_UP_TO_HABITAT: Final[F64] = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""Matterport3D and Gibson: (x, y, z) → (x, z, −y)."""


def unity_point(x: float, y: float, z: float) -> F64:
    """Convert a position of Unity to one (3,) in Habitat's frame: the bits of a product with `UNITY_TO_HABITAT`, in a
    fraction of its time.
    """
    # Zeros are added so that none is negative, as in the product.
    return np.array([x + 0.0, y + 0.0, 0.0 - z])


def unity_rotation(euler_degrees: ArrayLike) -> F64:
    """Convert Unity's Euler angles (x, y, z), in degrees, to a rotation (3, 3) in Habitat's frame.

    Unity rotates about z, then x, then y, clockwise seen from the axis' tip (its frame is left-handed). In left-handed
    coordinates the matrices have their usual form; mirroring on both sides converts the rotation to Habitat's frame.
    """
    return _unity_rotation(np.asarray(euler_degrees, dtype=np.float64).tobytes()).copy()


@lru_cache(maxsize=4096)
def _unity_rotation(euler_degrees: bytes) -> F64:
    """Return what `unity_rotation` returns for angles (3,) float64; most objects of a house stand at one of few."""
    x, y, z = np.radians(np.frombuffer(euler_degrees))
    rotation: F64 = UNITY_TO_HABITAT @ (rotation_y(y) @ rotation_x(x) @ rotation_z(z)) @ UNITY_TO_HABITAT
    return rotation


def asset_frame(up: ArrayLike, front: ArrayLike) -> F64:
    """Return the (3, 3) rotation from an asset's own up and front directions to Habitat's up (+Y) and front (−Z).

    Equivalent to habitat-sim's ``CoordinateFrame::rotationFrameToWorld``.

    Raises
    ------
    ValueError : a direction is zero, or the two are not perpendicular
    """
    own = (np.asarray(v, dtype=np.float64) for v in (up, front))
    return _asset_frame(*(direction.tobytes() for direction in own)).copy()


@lru_cache(maxsize=64)
def _asset_frame(up: bytes, front: bytes) -> F64:
    """Return what `asset_frame` returns for two directions (3,) float64; most assets have the same two."""
    own_up, own_front = np.frombuffer(up), np.frombuffer(front)
    lengths = np.linalg.norm(own_up), np.linalg.norm(own_front)
    if not min(lengths) > 0:
        raise ValueError("'up' and 'front' must not be zero vectors")
    own_up, own_front = own_up / lengths[0], own_front / lengths[1]
    if abs(float(own_up @ own_front)) > 1e-4:
        raise ValueError("'up' and 'front' must be perpendicular")
    own = np.column_stack([np.cross(own_front, own_up), own_up, -own_front])
    rotation: F64 = own.T
    return rotation
