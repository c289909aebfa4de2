"""Delaunay triangles of points within a given hull, seen from above (``delaunayHull`` of Recast).

Edges are completed one after the other: an open side gets a third point, chosen so that the circle through it and the
ends of the edge contains no other point. All arithmetic is float32, since decisions near ties are part of the result.
"""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.geometry import Array, Ground, ground

__all__ = ["EDGES_PER_POINT", "cross_2d", "delaunay", "distance_2d"]

# Marks the side of an edge that has no triangle.
UNDECIDED = -1
HULL = -2
# The first number of an edge or of a triangle.
FIRST = 0
# Capacity for edges that Recast reserves per point.
EDGES_PER_POINT = 10
# Least doubled area of a triangle in square metres.
AREA_EPSILON = np.float32(1e-5)
CIRCLE_EPSILON = np.float32(1e-6)
# Points within this share of a circle's radius count as on it.
CIRCLE_TOLERANCE = np.float32(0.001)


@compiled
def cross_2d(a: Ground, b: Ground, c: Ground) -> np.float32:
    """Return twice the signed area of a, b, c in the ground plane."""
    return np.float32((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


@compiled
def distance_2d(a: Ground, b: Ground) -> np.float32:
    """Return the distance in the ground plane."""
    dx = b[0] - a[0]
    dz = b[1] - a[1]
    return np.float32(np.sqrt(dx * dx + dz * dz))


@inlined
def delaunay(points: Array, n: int, hull: Array, n_hull: int, edges: Array, triangles: Array) -> int:
    """Triangulate ``points[:n]`` within the ring ``hull[:n_hull]``; return the number of triangles.

    Parameters
    ----------
    points : (>= n, 3) float32
    hull : (>= n_hull,) int64
    edges : (>= EDGES_PER_POINT * n, 4) int64, work space: both ends, left face, right face
    triangles : (>= 2 * EDGES_PER_POINT * n, 3) int64, output
    """
    most = EDGES_PER_POINT * n
    n_edges = FIRST
    faces = FIRST
    j = n_hull - 1
    for i in range(n_hull):
        n_edges = _add_edge(edges, n_edges, most, hull[j], hull[i], HULL, UNDECIDED)
        j = i
    e = FIRST
    while e < n_edges:
        if edges[e, 2] == UNDECIDED:
            n_edges, faces = _complete(points, n, edges, n_edges, most, faces, e)
        if edges[e, 3] == UNDECIDED:
            n_edges, faces = _complete(points, n, edges, n_edges, most, faces, e)
        e += 1
    return _collect(edges, n_edges, faces, triangles)


@compiled
def _find_edge(edges: Array, n_edges: int, s: int, t: int) -> int:
    for e in range(n_edges):
        if (edges[e, 0] == s and edges[e, 1] == t) or (edges[e, 0] == t and edges[e, 1] == s):
            return e
    return -1


@compiled
def _add_edge(edges: Array, n_edges: int, most: int, s: int, t: int, left: int, right: int) -> int:
    if n_edges >= most or _find_edge(edges, n_edges, s, t) >= 0:
        return n_edges
    edges[n_edges, 0], edges[n_edges, 1], edges[n_edges, 2], edges[n_edges, 3] = s, t, left, right
    return n_edges + 1


@compiled
def _set_left(edges: Array, e: int, s: int, t: int, face: int) -> None:
    """Set the face of edge ``e`` that is on the left when going from s to t, unless this face is already set."""
    if edges[e, 0] == s and edges[e, 1] == t and edges[e, 2] == UNDECIDED:
        edges[e, 2] = face
    elif edges[e, 1] == s and edges[e, 0] == t and edges[e, 3] == UNDECIDED:
        edges[e, 3] = face


@compiled
def _attach(edges: Array, n_edges: int, most: int, s: int, t: int, face: int) -> int:
    """Set the face to the left of edge s-t and return the number of edges. The edge is added if it does not exist."""
    e = _find_edge(edges, n_edges, s, t)
    if e < 0:
        return _add_edge(edges, n_edges, most, s, t, face, UNDECIDED)
    _set_left(edges, e, s, t, face)
    return n_edges


@inlined
def _circle(a: Ground, b: Ground, c: Ground, centre: Array) -> np.float32:
    """Write to ``centre`` the centre of the circle through three points, and return the radius of the circle. If the
    points are collinear, the centre is a and the radius is 0.
    """
    bx, bz = b[0] - a[0], b[1] - a[1]
    cx, cz = c[0] - a[0], c[1] - a[1]
    area = bx * cz - bz * cx
    if abs(area) <= CIRCLE_EPSILON:
        centre[0], centre[1] = a[0], a[1]
        return np.float32(0)
    b_squared = bx * bx + bz * bz
    c_squared = cx * cx + cz * cz
    # Relative to a. The order of the sums is Recast's, where the first term is 0.
    x = (b_squared * cz + c_squared * -bz) / (np.float32(2) * area)
    z = (b_squared * -cx + c_squared * bx) / (np.float32(2) * area)
    centre[0], centre[1] = x + a[0], z + a[1]
    return np.float32(np.sqrt(x * x + z * z))


@inlined
def _crosses(a: Ground, b: Ground, c: Ground, d: Ground) -> bool:
    abd = cross_2d(a, b, d)
    abc = cross_2d(a, b, c)
    if abd * abc < 0:
        cda = cross_2d(c, d, a)
        return bool(cda * (cda + abc - abd) < 0)
    return False


@compiled
def _crosses_any(points: Array, edges: Array, n_edges: int, s: int, t: int) -> bool:
    for e in range(n_edges):
        p, q = edges[e, 0], edges[e, 1]
        if p in (s, t) or q in (s, t):
            continue
        if _crosses(ground(points, p), ground(points, q), ground(points, s), ground(points, t)):
            return True
    return False


@inlined
def _third_point(points: Array, n: int, edges: Array, n_edges: int, s: int, t: int) -> int:
    """Return the index of a point to the left of edge s-t, chosen so that the circle through s, t and this point
    contains no other point; n if there is no such point.
    """
    best = n
    centre = np.zeros(2, np.float32)
    radius = np.float32(-1)
    for u in range(n):
        if u in (s, t) or not cross_2d(ground(points, s), ground(points, t), ground(points, u)) > AREA_EPSILON:
            continue
        if radius >= 0:
            d = distance_2d((centre[0], centre[1]), ground(points, u))
            if d > radius * (np.float32(1) + CIRCLE_TOLERANCE):
                continue
            # If the point is on the circle within tolerance, either point is allowed, provided that its edges cross
            # nothing.
            if not d < radius * (np.float32(1) - CIRCLE_TOLERANCE) and (
                _crosses_any(points, edges, n_edges, s, u) or _crosses_any(points, edges, n_edges, t, u)
            ):
                continue
        best = u
        radius = _circle(ground(points, s), ground(points, t), ground(points, u), centre)
    return best


@compiled
def _complete(points: Array, n: int, edges: Array, n_edges: int, most: int, faces: int, e: int) -> tuple[int, int]:
    """Put a new triangle on an open side of edge e, or mark this side as the hull if no point fits. Return the numbers
    of edges and of triangles.
    """
    s, t = edges[e, 0], edges[e, 1]
    if edges[e, 2] != UNDECIDED:
        s, t = t, s
    third = _third_point(points, n, edges, n_edges, s, t)
    if third == n:
        _set_left(edges, e, s, t, HULL)
        return n_edges, faces
    _set_left(edges, e, s, t, faces)
    n_edges = _attach(edges, n_edges, most, third, s, faces)
    n_edges = _attach(edges, n_edges, most, t, third, faces)
    return n_edges, faces + 1


@inlined
def _collect(edges: Array, n_edges: int, faces: int, triangles: Array) -> int:
    """Collect the corners of each triangle from its edges and write them to ``triangles``; return the number of
    complete triangles. Each incomplete triangle is overwritten by the last triangle of the list.
    """
    for f in range(faces):
        triangles[f, 0] = triangles[f, 1] = triangles[f, 2] = -1
    for e in range(n_edges):
        for side in (3, 2):
            f = edges[e, side]
            if f < 0:
                continue
            a, b = (edges[e, 0], edges[e, 1]) if side == 3 else (edges[e, 1], edges[e, 0])
            if triangles[f, 0] == -1:
                triangles[f, 0] = a
                triangles[f, 1] = b
            elif triangles[f, 0] == b:
                triangles[f, 2] = a
            elif triangles[f, 1] == a:
                triangles[f, 2] = b
    f = 0
    while f < faces:
        if triangles[f, 0] == -1 or triangles[f, 1] == -1 or triangles[f, 2] == -1:
            faces -= 1
            triangles[f] = triangles[faces]
        else:
            f += 1
    return faces
