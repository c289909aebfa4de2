"""Rasterize triangles, and shade the faces seen: texture, material factor and vertex colour, without lighting.

For each pixel the nearest front face and its inverse depth are found. There is no clipping. With the eye at the origin,
a ray ``d`` meets the triangle (a, b, c) where ``d·(a×b)``, ``d·(b×c)`` and ``d·(c×a)`` have the same sign (Olano and
Greer 1997: homogeneous edge functions); corners behind the eye need no special case. Two triangles that share an edge
compute the same numbers with opposite signs, so no ray passes between them. Depths are compared by their inverses,
which are linear in the image.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined

__all__ = ["CLAMP", "rasterize", "shade"]

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


Bytes = npt.NDArray[np.uint8]

CLAMP, MIRROR = 1, 2
"""Wrap modes of a texture beyond its border; 0 repeats it."""


@compiled
def _wrapped(index: int, size: int, mode: int) -> int:
    """Return `index` along one side of a texture as a valid index, 0 to `size` − 1: an index beyond the border is
    mapped back by the wrap mode.
    """
    if 0 <= index < size:
        return index
    if mode == CLAMP:
        return 0 if index < 0 else size - 1
    if mode == MIRROR:
        index %= 2 * size
        return index if index < size else 2 * size - 1 - index
    return index % size


@compiled
def shade(
    face: Ints,
    corners: Floats,
    eye: Doubles,
    axes: Doubles,
    columns: Doubles,
    rows: Doubles,
    coordinates: Floats,
    colours: Bytes,
    material: Ints,
    factors: Floats,
    texture: Ints,
    wraps: Ints,
    first_level: Ints,
    levels: Ints,
    offsets: npt.NDArray[np.int64],
    widths: Ints,
    heights: Ints,
    texels: Bytes,
    rgb: Bytes,
) -> None:
    """Fill `rgb` (h, w, 3); black where `face` is −1. The parameters are those of `rasterize` and of `Surfaces`.

    Texture lookup follows OpenGL: bilinear in the mipmap level whose texels are closest to the pixel's size.
    """
    height, width = face.shape
    step_x = columns[1] - columns[0] if width > 1 else 0.0
    step_y = rows[1] - rows[0] if height > 1 else 0.0
    v = np.empty((3, 3))
    m = np.empty((3, 3))
    # Cached for the last face: linear forms over (x, y, -1), namely the weight and each attribute times the weight.
    forms = np.zeros((6, 3))
    known = -1
    for y in range(height):
        for x in range(width):
            f = face[y, x]
            if f < 0:
                rgb[y, x, 0] = rgb[y, x, 1] = rgb[y, x, 2] = 0
                continue
            own = material[f]
            tex = texture[own]
            if f != known:
                known = f
                for i in range(3):
                    px = corners[f, i, 0] - eye[0]
                    py = corners[f, i, 1] - eye[1]
                    pz = corners[f, i, 2] - eye[2]
                    for k in range(3):
                        v[i, k] = px * axes[0, k] + py * axes[1, k] + pz * axes[2, k]
                for i in range(3):
                    j, k = (i + 1) % 3, (i + 2) % 3
                    m[i, 0] = v[k, 1] * v[j, 2] - v[k, 2] * v[j, 1]
                    m[i, 1] = v[k, 2] * v[j, 0] - v[k, 0] * v[j, 2]
                    m[i, 2] = v[k, 0] * v[j, 1] - v[k, 1] * v[j, 0]
                for k in range(3):
                    forms[0, k] = m[0, k] + m[1, k] + m[2, k]
                    for c in range(2):
                        forms[1 + c, k] = (
                            m[0, k] * coordinates[f, 0, c]
                            + m[1, k] * coordinates[f, 1, c]
                            + m[2, k] * coordinates[f, 2, c]
                        )
                    for c in range(3):
                        forms[3 + c, k] = (
                            m[0, k] * colours[f, 0, c] + m[1, k] * colours[f, 1, c] + m[2, k] * colours[f, 2, c]
                        )
            dx, dy = columns[x], rows[y]
            weight = forms[0, 0] * dx + forms[0, 1] * dy - forms[0, 2]
            scale = 1.0 / weight if weight > 0.0 else 0.0
            red = (forms[3, 0] * dx + forms[3, 1] * dy - forms[3, 2]) * scale * factors[own, 0]
            green = (forms[4, 0] * dx + forms[4, 1] * dy - forms[4, 2]) * scale * factors[own, 1]
            blue = (forms[5, 0] * dx + forms[5, 1] * dy - forms[5, 2]) * scale * factors[own, 2]
            if tex >= 0:
                s = (forms[1, 0] * dx + forms[1, 1] * dy - forms[1, 2]) * scale
                t = (forms[2, 0] * dx + forms[2, 1] * dy - forms[2, 2]) * scale
                level = first_level[tex]
                w0, h0 = widths[level], heights[level]
                sx = (forms[1, 0] - s * forms[0, 0]) * scale * step_x * w0
                tx = (forms[2, 0] - t * forms[0, 0]) * scale * step_x * h0
                sy = (forms[1, 1] - s * forms[0, 1]) * scale * step_y * w0
                ty = (forms[2, 1] - t * forms[0, 1]) * scale * step_y * h0
                size = max(sx * sx + tx * tx, sy * sy + ty * ty)
                last = level + levels[tex] - 1
                while size >= 2.0 and level < last:
                    size *= 0.25
                    level += 1
                w, h = widths[level], heights[level]
                if not (abs(s) < 1e6 and abs(t) < 1e6):
                    s = t = 0.0
                fx, fy = s * w - 0.5, t * h - 0.5
                x0, y0 = math.floor(fx), math.floor(fy)
                ux, uy = fx - x0, fy - y0
                xa, xb = _wrapped(int(x0), w, wraps[own, 0]), _wrapped(int(x0) + 1, w, wraps[own, 0])
                ya, yb = _wrapped(int(y0), h, wraps[own, 1]), _wrapped(int(y0) + 1, h, wraps[own, 1])
                at = offsets[level]
                aa, ab = at + 3 * (ya * w + xa), at + 3 * (ya * w + xb)
                ba, bb = at + 3 * (yb * w + xa), at + 3 * (yb * w + xb)
                ka, kb, kc, kd = (1 - ux) * (1 - uy), ux * (1 - uy), (1 - ux) * uy, ux * uy
                part = 1.0 / 255.0
                red *= (ka * texels[aa] + kb * texels[ab] + kc * texels[ba] + kd * texels[bb]) * part
                green *= (ka * texels[aa + 1] + kb * texels[ab + 1] + kc * texels[ba + 1] + kd * texels[bb + 1]) * part
                blue *= (ka * texels[aa + 2] + kb * texels[ab + 2] + kc * texels[ba + 2] + kd * texels[bb + 2]) * part
            rgb[y, x, 0] = int(min(max(red, 0.0), 255.0) + 0.5)
            rgb[y, x, 1] = int(min(max(green, 0.0), 255.0) + 0.5)
            rgb[y, x, 2] = int(min(max(blue, 0.0), 255.0) + 0.5)
