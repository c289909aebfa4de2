"""Steps along the floor and distances to walls: Detour's ``moveAlongSurface`` and ``findDistanceToWall``.

They are combined as in habitat-sim 0.3.4's ``tryStep``: heights from the detail mesh, no crossing of walls without
thickness, and, if sliding is off, a stop at the first wall that the step hits.
"""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.kernels.mesh import (
    GREATEST,
    HALF,
    ONE,
    ZERO,
    Point,
    QueryMesh,
    corner,
    distance,
    inside_polygon,
    point_to_segment,
)
from condvln.navigation.kernels.path import CLOSED, OPEN, Search, begin_search, edge_to, new_search, pop, push, visit
from condvln.navigation.kernels.projection import (
    ANY_ISLAND,
    NO_POLYGON,
    Place,
    height_on_polygon,
    nearest_polygon,
    place_of,
)
from condvln.navigation.tile import Floats, Indices

MAX_VISITED = 64  # size of Detour's small node pool
MAX_QUEUE = 48  # size of its queue
SEARCH_SLACK = np.float32(0.001)  # metres added to the search radius around the step's middle
PARALLEL = np.float32(1e-6)  # m²: segments with a smaller cross product don't intersect
NUDGE = np.float32(1e-4)  # metres; habitat-sim moves points this far off an edge shared by two islands


@compiled
def _passable(mesh: QueryMesh, poly: int, edge: int) -> int:
    """Return the walkable polygon across an edge, or -1."""
    other = int(mesh.neighbours[poly, edge])  # -1 for a wall
    if mesh.walkable[max(other, 0)] == 0:
        other = -1
    return other


@inlined
def _node_of(polys: Indices, count: int, poly: int) -> int:
    for node in range(count):
        if polys[node] == poly:
            return node
    return -1


@inlined
def move_along_surface(mesh: QueryMesh, start: Place, end: Floats) -> tuple[Floats, Indices]:
    """Slide from ``start`` towards ``end`` (3,). Return the final position (3,) and the polygons on the path."""
    polys, parent = np.empty(MAX_VISITED, np.int64), np.empty(MAX_VISITED, np.int64)
    closed, queue = np.empty(MAX_VISITED, np.bool_), np.empty(MAX_VISITED, np.int64)
    polys[0], parent[0], closed[0], queue[0] = start.poly, -1, True, 0
    nodes, head, tail = 1, 0, 1
    best_node = -1
    best = GREATEST
    at, reached = start.at, np.array(start.at, np.float32)
    middle_x = at[0] + (end[0] - at[0]) * HALF
    middle_z = at[2] + (end[2] - at[2]) * HALF
    radius = distance(at, (end[0], end[1], end[2])) / np.float32(2.0) + SEARCH_SLACK
    radius_squared = radius * radius
    while head < tail:
        node = queue[head]
        head += 1
        poly = polys[node]
        if inside_polygon(mesh, poly, end[0], end[2]):
            best_node = node
            for axis in range(3):
                reached[axis] = end[axis]
            break
        size = mesh.poly_size[poly]
        edge = size - 1
        for following in range(size):
            a = mesh.verts[mesh.poly_verts[poly, edge]]
            b = mesh.verts[mesh.poly_verts[poly, following]]
            other = _passable(mesh, poly, edge)
            if other < 0:
                d, along = point_to_segment(end[0], end[2], a[0], a[2], b[0], b[2])
                if d < best:
                    for axis in range(3):
                        reached[axis] = a[axis] + (b[axis] - a[axis]) * along
                    best = d
                    best_node = node
            else:
                next_node = _node_of(polys, nodes, other)
                if next_node < 0 and nodes < MAX_VISITED:
                    next_node = nodes
                    polys[nodes], closed[nodes] = other, False
                    nodes += 1
                if next_node >= 0 and not closed[next_node]:
                    d, _ = point_to_segment(middle_x, middle_z, a[0], a[2], b[0], b[2])
                    if d <= radius_squared and tail - head < MAX_QUEUE:
                        parent[next_node] = node
                        closed[next_node] = True
                        queue[tail] = next_node
                        tail += 1
            edge = following
    count = 0
    node = best_node
    while node >= 0:
        count += 1
        node = parent[node]
    visited = np.empty(count, np.int64)
    node = best_node
    for i in range(count - 1, -1, -1):
        visited[i] = polys[node]
        node = parent[node]
    return reached, visited


@inlined
def _stop_at_wall(mesh: QueryMesh, start: Point, end: Floats, visited: Indices, reached: Floats) -> None:
    """Move ``reached`` back to the point where the segment from ``start`` to ``end`` crosses a wall of the visited
    polygons. If it crosses several walls, the crossing nearest to ``end`` is taken.
    """
    best = GREATEST
    for poly in visited:
        size = mesh.poly_size[poly]
        for edge in range(size):
            if mesh.neighbours[poly, edge] >= 0:
                continue
            a = mesh.verts[mesh.poly_verts[poly, edge]]
            b = mesh.verts[mesh.poly_verts[poly, edge + 1 if edge + 1 < size else 0]]
            ux, uz = b[0] - a[0], b[2] - a[2]
            vx, vz = end[0] - start[0], end[2] - start[2]
            wx, wz = a[0] - start[0], a[2] - start[2]
            d = ux * vz - uz * vx
            if abs(d) < PARALLEL:
                continue
            s = (vx * wz - vz * wx) / d
            t = (ux * wz - uz * wx) / d
            if ZERO <= t <= ONE and ZERO <= s <= ONE:
                x = a[0] + (b[0] - a[0]) * s
                z = a[2] + (b[2] - a[2]) * s
                dx, dz = end[0] - x, end[2] - z
                from_end = dx * dx + dz * dz
                if from_end < best:
                    best = from_end
                    reached[0] = x
                    reached[1] = a[1] + (b[1] - a[1]) * s
                    reached[2] = z


@compiled
def step(mesh: QueryMesh, start: Place, end: Floats, sliding: bool) -> Place:
    """Return where a move from ``start`` towards ``end`` (3,) ends, as habitat-sim's ``tryStep`` does."""
    end_poly, _, _, _ = nearest_polygon(mesh, end[0], end[1], end[2], ANY_ISLAND)
    place = start
    if start.poly != NO_POLYGON and end_poly != NO_POLYGON and mesh.island[start.poly] == mesh.island[end_poly]:
        reached, visited = move_along_surface(mesh, start, end)
        if visited.shape[0] > 0:
            if not sliding:
                _stop_at_wall(mesh, start.at, end, visited, reached)
            last = visited[-1]
            over, height = height_on_polygon(mesh, last, reached[0], reached[2])
            if over:
                reached[1] = height
            place = place_of(mesh, reached)
            if place.poly == NO_POLYGON or mesh.island[place.poly] != mesh.island[start.poly]:
                _nudge_inwards(mesh, last, reached)
                place = place_of(mesh, reached)
    return place


@inlined
def _nudge_inwards(mesh: QueryMesh, poly: int, point: Floats) -> None:
    """Move a point on the edge between two islands by 0.1 mm towards the middle of its own polygon."""
    x = y = z = ZERO
    size = mesh.poly_size[poly]
    for i in range(size):
        corner = mesh.poly_verts[poly, i]
        x += mesh.verts[corner, 0]
        y += mesh.verts[corner, 1]
        z += mesh.verts[corner, 2]
    x = x / np.float32(size) - point[0]
    y = y / np.float32(size) - point[1]
    z = z / np.float32(size) - point[2]
    length = np.sqrt(x * x + y * y + z * z)
    point[0] = point[0] + NUDGE * (x / length)
    point[1] = point[1] + NUDGE * (y / length)
    point[2] = point[2] + NUDGE * (z / length)


@compiled
def steps(mesh: QueryMesh, starts: Floats, ends: Floats, sliding: bool) -> Floats:
    """Return the end points (n, 3) of n moves from ``starts`` towards ``ends``, each as :func:`step` gives it."""
    reached = np.empty((starts.shape[0], 3), np.float32)
    for i in range(starts.shape[0]):
        place = step(mesh, place_of(mesh, starts[i]), ends[i], sliding)
        for axis in range(3):
            reached[i, axis] = place.asked[axis]
    return reached


@inlined
def nearest_wall(
    mesh: QueryMesh, search: Search, point: Floats, max_radius: np.float32, hit: Floats, normal: Floats
) -> np.float32:
    """Return the horizontal distance from a snapped point to the nearest wall. Write the nearest point on the wall to
    ``hit``, and the wall's normal to ``normal``.

    Off the mesh the distance is infinite, and ``hit`` and ``normal`` are zero. If no wall is within ``max_radius``, the
    distance is that radius, ``hit`` is zero and ``normal`` is computed from this zero point, as in habitat-sim. On a
    wall the normal is NaN.
    """
    hit[:] = ZERO
    normal[:] = ZERO
    place = place_of(mesh, point)
    centre = place.at
    if place.poly == NO_POLYGON:
        return np.float32(np.inf)
    begin_search(search, place.poly, centre, ZERO)
    radius_squared = max_radius * max_radius
    while search.counters[1] > 0:
        poly = pop(search)
        size = mesh.poly_size[poly]
        edge = size - 1
        for following in range(size):
            if _passable(mesh, poly, edge) < 0:
                a = mesh.verts[mesh.poly_verts[poly, edge]]
                b = mesh.verts[mesh.poly_verts[poly, following]]
                d, along = point_to_segment(centre[0], centre[2], a[0], a[2], b[0], b[2])
                if d <= radius_squared:
                    radius_squared = d
                    for axis in range(3):
                        hit[axis] = a[axis] + (b[axis] - a[axis]) * along
            edge = following
        for edge in range(size):
            other = _passable(mesh, poly, edge)
            if other < 0 or other == search.parent[poly]:
                continue
            a = mesh.verts[mesh.poly_verts[poly, edge]]
            b = mesh.verts[mesh.poly_verts[poly, edge + 1 if edge + 1 < size else 0]]
            d, _ = point_to_segment(centre[0], centre[2], a[0], a[2], b[0], b[2])
            if d > radius_squared:
                continue
            if not visit(mesh, search, poly, edge_to(mesh, poly, other), other) and search.state[other] == CLOSED:
                continue
            position = search.position
            total = search.total[poly] + distance(corner(position, poly), corner(position, other))
            if search.state[other] == OPEN and total >= search.total[other]:
                continue
            search.parent[other] = poly
            search.total[other] = total
            push(search, other)
    for axis in range(3):
        normal[axis] = centre[axis] - hit[axis]
    scale = ONE / np.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
    for axis in range(3):
        normal[axis] = normal[axis] * scale
    return np.float32(np.sqrt(radius_squared))


@compiled
def nearest_walls(mesh: QueryMesh, points: Floats, max_radius: np.float32) -> tuple[Floats, Floats, Floats]:
    """Return what :func:`nearest_wall` gives for each of n points: distances (n,), hits (n, 3) and normals (n, 3)."""
    n = points.shape[0]
    distances = np.empty(n, np.float32)
    hits = np.empty((n, 3), np.float32)
    normals = np.empty((n, 3), np.float32)
    search = new_search(mesh.poly_size.shape[0])
    for i in range(n):
        distances[i] = nearest_wall(mesh, search, points[i], max_radius, hits[i], normals[i])
    return distances, hits, normals
