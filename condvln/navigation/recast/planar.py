"""Exact predicates on integer points of the ground plane (O'Rourke, "Computational Geometry in C", as in Recast).

Points are (x, z). "Left" is as seen on a map with z pointing down.
"""

from __future__ import annotations

from condvln.compiled import compiled
from condvln.navigation.recast.arrays import Ground

__all__ = ["coincide", "in_cone", "segments_cross", "segments_touch", "turn"]


@compiled
def turn(a: Ground, b: Ground, c: Ground) -> int:
    """Return twice the signed area of a, b, c: negative if c is left of the line from a to b, 0 on it."""
    abx, abz = b[0] - a[0], b[1] - a[1]
    acx, acz = c[0] - a[0], c[1] - a[1]
    return int(abx * acz - acx * abz)


@compiled
def coincide(a: Ground, b: Ground) -> bool:
    """Return whether two points have the same x and z."""
    return bool(a[0] == b[0] and a[1] == b[1])


@compiled
def segments_cross(a: Ground, b: Ground, c: Ground, d: Ground) -> bool:
    """Return whether segments ab and cd share a point that is inside both."""
    abc, abd, cda, cdb = turn(a, b, c), turn(a, b, d), turn(c, d, a), turn(c, d, b)
    if abc == 0 or abd == 0 or cda == 0 or cdb == 0:
        return False
    return (abc < 0) != (abd < 0) and (cda < 0) != (cdb < 0)


@compiled
def _on_segment(a: Ground, b: Ground, c: Ground) -> bool:
    """Return whether c lies on the closed segment ab."""
    if turn(a, b, c) != 0:
        return False
    k = 0 if a[0] != b[0] else 1
    return bool((a[k] <= c[k] and c[k] <= b[k]) or (a[k] >= c[k] and c[k] >= b[k]))


@compiled
def segments_touch(a: Ground, b: Ground, c: Ground, d: Ground) -> bool:
    """Return whether segments ab and cd share any point."""
    return (
        segments_cross(a, b, c, d)
        or _on_segment(a, b, c)
        or _on_segment(a, b, d)
        or _on_segment(c, d, a)
        or _on_segment(c, d, b)
    )


@compiled
def in_cone(before: Ground, corner: Ground, after: Ground, point: Ground, loose: bool) -> bool:
    """Return whether the segment from a polygon's ``corner`` to ``point`` starts inside the polygon.

    With ``loose`` a segment along one of the two edges counts at a convex corner.
    """
    if turn(before, corner, after) <= 0:  # convex or straight
        limit = 0 if loose else -1
        return turn(corner, point, before) <= limit and turn(point, corner, after) <= limit
    return not (turn(corner, point, after) <= 0 and turn(point, corner, before) <= 0)
