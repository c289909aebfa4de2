"""Check points given by callers and copy them into the arrays that kernels take."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.navigation.tile import Floats
from schemas.errors import UsageError

__all__ = ["many_points", "one_point", "paired_points"]

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
