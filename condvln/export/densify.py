"""Densify paths, as ground truth for nDTW requires.

nDTW depends on the sampling of its reference: a perfect walk in 0.25 m steps scores 0 against the corners only, and 1
against points 0.25 m apart.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from schemas.config.constants import PATH_SPACING

__all__ = ["densify", "densify_many"]

# Tolerance in units of the spacing, so that a segment of 2.5000000001 m is ten steps and not eleven.
_SLACK: Final = 1e-6

Array = npt.NDArray[np.float64]


def densify(points: npt.ArrayLike, spacing: float = PATH_SPACING) -> Array:
    """Return points along a polyline: its corners, with each segment divided evenly into parts of at most ``spacing``
    metres.

    Parameters
    ----------
    points : (n, 3) corners, metres, n ≥ 1
    spacing : metres

    Returns
    -------
    dense : (m, 3); corners equal to their predecessor are dropped
    """
    corners = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    return densify_many(corners, np.array([0, len(corners)], dtype=np.int64), spacing)[0]


def densify_many(
    points: Array, offsets: npt.NDArray[np.integer[Any]], spacing: float = PATH_SPACING
) -> tuple[Array, npt.NDArray[np.int64]]:
    """Densify many polylines, stored consecutively, as :func:`densify` does.

    Parameters
    ----------
    points : (n, 3) corners of all polylines
    offsets : (p + 1,) polyline ``i`` is ``points[offsets[i]:offsets[i + 1]]``

    Returns
    -------
    dense : (m, 3); offsets : (p + 1,) of the dense polylines
    """
    starts = np.asarray(offsets, dtype=np.int64)
    if len(points) == 0:
        return np.zeros((0, 3)), np.zeros(len(starts), dtype=np.int64)
    # A point starts the segment to its successor; the last point of a polyline starts one of length zero, kept as one
    # point.
    following = np.minimum(np.arange(1, len(points) + 1), len(points) - 1)
    is_last = np.zeros(len(points), dtype=bool)
    is_last[starts[1:][np.diff(starts) > 0] - 1] = True
    span = np.where(is_last[:, None], 0.0, points[following] - points)
    pieces = np.ceil(np.sqrt((span * span).sum(axis=1)) / spacing - _SLACK).astype(np.int64)
    pieces[is_last] = 1
    total = np.concatenate(([0], np.cumsum(pieces)))
    within = np.arange(total[-1]) - np.repeat(total[:-1], pieces)
    # Repeating rows takes half of the time of taking them by their numbers.
    dense = np.repeat(span, pieces, axis=0)
    dense *= (within / np.repeat(pieces, pieces))[:, None]
    dense += np.repeat(points, pieces, axis=0)
    return dense, total[starts]
