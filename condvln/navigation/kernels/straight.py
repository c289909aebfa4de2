"""Corner points of the shortest path through a corridor: Detour's ``findStraightPath``, the funnel algorithm."""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled
from condvln.navigation.kernels.astar import edge_to
from condvln.navigation.kernels.geometry import ZERO, clamp_to_polygon, point_to_segment, triangle_area
from condvln.navigation.kernels.mesh import QueryMesh
from condvln.navigation.tile import Floats, Indices

MAX_POINTS = 256  # habitat-sim's buffer; a path that fills it counts as unreachable
# Squared metres: points nearer than 1/16384 m are equal; a portal nearer than 1 mm to the start counts as passed.
SAME_POINT = np.float32(1.0 / 16384.0) * np.float32(1.0 / 16384.0)
AT_PORTAL = np.float32(0.001) * np.float32(0.001)


@compiled
def same_point(a: Floats, b: Floats) -> bool:
    """Return whether two points are less than 1/16384 m apart."""
    dx = b[0] - a[0]
    dy = b[1] - a[1]
    dz = b[2] - a[2]
    return bool(dx * dx + dy * dy + dz * dz < SAME_POINT)


@compiled
def _turn(a: Floats, b: Floats, c: Floats) -> np.float32:
    return triangle_area(a[0], a[2], b[0], b[2], c[0], c[2])


@compiled
def _append(points: Floats, count: int, point: Floats) -> int:
    """Append a point unless it repeats the last one; return the new number of points."""
    if same_point(points[count - 1], point):
        return count
    points[count] = point
    return count + 1


@compiled
def pull_string(mesh: QueryMesh, corridor: Indices, size: int, start: Floats, end: Floats, points: Floats) -> int:
    """Write to ``points`` the corners of the shortest path through the first ``size`` polygons of ``corridor``. The
    path runs between the requested points, not the snapped ones.

    Returns the number of points, or 0 if they fill the buffer.
    """
    first = np.empty(3, np.float32)
    last = np.empty(3, np.float32)
    first[0], first[1], first[2] = clamp_to_polygon(mesh, corridor[0], start[0], start[1], start[2])
    last[0], last[1], last[2] = clamp_to_polygon(mesh, corridor[size - 1], end[0], end[1], end[2])
    points[0] = first
    count = 1
    if size > 1:
        apex = first.copy()
        left = first.copy()
        right = first.copy()
        left_index = 0
        right_index = 0
        i = 0
        while i < size:
            if i + 1 < size:
                poly = corridor[i]
                edge = edge_to(mesh, poly, corridor[i + 1])
                new_left = mesh.verts[mesh.poly_verts[poly, edge]]
                new_right = mesh.verts[mesh.poly_verts[poly, edge + 1 if edge + 1 < mesh.poly_size[poly] else 0]]
                if i == 0:
                    d, _ = point_to_segment(apex[0], apex[2], new_left[0], new_left[2], new_right[0], new_right[2])
                    if d < AT_PORTAL:
                        i += 1
                        continue
            else:
                new_left = last
                new_right = last
            turned = 0  # 1: the right side crossed the left one, which becomes a corner; 2: the reverse
            if _turn(apex, right, new_right) <= ZERO:
                if same_point(apex, right) or _turn(apex, left, new_right) > ZERO:
                    right[:] = new_right
                    right_index = i
                else:
                    turned = 1
            if turned == 0 and _turn(apex, left, new_left) >= ZERO:
                if same_point(apex, left) or _turn(apex, right, new_left) < ZERO:
                    left[:] = new_left
                    left_index = i
                else:
                    turned = 2
            if turned:
                corner_index = left_index if turned == 1 else right_index
                apex[:] = left if turned == 1 else right
                before = count
                count = _append(points, count, apex)
                if count >= MAX_POINTS:
                    return 0
                if count > before and corner_index == size - 1:
                    return count  # the corner is the end itself
                left[:] = apex
                right[:] = apex
                left_index = corner_index
                right_index = corner_index
                i = corner_index
            i += 1
    count = _append(points, count, last)
    return count if count < MAX_POINTS else 0


@compiled
def path_length(points: Floats, count: int) -> np.float32:
    """Return the length of a polyline in metres, summed in float32 from its start."""
    length = ZERO
    for i in range(1, count):
        dx = points[i - 1, 0] - points[i, 0]
        dy = points[i - 1, 1] - points[i, 1]
        dz = points[i - 1, 2] - points[i, 2]
        length += np.sqrt(dx * dx + dy * dy + dz * dz)
    return length
