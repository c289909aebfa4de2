"""Whether the triangle that a ray meets first lies before the ray's target."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled

__all__ = ["blocked_rays"]

Doubles = npt.NDArray[np.float64]


@compiled
def blocked_rays(
    eyes: Doubles,
    direction: Doubles,
    distance: Doubles,
    triangles: Doubles,
    first: npt.NDArray[np.int64],
    touch: float,
) -> npt.NDArray[np.bool_]:
    """Return a mask (k,) of the rays that meet their triangle more than ``touch`` metres before their target.

    The distance along a ray is that to the plane of the triangle, limited to the range of the triangle's corners along
    the ray; for a ray parallel to the plane it is the farthest corner.

    Parameters
    ----------
    eyes, direction : (k, 3) origins in metres and unit vectors; distance : (k,) metres to the targets
    triangles : (m, 3, 3) corners in metres
    first : (k,) index of the triangle that each ray meets first, -1 for none
    """
    out = np.zeros(len(eyes), np.bool_)
    for k in range(len(eyes)):
        if first[k] < 0:
            continue
        a, b, c = triangles[first[k], 0], triangles[first[k], 1], triangles[first[k], 2]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        x, y, z = direction[k, 0], direction[k, 1], direction[k, 2]
        away = nx * (a[0] - eyes[k, 0]) + ny * (a[1] - eyes[k, 1]) + nz * (a[2] - eyes[k, 2])
        t = away / (nx * x + ny * y + nz * z)
        nearest, farthest = math.inf, -math.inf
        for corner in range(3):
            p = triangles[first[k], corner]
            along = (p[0] - eyes[k, 0]) * x + (p[1] - eyes[k, 1]) * y + (p[2] - eyes[k, 2]) * z
            nearest, farthest = min(nearest, along), max(farthest, along)
        if not math.isfinite(t):
            t = farthest
        out[k] = min(max(t, nearest), farthest) < distance[k] - touch
    return out
