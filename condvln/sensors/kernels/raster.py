"""Rasterize triangles: for each pixel the nearest front face and its inverse depth.

There is no clipping. With the eye at the origin, a ray ``d`` meets the triangle (a, b, c) where ``d·(a×b)``,
``d·(b×c)`` and ``d·(c×a)`` have the same sign (Olano and Greer 1997: homogeneous edge functions); corners behind the
eye need no special case. Two triangles that share an edge compute the same numbers with opposite signs, so no ray
passes between them. Depths are compared by their inverses, which are linear in the image.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined

__all__ = ["rasterize"]

Doubles = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]

SLACK = 1e-3
"""Tolerance in pixels of a triangle's bounds; the edge functions decide."""


@inlined
def _blocks_in_view(
    lows: Floats, highs: Floats, eye: Doubles, axes: Doubles, tan_x: float, tan_y: float, near: float
) -> npt.NDArray[np.int64]:
    """Return the blocks of triangles whose bounding boxes intersect the camera's view, nearest first."""
    found = np.empty(len(lows), np.int64)
    nearness = np.empty(len(lows))
    count = 0
    for block in range(len(lows)):
        cx = (lows[block, 0] + highs[block, 0]) * 0.5 - eye[0]
        cy = (lows[block, 1] + highs[block, 1]) * 0.5 - eye[1]
        cz = (lows[block, 2] + highs[block, 2]) * 0.5 - eye[2]
        hx = (highs[block, 0] - lows[block, 0]) * 0.5 + 1e-5
        hy = (highs[block, 1] - lows[block, 1]) * 0.5 + 1e-5
        hz = (highs[block, 2] - lows[block, 2]) * 0.5 + 1e-5
        # Distance ahead of the eye: minus the third axis.
        ahead = -(cx * axes[0, 2] + cy * axes[1, 2] + cz * axes[2, 2])
        reach = hx * abs(axes[0, 2]) + hy * abs(axes[1, 2]) + hz * abs(axes[2, 2])
        if ahead + reach < near:
            continue
        outside = False
        for axis in range(2):
            slope = tan_x if axis == 0 else tan_y
            for sign in (-1.0, 1.0):
                # A point is inside where slope * ahead + sign * across >= 0.
                nx = -slope * axes[0, 2] + sign * axes[0, axis]
                ny = -slope * axes[1, 2] + sign * axes[1, axis]
                nz = -slope * axes[2, 2] + sign * axes[2, axis]
                if cx * nx + cy * ny + cz * nz + hx * abs(nx) + hy * abs(ny) + hz * abs(nz) < 0:
                    outside = True
        if not outside:
            found[count] = block
            nearness[count] = ahead - reach
            count += 1
    return found[:count][np.argsort(nearness[:count], kind="mergesort")]


@inlined
def _image_bounds(v: Doubles, near: float, tan_x: float, tan_y: float) -> tuple[float, float, float, float]:
    """Return the bounds in the image (least x, greatest x, least y, greatest y) of that part of the triangle `v` which
    is in front of the near plane. The unit is half the image's width for x, and half its height for y.
    """
    left, right, bottom, top = math.inf, -math.inf, math.inf, -math.inf
    for i in range(3):
        j = (i + 1) % 3
        depth, other = -v[i, 2], -v[j, 2]
        if depth >= near:
            x, y = v[i, 0] / (depth * tan_x), v[i, 1] / (depth * tan_y)
            left, right, bottom, top = min(left, x), max(right, x), min(bottom, y), max(top, y)
        if (depth >= near) != (other >= near):
            part = (near - depth) / (other - depth)
            x = (v[i, 0] + part * (v[j, 0] - v[i, 0])) / (near * tan_x)
            y = (v[i, 1] + part * (v[j, 1] - v[i, 1])) / (near * tan_y)
            left, right, bottom, top = min(left, x), max(right, x), min(bottom, y), max(top, y)
    return left, right, bottom, top


@compiled
def rasterize(
    corners: Floats,
    lows: Floats,
    highs: Floats,
    block_size: int,
    eye: Doubles,
    axes: Doubles,
    columns: Doubles,
    rows: Doubles,
    tan_x: float,
    tan_y: float,
    near: float,
    inverse: Floats,
    face: Ints,
) -> None:
    """Draw triangles into two images: `inverse` (h, w), the inverse depth of each pixel, and `face` (h, w), the index
    of the nearest front face at each pixel.

    corners : (m, 3, 3) triangles, counter-clockwise seen from outside; others are not drawn
    lows, highs : (b, 3) bounds of each block of `block_size` triangles
    eye : (3,) in the triangles' frame; axes : (3, 3), its columns right, up and back
    columns (w,), rows (h,) : x and y of the pixels' centres at depth 1
    inverse : on entry the inverse of the far depth; face : on entry −1; nearer faces overwrite both
    Of two faces at the same depth the one with the lower index is drawn.
    """
    height, width = inverse.shape
    nearest = 1.0 / near
    v = np.empty((3, 3))
    m = np.empty((3, 3))
    for block in _blocks_in_view(lows, highs, eye, axes, tan_x, tan_y, near):
        for f in range(block * block_size, min((block + 1) * block_size, len(corners))):
            for i in range(3):
                px = corners[f, i, 0] - eye[0]
                py = corners[f, i, 1] - eye[1]
                pz = corners[f, i, 2] - eye[2]
                for k in range(3):
                    v[i, k] = px * axes[0, k] + py * axes[1, k] + pz * axes[2, k]
            if v[0, 2] > -near and v[1, 2] > -near and v[2, 2] > -near:
                continue
            ax, ay, az = v[1, 0] - v[0, 0], v[1, 1] - v[0, 1], v[1, 2] - v[0, 2]
            bx, by, bz = v[2, 0] - v[0, 0], v[2, 1] - v[0, 1], v[2, 2] - v[0, 2]
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            distance = v[0, 0] * nx + v[0, 1] * ny + v[0, 2] * nz
            if not distance < 0.0:
                continue  # back face, or seen edge-on
            left, right, bottom, top = _image_bounds(v, near, tan_x, tan_y)
            x_from = max(0.0, np.ceil((left + 1.0) * 0.5 * width - 0.5 - SLACK))
            x_to = min(width - 1.0, np.floor((right + 1.0) * 0.5 * width - 0.5 + SLACK))
            y_from = max(0.0, np.ceil((1.0 - top) * 0.5 * height - 0.5 - SLACK))
            y_to = min(height - 1.0, np.floor((1.0 - bottom) * 0.5 * height - 0.5 + SLACK))
            if not (x_from <= x_to and y_from <= y_to):
                continue
            # A ray d = (x, y, -1) is inside if d·m is at least 0 for all three.
            for i in range(3):
                j = (i + 1) % 3
                m[i, 0] = v[j, 1] * v[i, 2] - v[j, 2] * v[i, 1]
                m[i, 1] = v[j, 2] * v[i, 0] - v[j, 0] * v[i, 2]
                m[i, 2] = v[j, 0] * v[i, 1] - v[j, 1] * v[i, 0]
            slope = nx / distance
            for y in range(int(y_from), int(y_to) + 1):
                dy = rows[y]
                c0 = m[0, 1] * dy - m[0, 2]
                c1 = m[1, 1] * dy - m[1, 2]
                c2 = m[2, 1] * dy - m[2, 2]
                first, last = x_from, x_to
                for i in range(3):
                    c = c0 if i == 0 else (c1 if i == 1 else c2)
                    if m[i, 0] > 0.0:
                        bound = (-c / (m[i, 0] * tan_x) + 1.0) * 0.5 * width - 0.5
                        first = max(first, np.ceil(bound - SLACK))
                    elif m[i, 0] < 0.0:
                        bound = (-c / (m[i, 0] * tan_x) + 1.0) * 0.5 * width - 0.5
                        last = min(last, np.floor(bound + SLACK))
                    elif c < 0.0:
                        last = -1.0
                if first > last:
                    continue
                begin, end = int(first), int(last)
                # The bounds are rounded; neighbouring triangles agree on the edge functions only.
                while begin <= end and (
                    m[0, 0] * columns[begin] + c0 < 0.0
                    or m[1, 0] * columns[begin] + c1 < 0.0
                    or m[2, 0] * columns[begin] + c2 < 0.0
                ):
                    begin += 1
                while begin <= end and (
                    m[0, 0] * columns[end] + c0 < 0.0
                    or m[1, 0] * columns[end] + c1 < 0.0
                    or m[2, 0] * columns[end] + c2 < 0.0
                ):
                    end -= 1
                offset = (ny * dy - nz) / distance
                for x in range(begin, end + 1):
                    w = slope * columns[x] + offset
                    near_by = np.float32(w)
                    if near_by >= inverse[y, x] and w <= nearest and (near_by > inverse[y, x] or f < face[y, x]):
                        inverse[y, x] = near_by
                        face[y, x] = f
