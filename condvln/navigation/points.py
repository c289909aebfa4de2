"""Check points given by callers and copy them into the arrays that kernels take."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.navigation.tile import Floats
from schemas.errors import UsageError

__all__ = ["many_points", "one_point", "paired_points"]

# The copies matter: numba compiles a kernel again for read-only arrays or another memory layout.


def one_point(point: npt.ArrayLike) -> Floats:
    """Return a point [x, y, z] as (1, 3) float32."""
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
    """Return starts and ends as (n, 3) each; a single point (3,), or one row, is paired with all on the other side."""
    first, second = (one_point(p) if np.ndim(p) == 1 and np.size(p) else many_points(p) for p in (starts, ends))
    if len(first) != len(second) and 1 not in (len(first), len(second)):
        raise UsageError(
            f"there are {len(first)} starts and {len(second)} ends", remedy="Give equal numbers, or one of either"
        )
    return first, second
