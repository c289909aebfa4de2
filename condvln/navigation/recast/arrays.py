"""The array types of the kernels, and growth of arrays whose final length is unknown."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled

__all__ = ["Array", "Ground", "Point", "ground", "grown", "grown_rows", "point"]

# Kernels do integer and float32 arithmetic on array elements; each docstring names the dtype it expects.
Array: TypeAlias = npt.NDArray[Any]
# A point as kernels pass it: plain numbers, since a view of an array row would be reference-counted at each call.
Ground: TypeAlias = "tuple[Any, Any]"
Point: TypeAlias = "tuple[Any, Any, Any]"


@compiled
def grown(array: Array, needed: int) -> Array:
    """Return ``array`` itself if it has room for ``needed`` items, else a copy of at least twice its length."""
    if needed <= len(array):
        return array
    larger = np.empty(max(needed, 2 * len(array)), array.dtype)
    larger[: len(array)] = array
    return larger


@compiled
def grown_rows(array: Array, needed: int) -> Array:
    """Return ``array`` itself if it has room for ``needed`` rows, else a copy of at least twice as many rows."""
    if needed <= len(array):
        return array
    larger = np.empty((max(needed, 2 * len(array)), array.shape[1]), array.dtype)
    # Value by value: to compile an assignment of a table takes numba 2 to 3 seconds, for the message that the shapes
    # differ.
    for row in range(len(array)):
        for column in range(array.shape[1]):
            larger[row, column] = array[row, column]
    return larger


@compiled
def ground(points: Array, i: int) -> Ground:
    """Return x and z of the point in row i."""
    return points[i, 0], points[i, 2]


@compiled
def point(points: Array, i: int) -> Point:
    """Return x, y and z of the point in row i."""
    return points[i, 0], points[i, 1], points[i, 2]
