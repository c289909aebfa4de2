"""Distances of triangle meshes, over balanced trees of boxes along the scene's axes.

The trees are made and searched faster than FCL's hierarchies: comparing two such boxes takes nanoseconds, and most
pairs of triangles are left out by one direction, that between the nearest points found so far.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined, register_warm_up
from condvln.uncounted import keep, uncounted

__all__ = ["TriangleTree", "tree_order"]

Doubles = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Vector = tuple[float, float, float]

SAME: Final = 1.0 - 1e-12
"""A distance that is greater than this share of the least one found is no improvement: triangles share corners."""

DEEPEST: Final = 128
"""Most pairs of nodes that wait at once: one for each level of both trees, with a margin."""


@dataclass(frozen=True, eq=False, slots=True)
class TriangleTree:
    """Triangles and the boxes around them.

    triangles : (m, 3, 3) metres, m ≥ 1, in an order in which neighbours are close, as of `tree_order`
    boxes : (2 l, 6) lowest and highest corner of each node; l leaves have one or two triangles each. The root is node
        1, the children of node k are 2 k and 2 k + 1, the leaves come last.
    """

    triangles: Doubles
    boxes: Doubles

    @classmethod
    def of(cls, triangles: Doubles) -> TriangleTree:
        """Return the tree over triangles (m, 3, 3) in their order."""
        return cls(triangles, _boxes(triangles, 1 << _levels(len(triangles))))

    @property
    def extent(self) -> Doubles:
        """(2, 3) [min, max] of all corners."""
        extent: Doubles = self.boxes[1].reshape(2, 3)
        return extent

    def distance(self, other: TriangleTree) -> float:
        """Return the distance in metres of the triangles of two trees; about 0 where they touch or intersect."""
        return _distance(self.triangles, self.boxes, other.triangles, other.boxes)


def tree_order(triangles: Doubles) -> Indices:
    """Return the order (m,) of triangles (m, 3, 3) in which the nodes of a tree are compact: each node's triangles are
    halved along the longest side of the box around their centres.
    """
    centres = triangles.mean(axis=1)
    order = np.arange(len(centres))
    for level in range(_levels(len(centres))):
        ends = np.arange(2**level + 1) * len(centres) // 2**level
        own = centres[order]
        size = np.maximum.reduceat(own, ends[:-1]) - np.minimum.reduceat(own, ends[:-1])
        node = np.repeat(np.arange(2**level), np.diff(ends))
        order = order[np.lexsort((own[np.arange(len(own)), size.argmax(axis=1)[node]], node))]
    return order


def _levels(triangles: int) -> int:
    """Return the number of levels of a tree below its root."""
    return max(triangles.bit_length() - 1, 0)


@inlined
def _between_edges(p: Doubles, i: int, q: Doubles, j: int) -> Vector:
    """Return the vector between the nearest points of edge i of a triangle and edge j of another one (Ericson 2005,
    section 5.1.9).
    """
    k, n = (i + 1) % 3, (j + 1) % 3
    ux, uy, uz = p[k, 0] - p[i, 0], p[k, 1] - p[i, 1], p[k, 2] - p[i, 2]
    vx, vy, vz = q[n, 0] - q[j, 0], q[n, 1] - q[j, 1], q[n, 2] - q[j, 2]
    rx, ry, rz = p[i, 0] - q[j, 0], p[i, 1] - q[j, 1], p[i, 2] - q[j, 2]
    a, e = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    b, c, f = ux * vx + uy * vy + uz * vz, ux * rx + uy * ry + uz * rz, vx * rx + vy * ry + vz * rz
    skew = a * e - b * b
    s = min(max((b * f - c * e) / skew, 0.0), 1.0) if skew > 0.0 else 0.0
    t = (b * s + f) / e if e > 0.0 else 0.0
    if t < 0.0 or t > 1.0 or e == 0.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((b * t - c) / a, 0.0), 1.0) if a > 0.0 else 0.0
    return rx + s * ux - t * vx, ry + s * uy - t * vy, rz + s * uz - t * vz


@inlined
def _above(p: Doubles, i: int, q: Doubles) -> Vector:
    """Return the vector from another triangle to corner i of a triangle if the nearest point is inside the other one;
    else an infinite one.
    """
    ux, uy, uz = q[1, 0] - q[0, 0], q[1, 1] - q[0, 1], q[1, 2] - q[0, 2]
    vx, vy, vz = q[2, 0] - q[0, 0], q[2, 1] - q[0, 1], q[2, 2] - q[0, 2]
    px, py, pz = p[i, 0] - q[0, 0], p[i, 1] - q[0, 1], p[i, 2] - q[0, 2]
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    up, vp = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    area = uu * vv - uv * uv
    s, t = vv * up - uv * vp, uu * vp - uv * up
    if area <= 0.0 or s < 0.0 or t < 0.0 or s + t > area:
        return math.inf, 0.0, 0.0
    s, t = s / area, t / area
    return px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz


@inlined
def _between_triangles(one: Doubles, other: Doubles) -> tuple[float, float, float, float]:
    """Return the squared distance of two triangles that do not intersect, and the vector between their nearest points,
    from the other one.
    """
    least, nx, ny, nz = math.inf, 0.0, 0.0, 0.0
    for i in range(3):
        for j in range(3):
            x, y, z = _between_edges(one, i, other, j)
            square = x * x + y * y + z * z
            if square < least:
                least, nx, ny, nz = square, x, y, z
    for turn in range(2):
        corners, face, sign = (one, other, 1.0) if turn == 0 else (other, one, -1.0)
        for i in range(3):
            x, y, z = _above(corners, i, face)
            square = x * x + y * y + z * z
            if square < least:
                least, nx, ny, nz = square, sign * x, sign * y, sign * z
    return least, nx, ny, nz


@inlined
def _are_beyond(p: Doubles, q: Doubles, nx: float, ny: float, nz: float, least: float) -> bool:
    """Return whether two triangles are at least so far apart along a direction."""
    low, high = math.inf, -math.inf
    for i in range(3):
        low = min(low, p[i, 0] * nx + p[i, 1] * ny + p[i, 2] * nz)
        high = max(high, q[i, 0] * nx + q[i, 1] * ny + q[i, 2] * nz)
    return bool(low - high >= least)


@inlined
def _pierces(p: Doubles, i: int, q: Doubles) -> bool:
    """Return whether edge i of a triangle passes through the inside of another triangle."""
    k = (i + 1) % 3
    ux, uy, uz = q[1, 0] - q[0, 0], q[1, 1] - q[0, 1], q[1, 2] - q[0, 2]
    vx, vy, vz = q[2, 0] - q[0, 0], q[2, 1] - q[0, 1], q[2, 2] - q[0, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    bx, by, bz = p[i, 0] - q[0, 0], p[i, 1] - q[0, 1], p[i, 2] - q[0, 2]
    ex, ey, ez = p[k, 0] - q[0, 0], p[k, 1] - q[0, 1], p[k, 2] - q[0, 2]
    begin, end = nx * bx + ny * by + nz * bz, nx * ex + ny * ey + nz * ez
    if begin * end > 0.0 or begin == end:
        return False
    at = begin / (begin - end)
    x, y, z = bx + at * (ex - bx), by + at * (ey - by), bz + at * (ez - bz)
    # Twice the areas of the parts of the triangle beside the point, in its normal's direction.
    s = nx * (y * vz - z * vy) + ny * (z * vx - x * vz) + nz * (x * vy - y * vx)
    t = nx * (uy * z - uz * y) + ny * (uz * x - ux * z) + nz * (ux * y - uy * x)
    return bool(s >= 0.0 and t >= 0.0 and s + t <= nx * nx + ny * ny + nz * nz)


@inlined
def _intersect(one: Doubles, other: Doubles) -> bool:
    """Return whether an edge of one of two triangles passes through the other one."""
    found = False
    for turn in range(2):
        edges, face = (one, other) if turn == 0 else (other, one)
        for i in range(3):
            found = found or _pierces(edges, i, face)
    return found


@compiled
def _between_boxes(one: Doubles, k: int, other: Doubles, n: int) -> float:
    """Return the squared distance of node k of a tree and node n of another one."""
    square = 0.0
    for axis in range(3):
        gap = max(one[k, axis] - other[n, axis + 3], other[n, axis] - one[k, axis + 3])
        if gap > 0.0:
            square += gap * gap
    return square


@compiled
def _longest(boxes: Doubles, k: int) -> float:
    """Return the longest side of a node's box."""
    return float(max(boxes[k, 3] - boxes[k, 0], boxes[k, 4] - boxes[k, 1], boxes[k, 5] - boxes[k, 2]))


@compiled
def _boxes(triangles: Doubles, leaves: int) -> Doubles:
    """Return the boxes (2 `leaves`, 6) of a tree's nodes."""
    boxes = np.empty((2 * leaves, 6))
    boxes[0] = 0.0
    count = len(triangles)
    for node in range(2 * leaves - 1, 0, -1):
        for axis in range(3):
            if node < leaves:
                boxes[node, axis] = min(boxes[2 * node, axis], boxes[2 * node + 1, axis])
                boxes[node, axis + 3] = max(boxes[2 * node, axis + 3], boxes[2 * node + 1, axis + 3])
            else:
                low, high = math.inf, -math.inf
                for k in range((node - leaves) * count // leaves, (node - leaves + 1) * count // leaves):
                    for corner in range(3):
                        low = min(low, triangles[k, corner, axis])
                        high = max(high, triangles[k, corner, axis])
                boxes[node, axis], boxes[node, axis + 3] = low, high
    return boxes


@compiled
def _distance(triangles_a: Doubles, boxes_a: Doubles, triangles_b: Doubles, boxes_b: Doubles) -> float:
    """Return the distance of the triangles of two trees (see `TriangleTree`)."""
    triangles_a, boxes_a, triangles_b, boxes_b = uncounted((triangles_a, boxes_a, triangles_b, boxes_b))
    held = (np.empty((DEEPEST, 2), np.int64), np.empty(DEEPEST))
    waiting, nearest = uncounted(held)
    leaves_a, leaves_b = len(boxes_a) // 2, len(boxes_b) // 2
    least, reach = math.inf, math.inf
    nx, ny, nz = 0.0, 0.0, 0.0
    waiting[0, 0], waiting[0, 1], nearest[0] = 1, 1, _between_boxes(boxes_a, 1, boxes_b, 1)
    may_meet = nearest[0] == 0.0
    count = 1
    while count > 0:
        count -= 1
        if nearest[count] >= least:
            continue
        a, b = waiting[count, 0], waiting[count, 1]
        if a >= leaves_a and b >= leaves_b:
            begin_b = (b - leaves_b) * len(triangles_b) // leaves_b
            end_b = (b - leaves_b + 1) * len(triangles_b) // leaves_b
            begin_a = (a - leaves_a) * len(triangles_a) // leaves_a
            for k in range(begin_a, (a - leaves_a + 1) * len(triangles_a) // leaves_a):
                for n in range(begin_b, end_b):
                    one, other = triangles_a[k], triangles_b[n]
                    if _are_beyond(one, other, nx, ny, nz, reach):
                        continue
                    if may_meet and _intersect(one, other):
                        least, reach = 0.0, 0.0
                        continue
                    square, x, y, z = _between_triangles(one, other)
                    if square < least:
                        least, length = square, math.sqrt(square)
                        reach = length * SAME
                        nx, ny, nz = (x / length, y / length, z / length) if length > 0.0 else (0.0, 0.0, 0.0)
            continue
        first_a, first_b, second_a, second_b = a, b, a, b
        if b >= leaves_b or (a < leaves_a and _longest(boxes_a, a) > _longest(boxes_b, b)):
            first_a, second_a = 2 * a, 2 * a + 1
        else:
            first_b, second_b = 2 * b, 2 * b + 1
        to_first = _between_boxes(boxes_a, first_a, boxes_b, first_b)
        to_second = _between_boxes(boxes_a, second_a, boxes_b, second_b)
        if to_first < to_second:  # what waits last is looked at first
            first_a, first_b, second_a, second_b = second_a, second_b, first_a, first_b
            to_first, to_second = to_second, to_first
        if to_first < least:
            waiting[count, 0], waiting[count, 1], nearest[count] = first_a, first_b, to_first
            count += 1
        if to_second < least:
            waiting[count, 0], waiting[count, 1], nearest[count] = second_a, second_b, to_second
            count += 1
    keep(held)
    return math.sqrt(least)


def _warm_up() -> None:
    tree = TriangleTree.of(np.zeros((1, 3, 3)))
    tree.distance(tree)


register_warm_up("distances of meshes", _warm_up)
