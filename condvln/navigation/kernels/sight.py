"""Lines of sight against boxes: the slab test (Kay & Kajiya 1986), one line at a time, until the first hit."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined

__all__ = ["blocked_looks"]

Doubles = npt.NDArray[np.float64]

SLACK = 1e-6
"""Metres by which the bounds of a box are widened, so that rounding decides nothing."""


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


@inlined
def _bounds(centers: Doubles, half: Doubles, axes: Doubles) -> tuple[Doubles, Doubles]:
    """Return the lowest and the highest corner (b, 3) of each box, `SLACK` metres outside it."""
    low, high = np.empty((len(centers), 3)), np.empty((len(centers), 3))
    for b in range(len(centers)):
        for i in range(3):
            reach = SLACK
            for axis in range(3):
                reach += abs(axes[b, i, axis]) * half[b, axis]
            low[b, i], high[b, i] = centers[b, i] - reach, centers[b, i] + reach
    return low, high


@inlined
def _end_of_eye(eyes: Doubles, begin: int) -> int:
    """Return the end of the lines of sight that begin at the same eye as line `begin`."""
    end = begin + 1
    while (
        end < len(eyes)
        and eyes[end, 0] == eyes[begin, 0]
        and eyes[end, 1] == eyes[begin, 1]
        and eyes[end, 2] == eyes[begin, 2]
    ):
        end += 1
    return end


@inlined
def _near_boxes(
    eyes: Doubles,
    points: Doubles,
    begin: int,
    end: int,
    low: Doubles,
    high: Doubles,
    near: npt.NDArray[np.int64],
) -> int:
    """Write to `near` the boxes that the lines from `begin` to `end`, all of one eye, may meet; return their number.

    A line lies within the bounds of its ends, so a box meets none of the lines if it is beyond the bounds of all.
    """
    least, most = eyes[begin].copy(), eyes[begin].copy()
    for k in range(begin, end):
        for i in range(3):
            least[i], most[i] = min(least[i], points[k, i]), max(most[i], points[k, i])
    count = 0
    for b in range(len(low)):
        beyond = False
        for i in range(3):
            beyond = beyond or low[b, i] > most[i] or high[b, i] < least[i]
        if not beyond:
            near[count] = b
            count += 1
    return count


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
    low, high = _bounds(centers, half, axes)
    out = np.zeros(len(eyes), np.bool_)
    begins = np.empty((len(centers), 3), np.float64)  # the eye in the axes of each box near the lines
    near = np.empty(len(centers), np.int64)
    count = 0
    until = 0  # end of the lines that begin at the same eye
    last = 0  # the box hit last: lines from one eye to one object often hit the same box
    for k in range(len(eyes)):
        if k == until:
            until = _end_of_eye(eyes, k)
            count = _near_boxes(eyes, points, k, until, low, high, near)
            last = met = 0
            for place in range(count):
                b = near[place]
                dx, dy, dz = eyes[k, 0] - centers[b, 0], eyes[k, 1] - centers[b, 1], eyes[k, 2] - centers[b, 2]
                inside = True
                for i in range(3):
                    begins[met, i] = dx * axes[b, 0, i] + dy * axes[b, 1, i] + dz * axes[b, 2, i]
                    inside = inside and abs(begins[met, i]) <= half[b, i] + touch
                if not inside:  # a box around the eye blocks nothing
                    near[met] = b
                    met += 1
            count = met
        x, y, z = points[k, 0] - eyes[k, 0], points[k, 1] - eyes[k, 1], points[k, 2] - eyes[k, 2]
        length = math.sqrt(x * x + y * y + z * z)
        if not length > touch:
            continue
        margin = touch / length
        least_x, most_x = min(eyes[k, 0], points[k, 0]), max(eyes[k, 0], points[k, 0])
        least_y, most_y = min(eyes[k, 1], points[k, 1]), max(eyes[k, 1], points[k, 1])
        least_z, most_z = min(eyes[k, 2], points[k, 2]), max(eyes[k, 2], points[k, 2])
        for number in range(count):
            place = last + number
            if place >= count:
                place -= count
            b = near[place]
            # Most boxes are beside the line: comparing bounds is cheaper than the slabs, and decides no other way.
            if least_x > high[b, 0] or most_x < low[b, 0] or least_z > high[b, 2] or most_z < low[b, 2]:
                continue
            if least_y > high[b, 1] or most_y < low[b, 1]:
                continue
            enter = -math.inf
            leave = math.inf
            holds_point = True
            for i in range(3):
                begin = begins[place, i]
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
                    last = place
                    break
    return out
