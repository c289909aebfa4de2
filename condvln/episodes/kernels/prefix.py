"""Where paths from one start part, and points at equal distances along a path.

The numbers are those of NumPy's ``interp``, ``arange`` and ``linspace``, bit for bit.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, register_warm_up

__all__ = ["shared_beginning", "spaced_points"]

Doubles = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


@compiled
def _walked(corners: Doubles, begin: int, end: int, lengths: Doubles) -> float:
    """Write to ``lengths`` the metres walked at each of the corners ``begin`` to ``end`` of a path; return the last
    one.
    """
    walked = 0.0
    lengths[begin] = 0.0
    for k in range(begin + 1, end):
        dx = corners[k, 0] - corners[k - 1, 0]
        dy = corners[k, 1] - corners[k - 1, 1]
        dz = corners[k, 2] - corners[k - 1, 2]
        walked += math.sqrt(dx * dx + dy * dy + dz * dz)
        lengths[k] = walked
    return walked


@compiled
def _place(corners: Doubles, lengths: Doubles, end: int, at: float, before: int, place: Doubles) -> int:
    """Write to ``place`` (3,) the point of a path at which ``at`` metres are walked; return the last corner that is
    not after it. The search begins at the corner ``before``, which is not after it.
    """
    while before + 1 < end and lengths[before + 1] <= at:
        before += 1
    for axis in range(3):
        place[axis] = corners[before, axis]
    if before + 1 < end and lengths[before] != at:
        for axis in range(3):
            slope = (corners[before + 1, axis] - corners[before, axis]) / (lengths[before + 1] - lengths[before])
            place[axis] = slope * (at - lengths[before]) + corners[before, axis]
    return before


@compiled
def shared_beginning(corners: Doubles, first: Indices, step: float, stray: float) -> Doubles:
    """Return the shared beginning (n, 3) of p paths from one start; at least the start itself.

    Paths are compared each ``step`` metres of their walked length, and at the end of the shortest one. The beginning
    ends before the first of these places at which two paths are farther than ``stray`` metres apart.

    corners : (c, 3) metres, those of all paths
    first : (p + 1,) first corner of each path
    """
    paths = first.shape[0] - 1
    lengths = np.empty(corners.shape[0])
    shortest = math.inf
    for path in range(paths):
        shortest = min(shortest, _walked(corners, first[path], first[path + 1], lengths))
    before, places, last = first[:-1].copy(), np.empty((paths, 3)), np.empty(3)
    samples = math.ceil(shortest / step) + 1
    walked = 0.0
    for sample in range(samples):
        at = sample * step if sample + 1 < samples else shortest
        for path in range(paths):
            before[path] = _place(corners, lengths, first[path + 1], at, before[path], places[path])
        apart = False
        for one in range(paths):
            for other in range(one):
                dx = places[one, 0] - places[other, 0]
                dy = places[one, 1] - places[other, 1]
                dz = places[one, 2] - places[other, 2]
                apart = apart or math.sqrt(dx * dx + dy * dy + dz * dz) > stray
        if apart and sample > 0:
            break
        walked = at
        last[:] = places[0]
        if apart:
            break
    found = np.empty((first[1] + 2, 3))
    found[0] = corners[0]
    count = 1
    for k in range(first[1]):
        if 0.0 < lengths[k] < walked:
            found[count] = corners[k]
            count += 1
    found[count] = last
    return found[: count + 1]


@compiled
def spaced_points(path: Doubles, spacing: float) -> Doubles:
    """Return points (n, 3) along a polyline at equal distances of at most ``spacing`` metres, both ends included."""
    lengths = np.empty(path.shape[0])
    whole = _walked(path, 0, path.shape[0], lengths)
    count = max(1, math.ceil(whole / spacing))
    found, before = np.empty((count + 1, 3)), 0
    for k in range(count + 1):
        at = k * (whole / count) if k < count else whole
        before = _place(path, lengths, path.shape[0], at, before, found[k])
    return found


def _warm_up() -> None:
    spaced_points(shared_beginning(np.eye(3), np.array([0, 2, 3]), 1.0, 1.0), 1.0)


register_warm_up("beginnings of paths", _warm_up)
