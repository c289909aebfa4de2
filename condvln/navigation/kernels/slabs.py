"""Lines of sight against boxes: the slab test (Kay & Kajiya 1986), one line at a time, until the first hit."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined

__all__ = ["blocked_looks"]

Doubles = npt.NDArray[np.float64]


@inlined
def _is_above(point: Doubles, center: Doubles, half: Doubles, axes: Doubles, headroom: float, touch: float) -> bool:
    """Return whether a point (3,) is directly above a box by at most ``headroom`` metres."""
    dx, dy, dz = point[0] - center[0], point[1] - center[1], point[2] - center[2]
    enter, leave = 0.0, headroom
    for i in range(3):
        begin = dx * axes[0, i] + dy * axes[1, i] + dz * axes[2, i]
        way = -axes[1, i]
        reach = half[i] + touch
        if abs(way) > 1e-12:
            one, other = (-reach - begin) / way, (reach - begin) / way
            enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
        elif abs(begin) > reach:
            return False
    return enter <= leave


@compiled
def blocked_looks(
    eyes: Doubles,
    points: Doubles,
    own: npt.NDArray[np.int64],
    centers: Doubles,
    half: Doubles,
    axes: Doubles,
    headroom: Doubles,
    touch: float,
) -> npt.NDArray[np.bool_]:
    """Return a mask (k,) of the lines of sight that at least one of the boxes blocks.

    A box that contains one of the ends blocks nothing, except the box that the point belongs to; a box with headroom
    also contains points up to that height above it. Hits within ``touch`` metres of an end do not count.

    Parameters
    ----------
    eyes, points : (k, 3) float64
    own : (k,) int64, index of the point's own box
    centers, half : (b, 3) float64; axes : (b, 3, 3) float64, columns the boxes' axes
    headroom : (b,) float64, metres
    """
    count = len(centers)
    out = np.zeros(len(eyes), np.bool_)
    begins = np.empty((count, 3), np.float64)  # the eye in each box's axes
    holds_eye = np.empty(count, np.bool_)
    of_eye = -1
    last = 0  # the box hit last: lines from one eye to one object often hit the same box
    for k in range(len(eyes)):
        x, y, z = points[k, 0] - eyes[k, 0], points[k, 1] - eyes[k, 1], points[k, 2] - eyes[k, 2]
        length = math.sqrt(x * x + y * y + z * z)
        if not length > touch:
            continue
        margin = touch / length
        if (
            of_eye < 0
            or eyes[k, 0] != eyes[of_eye, 0]
            or eyes[k, 1] != eyes[of_eye, 1]
            or eyes[k, 2] != eyes[of_eye, 2]
        ):
            for b in range(count):
                dx, dy, dz = eyes[k, 0] - centers[b, 0], eyes[k, 1] - centers[b, 1], eyes[k, 2] - centers[b, 2]
                inside = True
                for i in range(3):
                    begins[b, i] = dx * axes[b, 0, i] + dy * axes[b, 1, i] + dz * axes[b, 2, i]
                    inside = inside and abs(begins[b, i]) <= half[b, i] + touch
                holds_eye[b] = inside
            of_eye = k
        for number in range(count):
            b = last + number
            if b >= count:
                b -= count
            if holds_eye[b]:
                continue
            enter = -math.inf
            leave = math.inf
            holds_point = True
            for i in range(3):
                begin = begins[b, i]
                way = x * axes[b, 0, i] + y * axes[b, 1, i] + z * axes[b, 2, i]
                holds_point = holds_point and abs(begin + way) <= half[b, i] + touch
                if way != 0.0:
                    one = (-half[b, i] - begin) / way
                    other = (half[b, i] - begin) / way
                    enter = max(enter, min(one, other))
                    leave = min(leave, max(one, other))
                elif abs(begin) > half[b, i]:
                    leave = -math.inf  # the line passes beside the box
                # An overlap as thin as rounding does not count: the line only touches an edge.
                if not (enter < leave and leave > margin and enter < 1.0 - margin):
                    break
            else:
                if not holds_point and headroom[b] > 0.0:
                    holds_point = _is_above(points[k], centers[b], half[b], axes[b], headroom[b], touch)
                if not holds_point or own[k] == b:
                    out[k] = True
                    last = b
                    break
    return out
