"""Corner points of the shortest path through a corridor: Detour's ``findStraightPath``, the funnel algorithm."""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.kernels.astar import edge_to
from condvln.navigation.kernels.geometry import ZERO, clamp_to_polygon, point_to_segment, triangle_area
from condvln.navigation.kernels.mesh import QueryMesh
from condvln.navigation.tile import Floats, Indices

MAX_POINTS = 256  # habitat-sim's buffer; a path that fills it counts as unreachable
# Squared metres: points nearer than 1/16384 m are equal; a portal nearer than 1 mm to the start counts as passed.
SAME_POINT = np.float32(1.0 / 16384.0) * np.float32(1.0 / 16384.0)
AT_PORTAL = np.float32(0.001) * np.float32(0.001)


@compiled
def _same_point(ax: np.float32, ay: np.float32, az: np.float32, bx: np.float32, by: np.float32, bz: np.float32) -> bool:
    """Return whether two points are less than 1/16384 m apart."""
    dx = bx - ax
    dy = by - ay
    dz = bz - az
    return bool(dx * dx + dy * dy + dz * dz < SAME_POINT)


@compiled
def _append(points: Floats, count: int, x: np.float32, y: np.float32, z: np.float32) -> int:
    """Append a point unless it repeats the last one; return the new number of points."""
    if _same_point(points[count - 1, 0], points[count - 1, 1], points[count - 1, 2], x, y, z):
        return count
    points[count, 0] = x
    points[count, 1] = y
    points[count, 2] = z
    return count + 1


@inlined
def pull_string(mesh: QueryMesh, corridor: Indices, size: int, start: Floats, end: Floats, points: Floats) -> int:
    """Write to ``points`` the corners of the shortest path through the first ``size`` polygons of ``corridor``. The
    path runs between the requested points, not the snapped ones.

    Coordinates are kept as numbers, not in arrays: allocating those took a quarter of the time.

    Returns the number of points, or 0 if they fill the buffer.
    """
    verts, poly_verts, poly_size, neighbours = mesh.verts, mesh.poly_verts, mesh.poly_size, mesh.neighbours
    first_x, first_y, first_z = clamp_to_polygon(
        verts, poly_verts, poly_size, corridor[0], start[0], start[1], start[2]
    )
    last_x, last_y, last_z = clamp_to_polygon(verts, poly_verts, poly_size, corridor[size - 1], end[0], end[1], end[2])
    points[0, 0], points[0, 1], points[0, 2] = first_x, first_y, first_z
    count = 1
    if size > 1:
        apex_x, apex_y, apex_z = first_x, first_y, first_z
        left_x, left_y, left_z = first_x, first_y, first_z
        right_x, right_y, right_z = first_x, first_y, first_z
        left_index = 0
        right_index = 0
        i = 0
        while i < size:
            if i + 1 < size:
                poly = corridor[i]
                edge = edge_to(neighbours, poly_size, poly, corridor[i + 1])
                a = poly_verts[poly, edge]
                b = poly_verts[poly, edge + 1 if edge + 1 < poly_size[poly] else 0]
                new_left_x, new_left_y, new_left_z = verts[a, 0], verts[a, 1], verts[a, 2]
                new_right_x, new_right_y, new_right_z = verts[b, 0], verts[b, 1], verts[b, 2]
                if i == 0:
                    d, _ = point_to_segment(apex_x, apex_z, new_left_x, new_left_z, new_right_x, new_right_z)
                    if d < AT_PORTAL:
                        i += 1
                        continue
            else:
                new_left_x, new_left_y, new_left_z = last_x, last_y, last_z
                new_right_x, new_right_y, new_right_z = last_x, last_y, last_z
            turned = 0  # 1: the right side crossed the left one, which becomes a corner; 2: the reverse
            if triangle_area(apex_x, apex_z, right_x, right_z, new_right_x, new_right_z) <= ZERO:
                if (
                    _same_point(apex_x, apex_y, apex_z, right_x, right_y, right_z)
                    or triangle_area(apex_x, apex_z, left_x, left_z, new_right_x, new_right_z) > ZERO
                ):
                    right_x, right_y, right_z = new_right_x, new_right_y, new_right_z
                    right_index = i
                else:
                    turned = 1
            if turned == 0 and triangle_area(apex_x, apex_z, left_x, left_z, new_left_x, new_left_z) >= ZERO:
                if (
                    _same_point(apex_x, apex_y, apex_z, left_x, left_y, left_z)
                    or triangle_area(apex_x, apex_z, right_x, right_z, new_left_x, new_left_z) < ZERO
                ):
                    left_x, left_y, left_z = new_left_x, new_left_y, new_left_z
                    left_index = i
                else:
                    turned = 2
            if turned:
                corner_index = left_index if turned == 1 else right_index
                if turned == 1:
                    apex_x, apex_y, apex_z = left_x, left_y, left_z
                else:
                    apex_x, apex_y, apex_z = right_x, right_y, right_z
                before = count
                count = _append(points, count, apex_x, apex_y, apex_z)
                if count >= MAX_POINTS:
                    return 0
                if count > before and corner_index == size - 1:
                    return count  # the corner is the end itself
                left_x, left_y, left_z = apex_x, apex_y, apex_z
                right_x, right_y, right_z = apex_x, apex_y, apex_z
                left_index = corner_index
                right_index = corner_index
                i = corner_index
            i += 1
    count = _append(points, count, last_x, last_y, last_z)
    return count if count < MAX_POINTS else 0


@inlined
def path_length(points: Floats, count: int) -> np.float32:
    """Return the length of a polyline in metres, summed in float32 from its start."""
    length = ZERO
    for i in range(1, count):
        dx = points[i - 1, 0] - points[i, 0]
        dy = points[i - 1, 1] - points[i, 1]
        dz = points[i - 1, 2] - points[i, 2]
        length += np.sqrt(dx * dx + dy * dy + dz * dz)
    return length
