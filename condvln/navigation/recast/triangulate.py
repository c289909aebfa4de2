"""Triangulate a simple polygon on the integer grid by cutting the ear with the shortest diagonal (``triangulate``)."""

from __future__ import annotations

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.arrays import Array, Ground, ground
from condvln.navigation.recast.planar import coincide, in_cone, segments_cross, segments_touch

__all__ = ["triangulate"]


@inlined
def triangulate(points: Array, corner: Array, ear: Array, triangles: Array) -> int:
    """Write the triangles of a polygon as rows of corner numbers; return the number of triangles.

    A self-overlapping polygon may give fewer than n - 2.

    Parameters
    ----------
    points : (n, 4) int32, x and z in columns 0 and 2
    corner, ear : (>= n,) int32 and bool, work space
    triangles : (>= n, 3) int32, output
    """
    n = len(points)
    for i in range(n):
        corner[i] = i
    for i in range(n):
        ear[(i + 1) % n] = _is_diagonal(i, (i + 2) % n, n, points, corner, False)
    count = 0
    while n > 3:
        best = _shortest_ear(n, points, corner, ear)
        if best < 0:
            best = _shortest_loose_cut(n, points, corner)
        if best < 0:
            return count
        tip = (best + 1) % n
        triangles[count, 0] = corner[best]
        triangles[count, 1] = corner[tip]
        triangles[count, 2] = corner[(best + 2) % n]
        count += 1
        n -= 1
        for k in range(tip, n):
            corner[k] = corner[k + 1]
            ear[k] = ear[k + 1]
        after = tip if tip < n else 0
        before = after - 1 if after > 0 else n - 1
        ear[before] = _is_diagonal((before + n - 1) % n, after, n, points, corner, False)
        ear[after] = _is_diagonal(before, (after + 1) % n, n, points, corner, False)
    triangles[count, 0], triangles[count, 1], triangles[count, 2] = corner[0], corner[1], corner[2]
    return count + 1


@compiled
def _is_diagonal(i: int, j: int, n: int, points: Array, corner: Array, loose: bool) -> bool:
    """Return whether the segment between corners i and j is inside the polygon. With ``loose`` the segment may touch
    the border.
    """
    a, b = ground(points, corner[i]), ground(points, corner[j])
    if not in_cone(ground(points, corner[(i + n - 1) % n]), a, ground(points, corner[(i + 1) % n]), b, loose):
        return False
    for k in range(n):
        m = k + 1 if k + 1 < n else 0
        if k in (i, j) or m in (i, j):
            continue
        p, q = ground(points, corner[k]), ground(points, corner[m])
        if coincide(a, p) or coincide(b, p) or coincide(a, q) or coincide(b, q):
            continue
        if segments_cross(a, b, p, q) if loose else segments_touch(a, b, p, q):
            return False
    return True


@compiled
def _squared_length(a: Ground, b: Ground) -> int:
    dx = b[0] - a[0]
    dz = b[1] - a[1]
    return int(dx * dx + dz * dz)


@inlined
def _shortest_ear(n: int, points: Array, corner: Array, ear: Array) -> int:
    best = -1
    shortest = -1
    for i in range(n):
        if ear[(i + 1) % n]:
            length = _squared_length(ground(points, corner[i]), ground(points, corner[(i + 2) % n]))
            if best < 0 or length < shortest:
                shortest = length
                best = i
    return best


@inlined
def _shortest_loose_cut(n: int, points: Array, corner: Array) -> int:
    """Return the corner at which the shortest possible cut begins; -1 if there is none. Cuts may touch the border (the
    loose test), which is needed for outlines whose segments overlap. As in Recast, a cut's length is measured to the
    corner after its end.
    """
    best = -1
    shortest = -1
    for i in range(n):
        if _is_diagonal(i, (i + 2) % n, n, points, corner, True):
            length = _squared_length(ground(points, corner[i]), ground(points, corner[(i + 3) % n]))
            if best < 0 or length < shortest:
                shortest = length
                best = i
    return best
