"""Rotations (quaternions in both component orders, Euler angles, 3×3 matrices), and the sources' frames in Habitat's:
metres, right-handed, +Y up, −Z north.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from condvln.arrays import F64

__all__ = [
    "UNITY_TO_HABITAT",
    "Z_UP_TO_HABITAT",
    "asset_frame",
    "from_matrix",
    "from_wxyz",
    "heading_of",
    "rotation_rpy",
    "rotation_x",
    "rotation_y",
    "rotation_z",
    "round_quaternion",
    "stored_matrix",
    "stored_quaternion",
    "to_matrix",
    "unity_rotation",
]


MIN_NORM = 1e-6
"""Least norm of a quaternion; a shorter one has no direction."""


QUATERNION_DECIMALS: Final = 9
"""Decimals kept of a stored component; the rounding error is far below 1 mm over a building."""

_MAX_ROUNDS: Final = 64


def to_matrix(xyzw: ArrayLike) -> F64:
    """Return the (3, 3) rotation of a non-zero quaternion ``[x, y, z, w]``; column k is the image of axis k.

    Raises
    ------
    ValueError : the quaternion is zero or not finite
    """
    q = np.asarray(xyzw, dtype=np.float64)
    norm = float(np.linalg.norm(q))
    if not MIN_NORM < norm < math.inf:
        raise ValueError(f"the quaternion {q.tolist()} is not a rotation")
    x, y, z, w = q / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def from_wxyz(wxyz: ArrayLike) -> F64:
    """Convert a quaternion from the order of Habitat's scene files, ``[w, x, y, z]``, to ``[x, y, z, w]``."""
    xyzw: F64 = np.asarray(wxyz, dtype=np.float64)[[1, 2, 3, 0]]
    return xyzw


def from_matrix(rotation: ArrayLike) -> F64:
    """Return the unit quaternion ``[x, y, z, w]`` of a (3, 3) rotation; its largest component is positive.

    Shepperd's method (1978): dividing by the largest of the four components loses no precision.
    """
    m = np.asarray(rotation, dtype=np.float64)
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    squares = np.array([1 + 2 * m[0, 0] - trace, 1 + 2 * m[1, 1] - trace, 1 + 2 * m[2, 2] - trace, 1 + trace])
    k = int(np.argmax(squares))
    products = np.array(
        [
            [squares[0], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
            [m[1, 0] + m[0, 1], squares[1], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]],
            [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], squares[2], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]],
        ]
    )
    q: F64 = products[k] / np.linalg.norm(products[k])
    return q


def round_quaternion(xyzw: ArrayLike) -> F64:
    """Return the quaternion rounded to `QUATERNION_DECIMALS`, such that converting it to a matrix and back gives the
    same rounded quaternion.

    Rounding changes the norm and normalising changes the digits, so both are repeated until nothing changes.
    """
    q = _rounded(np.asarray(xyzw, dtype=np.float64))
    for _ in range(_MAX_ROUNDS):
        again = _rounded(from_matrix(to_matrix(q)))
        if (again == q).all():
            break
        q = again
    return q


def stored_quaternion(rotation: F64) -> tuple[float, float, float, float]:
    """Return a (3, 3) rotation as the rounded quaternion ``x, y, z, w`` that is stored for it."""
    x, y, z, w = round_quaternion(from_matrix(rotation)).tolist()
    return x, y, z, w


def stored_matrix(xyzw: tuple[float, float, float, float]) -> F64:
    """Return the (3, 3) rotation of a stored quaternion ``x, y, z, w``."""
    return to_matrix(xyzw)


def _rounded(q: F64) -> F64:
    return np.asarray(np.round(q, QUATERNION_DECIMALS) + 0.0, dtype=np.float64)


def heading_of(xyzw: Sequence[float] | F64) -> float:
    """Return the heading in radians, counter-clockwise from −z, of a rotation ``[x, y, z, w]`` about +y."""
    return 2.0 * math.atan2(xyzw[1], xyzw[3]) % (2.0 * math.pi)


def rotation_x(angle: float) -> F64:
    """Return the (3, 3) rotation by `angle` radians about +X, counter-clockwise seen from the axis' tip."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])


def rotation_y(angle: float) -> F64:
    """Return the (3, 3) rotation by `angle` radians about +Y, counter-clockwise seen from the axis' tip."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0, s], [0, 1.0, 0], [-s, 0, c]])


def rotation_z(angle: float) -> F64:
    """Return the (3, 3) rotation by `angle` radians about +Z, counter-clockwise seen from the axis' tip."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def rotation_rpy(roll: float, pitch: float, yaw: float) -> F64:
    """Return the (3, 3) rotation by URDF's roll, pitch and yaw in radians: about fixed X, then Y, then Z."""
    rotation: F64 = rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll)
    return rotation


UNITY_TO_HABITAT: Final[F64] = np.diag([1.0, 1.0, -1.0])
"""Unity is left-handed with +Z forward: (x, y, z) → (x, y, −z). This mirrors, so polygon and face windings are
reversed.
"""

Z_UP_TO_HABITAT: Final[F64] = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""Matterport3D and Gibson: (x, y, z) → (x, z, −y)."""


def unity_rotation(euler_degrees: ArrayLike) -> F64:
    """Convert Unity's Euler angles (x, y, z), in degrees, to a rotation (3, 3) in Habitat's frame.

    Unity rotates about z, then x, then y, clockwise seen from the axis' tip (its frame is left-handed). In left-handed
    coordinates the matrices have their usual form; mirroring on both sides converts the rotation to Habitat's frame.
    """
    x, y, z = np.radians(np.asarray(euler_degrees, dtype=np.float64))
    rotation: F64 = UNITY_TO_HABITAT @ (rotation_y(y) @ rotation_x(x) @ rotation_z(z)) @ UNITY_TO_HABITAT
    return rotation


def asset_frame(up: ArrayLike, front: ArrayLike) -> F64:
    """Return the (3, 3) rotation from an asset's own up and front directions to Habitat's up (+Y) and front (−Z).

    Equivalent to habitat-sim's ``CoordinateFrame::rotationFrameToWorld``.

    Raises
    ------
    ValueError : a direction is zero, or the two are not perpendicular
    """
    own_up, own_front = (np.asarray(v, dtype=np.float64) for v in (up, front))
    lengths = np.linalg.norm(own_up), np.linalg.norm(own_front)
    if not min(lengths) > 0:
        raise ValueError("'up' and 'front' must not be zero vectors")
    own_up, own_front = own_up / lengths[0], own_front / lengths[1]
    if abs(float(own_up @ own_front)) > 1e-4:
        raise ValueError("'up' and 'front' must be perpendicular")
    own = np.column_stack([np.cross(own_front, own_up), own_up, -own_front])
    rotation: F64 = own.T
    return rotation
