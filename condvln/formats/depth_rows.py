"""Rows of a 16-bit PNG file from depth in metres: rounded to millimetres, and filtered, in one pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import compiled, register_warm_up

__all__ = ["UP", "filtered_rows"]

UP = 2
"""PNG's filter that stores the difference to the byte above."""
MILLIMETRES = np.float32(1000)
"""Levels of a depth image for each metre."""
MOST = np.float32(65535)
"""Highest level of 16 bits."""


@compiled
def filtered_rows(depth: NDArray[np.float32], rows: NDArray[np.uint8]) -> None:
    """Fill `rows` (h, 1 + 2 w) with the rows of a PNG file, each filtered by `UP`.

    depth : (h, w) metres; rounded to millimetres, half to even, and limited to 0 to 65.535 m
    """
    height, width = depth.shape
    high = np.zeros(width, np.uint8)
    low = np.zeros(width, np.uint8)
    for y in range(height):
        rows[y, 0] = UP
        for x in range(width):
            level = np.uint16(min(max(np.rint(depth[y, x] * MILLIMETRES), np.float32(0)), MOST))
            above, below = np.uint8(level >> np.uint16(8)), np.uint8(level & np.uint16(255))
            rows[y, 1 + 2 * x] = above - high[x]
            rows[y, 2 + 2 * x] = below - low[x]
            high[x] = above
            low[x] = below


register_warm_up("depth images", lambda: filtered_rows(np.zeros((1, 1), np.float32), np.empty((1, 3), np.uint8)))
