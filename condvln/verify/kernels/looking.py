"""Where points on surfaces lie, and which of them are in the range and field of view of eyes, for many targets."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import compiled, register_warm_up

__all__ = ["in_front", "in_range", "spread"]

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]


@compiled
def in_range(eyes: F64, points: F64, eye_ends: I64, point_ends: I64, slopes: F64, reach: float) -> tuple[I64, I64, I64]:
    """Return the lines of sight from the eyes of each of t targets to the target's points that are at most `reach`
    metres long and not too steep.

    eyes (n, 3), points (m, 3) : of all targets, concatenated; eye_ends, point_ends (t,) : end index of each target's
    slopes (t,) : largest height of a line by its length on the ground; infinite if lines may be of any slope

    The results (k,) are the index of each line among all pairs of an eye and a point of one target, eye by eye; its
    eye; and its point.
    """
    pairs = 0
    for target in range(len(eye_ends)):
        first_eye = eye_ends[target - 1] if target else 0
        first_point = point_ends[target - 1] if target else 0
        pairs += (eye_ends[target] - first_eye) * (point_ends[target] - first_point)
    lines = np.empty((3, pairs), dtype=np.int64)
    count, pair = 0, 0
    for target in range(len(eye_ends)):
        for eye in range(eye_ends[target - 1] if target else 0, eye_ends[target]):
            for point in range(point_ends[target - 1] if target else 0, point_ends[target]):
                x, y = points[point, 0] - eyes[eye, 0], points[point, 1] - eyes[eye, 1]
                z = points[point, 2] - eyes[eye, 2]
                if x * x + y * y + z * z <= reach * reach and (
                    slopes[target] == np.inf or abs(y) <= math.hypot(x, z) * slopes[target]
                ):
                    lines[0, count], lines[1, count], lines[2, count] = pair, eye, point
                    count += 1
                pair += 1
    return lines[0, :count], lines[1, :count], lines[2, :count]


@compiled
def in_front(eye: F64, points: F64, sine: float, cosine: float, reach: float, aside: float, above: float) -> Bools:
    """Return which points (n, 3) are at most `reach` metres from an eye (3,) and in its field of view.

    sine, cosine : of the heading, counter-clockwise from −z; aside, above : tangents of half the angles of view
    """
    found = np.empty(len(points), dtype=np.bool_)
    for at in range(len(points)):
        x, y, z = points[at, 0] - eye[0], points[at, 1] - eye[1], points[at, 2] - eye[2]
        ahead = -x * sine - z * cosine
        across = x * cosine - z * sine
        near = x * x + y * y + z * z <= reach * reach
        found[at] = near and abs(across) <= ahead * aside and abs(y) <= ahead * above
    return found


@compiled
def spread(triangles: F64, share: F64, root: F64, part: F64) -> F64:
    """Return points (n, 3) on triangles (m, 3, 3): each in the triangle that its `share` (n,) of the area falls in, and
    there at the place that `root` (n,) and `part` (n,) say.
    """
    count = len(triangles)
    upto = np.empty(count)
    for flat in range(2):
        total = 0.0
        for at in range(count):
            ax, ay, az = triangles[at, 1] - triangles[at, 0]
            bx, by, bz = triangles[at, 2] - triangles[at, 0]
            x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            total += 1.0 if flat else math.sqrt(x * x + y * y + z * z)
            upto[at] = total
        if total != 0.0:  # else the triangles are lines or points
            break
    points = np.empty((len(share), 3))
    for number in range(len(share)):
        face = min(np.searchsorted(upto, share[number] * total, side="right"), count - 1)
        for axis in range(3):
            first = triangles[face, 0, axis]
            along, across = triangles[face, 1, axis] - first, triangles[face, 2, axis] - first
            points[number, axis] = first + root[number] * ((1.0 - part[number]) * along + part[number] * across)
    return points


def _warm_up() -> None:
    corner, ends = np.zeros((1, 3)), np.ones(1, np.int64)
    in_range(corner, corner, ends, ends, np.ones(1), 1.0)
    in_front(corner[0], corner, 0.0, 1.0, 1.0, 1.0, 1.0)
    spread(np.eye(3)[None], np.zeros(1), np.zeros(1), np.zeros(1))


register_warm_up("looks of the verifier", _warm_up)
