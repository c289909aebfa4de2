"""The array type of the kernels, and growth of arrays whose final length is not known beforehand."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled

__all__ = ["Array", "Ground", "Point", "ground", "grown", "grown_rows", "point"]

# Kernels do integer and float32 arithmetic on array elements; each docstring names the dtype it expects.
Array: TypeAlias = npt.NDArray[Any]
# A point as kernels pass it around: plain numbers. (A view of an array's row would be counted in and out at each call.)
Ground: TypeAlias = "tuple[Any, Any]"
Point: TypeAlias = "tuple[Any, Any, Any]"


@compiled
def grown(array: Array, needed: int) -> Array:
    """``array`` itself if it holds ``needed`` items, else a copy of at least twice its length."""
    if needed <= len(array):
        return array
    larger = np.empty(max(needed, 2 * len(array)), array.dtype)
    larger[: len(array)] = array
    return larger


@compiled
def grown_rows(array: Array, needed: int) -> Array:
    """The same for the rows of a two-dimensional array."""
    if needed <= len(array):
        return array
    larger = np.empty((max(needed, 2 * len(array)), array.shape[1]), array.dtype)
    larger[: len(array)] = array
    return larger


@compiled
def ground(points: Array, i: int) -> Ground:
    """x and z of row i."""
    return points[i, 0], points[i, 2]


@compiled
def point(points: Array, i: int) -> Point:
    """x, y and z of row i."""
    return points[i, 0], points[i, 1], points[i, 2]
