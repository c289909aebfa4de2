"""Stage 9: connect holes to their region's outline by cuts, so that a single polygon results (``mergeRegionHoles``)."""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.arrays import Array, Ground, ground
from condvln.navigation.recast.contours import Contours
from condvln.navigation.recast.planar import coincide, in_cone, segments_touch

__all__ = ["merge_holes"]


def merge_holes(contours: Contours) -> Contours:
    """Return the contours, in the same order, after merging holes into the outlines of their regions. A merged hole
    stays in its place as an empty contour.

    A hole that can't be merged stays a contour of its own, as in Recast.
    """
    polygons = [contours[k] for k in range(len(contours))]
    # Twice the area, rounded as in Recast; a contour of reverse winding is a hole.
    backwards = np.array([_doubled_area(p) < -2 for p in polygons], bool)
    if not backwards.any():
        return contours
    for region in np.unique(contours.region[backwards]):
        members = np.flatnonzero(contours.region == region)
        outlines = members[~backwards[members]]
        if len(outlines) == 0:
            continue
        holes = [(_leftmost(polygons[k]), int(k)) for k in members[backwards[members]]]
        holes.sort(key=lambda hole: hole[0][:2])  # sorted by corner only: equal ones keep their order
        order = [k for _, k in holes]
        outline, found = _merge_all(
            polygons[outlines[-1]],
            np.concatenate([polygons[k] for k in order]),
            np.cumsum([0] + [len(polygons[k]) for k in order]),
            np.array([corner[2] for corner, _ in holes], np.int64),
        )
        polygons[outlines[-1]] = outline
        for k in np.array(order)[found]:
            polygons[k] = polygons[k][:0]
    start = np.cumsum([0] + [len(p) for p in polygons]).astype(np.int32)
    return Contours(np.concatenate(polygons), start, contours.region, contours.area)


def _doubled_area(polygon: Array) -> int:
    x, z = polygon[:, 0].astype(np.int64), polygon[:, 2].astype(np.int64)
    return int((x * np.roll(z, 1) - np.roll(x, 1) * z).sum())


def _leftmost(polygon: Array) -> tuple[int, int, int]:
    """Return x, z and index of the leftmost corner: the one with the least x, on ties the least z, then the least
    index.
    """
    i = int(np.lexsort((polygon[:, 2], polygon[:, 0]))[0])
    return int(polygon[i, 0]), int(polygon[i, 2]), i


@compiled
def _blocked(a: Ground, b: Ground, polygon: Array, ignored: int) -> bool:
    """Return whether segment ab touches the polygon. The polygon's edges at corner ``ignored``, and those that end in a
    or b, do not count.
    """
    n = len(polygon)
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        if i == ignored or j == ignored:
            continue
        p, q = ground(polygon, i), ground(polygon, j)
        if coincide(a, p) or coincide(b, p) or coincide(a, q) or coincide(b, q):
            continue
        if segments_touch(a, b, p, q):
            return True
    return False


@inlined
def _joined(outline: Array, i: int, hole: Array, j: int) -> Array:
    """Return the outline with the hole inserted. The result runs around the outline from corner i back to i, then
    around the hole from corner j back to j.
    """
    n, m = len(outline), len(hole)
    out = np.empty((n + m + 2, 4), np.int32)
    for k in range(n + 1):
        out[k] = outline[(i + k) % n]
    for k in range(m + 1):
        out[n + 1 + k] = hole[(j + k) % m]
    return out


@compiled
def _merge_all(outline: Array, points: Array, start: Array, leftmost: Array) -> tuple[Array, Array]:
    """Return the outline with as many holes as possible merged into it, and whether each hole was merged.

    Hole h is ``points[start[h]:start[h + 1]]``; the leftmost hole comes first.
    """
    holes = len(leftmost)
    found = np.zeros(holes, np.bool_)
    capacity = len(outline) + len(points) + 2 * holes
    # Recast looks up the corner to ignore by the index of the hole, not of the diagonal, so entries of earlier holes
    # are read.
    corner_of = np.zeros(capacity, np.int64)
    length = np.zeros(capacity, np.int64)
    for h in range(holes):
        hole = points[start[h] : start[h + 1]]
        at = leftmost[h]
        for _ in range(len(hole)):
            tip = ground(hole, at)
            n = len(outline)
            diagonals = 0
            for i in range(n):
                corner = ground(outline, i)
                if in_cone(ground(outline, (i + n - 1) % n), corner, ground(outline, (i + 1) % n), tip, False):
                    dx = corner[0] - tip[0]
                    dz = corner[1] - tip[1]
                    corner_of[diagonals] = i
                    length[diagonals] = dx * dx + dz * dz
                    diagonals += 1
            order = np.argsort(length[:diagonals], kind="mergesort")
            corner_of[:diagonals] = corner_of[:diagonals][order]
            chosen = -1
            for d in range(diagonals):
                i = corner_of[d]
                clear = not _blocked(ground(outline, i), tip, outline, corner_of[h])
                other = h
                while clear and other < holes:
                    clear = not _blocked(ground(outline, i), tip, points[start[other] : start[other + 1]], -1)
                    other += 1
                if clear:
                    chosen = i
                    break
            if chosen >= 0:
                outline = _joined(outline, chosen, hole, at)
                found[h] = True
                break
            at = (at + 1) % len(hole)
    return outline, found
