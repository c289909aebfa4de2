"""Shade the rasterized faces: texture, material factor and vertex colour multiplied, without lighting."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled

__all__ = ["CLAMP", "resolve_depth", "resolve_owner", "shade"]

Doubles = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]
Bytes = npt.NDArray[np.uint8]

CLAMP, MIRROR = 1, 2
"""Wrap modes of a texture beyond its border; 0 repeats it."""


@compiled
def resolve_depth(inverse: Floats, face: Ints, depth: Floats) -> None:
    """Fill `depth` of each pixel, 0 where nothing is seen. The arrays are (h, w)."""
    height, width = face.shape
    for y in range(height):
        for x in range(width):
            depth[y, x] = np.float32(1.0) / inverse[y, x] if face[y, x] >= 0 else np.float32(0.0)


@compiled
def resolve_owner(face: Ints, owner: Ints, instance: Ints) -> None:
    """Fill `instance` of each pixel: the index of the face's owner plus 1, 0 where nothing is seen. The images are
    (h, w).
    """
    height, width = face.shape
    for y in range(height):
        for x in range(width):
            f = face[y, x]
            instance[y, x] = owner[f] + 1 if f >= 0 else 0


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
