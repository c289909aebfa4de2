"""Lines of sight between eyes and points that are near enough to each other."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled

__all__ = ["lines_in_range"]

Doubles = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


@compiled
def lines_in_range(
    eyes: Doubles, points: Doubles, first_eye: Indices, first_point: Indices, reach: Doubles
) -> tuple[Indices, Indices, Indices]:
    """Return the lines between eyes and points of t looks that are not too long, each by its number, its eye and its
    point. All lines of all looks are numbered, those of one eye after the other.

    Parameters
    ----------
    eyes, points : (n, 3) and (m, 3) float64, metres, those of all looks
    first_eye, first_point : (t + 1,) where those of each look begin
    reach : (t,) greatest squared length of a line of each look, square metres
    """
    most = 0
    for look in range(reach.shape[0]):
        most += (first_eye[look + 1] - first_eye[look]) * (first_point[look + 1] - first_point[look])
    lines, from_eye, to_point = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.int64)
    line = count = 0
    for look in range(reach.shape[0]):
        for eye in range(first_eye[look], first_eye[look + 1]):
            for point in range(first_point[look], first_point[look + 1]):
                x, y, z = (
                    points[point, 0] - eyes[eye, 0],
                    points[point, 1] - eyes[eye, 1],
                    points[point, 2] - eyes[eye, 2],
                )
                if x * x + y * y + z * z <= reach[look]:
                    lines[count], from_eye[count], to_point[count] = line, eye, point
                    count += 1
                line += 1
    return lines[:count].copy(), from_eye[:count].copy(), to_point[:count].copy()
