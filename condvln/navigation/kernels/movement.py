"""Steps along the floor and distances to walls: Detour's ``moveAlongSurface`` and ``findDistanceToWall``.

They are combined as in habitat-sim 0.3.4's ``tryStep``: heights from the detail mesh, no crossing of walls without
thickness, and, if sliding is off, a stop at the first wall that the step hits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined
from condvln.navigation.kernels.astar import (
    CLOSED,
    OPEN,
    Search,
    edge_to,
    moved_up,
    new_search,
    place_at_edge,
    pop,
    push,
)
from condvln.navigation.kernels.geometry import GREATEST, HALF, ONE, ZERO, distance, inside_polygon, point_to_segment
from condvln.navigation.kernels.mesh import QueryMesh
from condvln.navigation.kernels.projection import ANY_ISLAND, NO_POLYGON, height_on_polygon, nearest_polygon
from condvln.navigation.tile import Floats, Indices
from condvln.uncounted import keep, uncounted

MAX_VISITED = 64  # size of Detour's small node pool
MAX_QUEUE = 48  # size of its queue
SEARCH_SLACK = np.float32(0.001)  # metres added to the search radius around the step's middle
PARALLEL = np.float32(1e-6)  # m²: segments with a smaller cross product don't intersect
NUDGE = np.float32(1e-4)  # metres; habitat-sim moves points this far off an edge shared by two islands


class Place(NamedTuple):
    """A position and its projection onto the navmesh."""

    asked: Floats
    """(3,) as requested"""
    at: Floats
    """(3,) as projected"""
    poly: Indices
    """(1,) polygon of the projection"""


class StepMemory(NamedTuple):
    """Working memory of one thread for a step, which visits at most 64 polygons."""

    polys: Indices
    parent: Indices
    closed: npt.NDArray[np.bool_]
    queue: Indices
    visited: Indices
    """polygons that the step passes through"""
    end: Floats
    """(3,) where the step leads to"""


@compiled
def new_step_memory() -> StepMemory:
    """Return empty working memory."""
    return StepMemory(
        np.empty(MAX_VISITED, np.int64),
        np.empty(MAX_VISITED, np.int64),
        np.empty(MAX_VISITED, np.bool_),
        np.empty(MAX_VISITED, np.int64),
        np.empty(MAX_VISITED, np.int64),
        np.empty(3, np.float32),
    )


@compiled
def new_place() -> Place:
    """Return a place whose numbers are not set."""
    return Place(np.empty(3, np.float32), np.empty(3, np.float32), np.empty(1, np.int64))


@compiled
def put(mesh: QueryMesh, point: Floats, place: Place) -> None:
    """Set a place to a point (3,)."""
    poly, x, y, z = nearest_polygon(mesh, point[0], point[1], point[2], ANY_ISLAND)
    place.poly[0], place.at[0], place.at[1], place.at[2] = poly, x, y, z
    for axis in range(3):
        place.asked[axis] = point[axis]


@compiled
def copy_place(source: Place, target: Place) -> None:
    """Set a place to another one."""
    for axis in range(3):
        target.asked[axis] = source.asked[axis]
        target.at[axis] = source.at[axis]
    target.poly[0] = source.poly[0]


@compiled
def _passable(neighbours: Indices, walkable: npt.NDArray[np.uint8], poly: int, edge: int) -> int:
    """Return the walkable polygon across an edge, or -1."""
    other = int(neighbours[poly, edge])  # -1 for a wall
    if walkable[max(other, 0)] == 0:
        other = -1
    return other


@inlined
def _node_of(polys: Indices, count: int, poly: int) -> int:
    for node in range(count):
        if polys[node] == poly:
            return node
    return -1


@inlined
def move_along_surface(mesh: QueryMesh, start_poly: int, start: Floats, reached: Floats, memory: StepMemory) -> int:
    """Slide from ``start`` towards ``memory.end``. Write the final position to ``reached`` and the polygons on the path
    to ``memory.visited``; return the number of these polygons.
    """
    polys, parent, closed, queue, end = memory.polys, memory.parent, memory.closed, memory.queue, memory.end
    polys[0], parent[0], closed[0], queue[0] = start_poly, -1, True, 0
    nodes, head, tail = int(ONE), 0, 1  # a literal would make numba compile the callees again
    best_node = -1
    best = GREATEST
    for axis in range(3):
        reached[axis] = start[axis]
    middle_x = start[0] + (end[0] - start[0]) * HALF
    middle_z = start[2] + (end[2] - start[2]) * HALF
    radius = distance(start[0], start[1], start[2], end[0], end[1], end[2]) / np.float32(2.0) + SEARCH_SLACK
    radius_squared = radius * radius
    while head < tail:
        node = queue[head]
        head += 1
        poly = polys[node]
        if inside_polygon(mesh.verts, mesh.poly_verts, mesh.poly_size, poly, end[0], end[2]):
            best_node = node
            for axis in range(3):
                reached[axis] = end[axis]
            break
        size = mesh.poly_size[poly]
        edge = size - 1
        for following in range(size):
            a = mesh.verts[mesh.poly_verts[poly, edge]]
            b = mesh.verts[mesh.poly_verts[poly, following]]
            other = _passable(mesh.neighbours, mesh.walkable, poly, edge)
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
    node = best_node
    for i in range(count - 1, -1, -1):
        memory.visited[i] = polys[node]
        node = parent[node]
    return count


@inlined
def _stop_at_wall(mesh: QueryMesh, start: Floats, end: Floats, visited: Indices, count: int, reached: Floats) -> None:
    """Move ``reached`` back to the point where the segment from ``start`` to ``end`` crosses a wall of the visited
    polygons. If it crosses several walls, the crossing nearest to ``end`` is taken.
    """
    best = GREATEST
    for i in range(count):
        poly = visited[i]
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
def step(mesh: QueryMesh, start: Place, sliding: bool, memory: StepMemory, reached: Place) -> None:
    """Move from ``start`` towards ``memory.end`` as habitat-sim's ``tryStep`` does, and write the final position to
    ``reached``.
    """
    copy_place(start, reached)
    poly, end = start.poly[0], memory.end
    end_poly, _, _, _ = nearest_polygon(mesh, end[0], end[1], end[2], ANY_ISLAND)
    if poly != NO_POLYGON and end_poly != NO_POLYGON and mesh.island[poly] == mesh.island[end_poly]:
        island = mesh.island[poly]
        count = move_along_surface(mesh, poly, start.at, reached.asked, memory)
        if count == 0:
            copy_place(start, reached)
        else:
            if not sliding:
                _stop_at_wall(mesh, start.at, end, memory.visited, count, reached.asked)
            last = memory.visited[count - 1]
            over, height = height_on_polygon(
                mesh.verts, mesh.poly_verts, mesh.poly_size, mesh.tri_start, mesh.tri_points, mesh.tri_edges,
                last, reached.asked[0], reached.asked[2],
            )  # fmt: skip
            if over:
                reached.asked[1] = height
            put(mesh, reached.asked, reached)
            if reached.poly[0] == NO_POLYGON or mesh.island[reached.poly[0]] != island:
                _nudge_inwards(mesh, last, reached.asked)
                put(mesh, reached.asked, reached)


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
    mesh, starts, held = uncounted(mesh), uncounted(starts), (new_step_memory(), new_place(), new_place())
    memory, begin, place = uncounted(held)
    for i in range(starts.shape[0]):
        put(mesh, starts[i], begin)
        for axis in range(3):
            memory.end[axis] = ends[i, axis]
        step(mesh, begin, sliding, memory, place)
        for axis in range(3):
            reached[i, axis] = place.asked[axis]
    keep(held)
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
    centre = np.empty(3, np.float32)
    start, centre[0], centre[1], centre[2] = nearest_polygon(mesh, point[0], point[1], point[2], ANY_ISLAND)
    if start == NO_POLYGON:
        return np.float32(np.inf)
    search.counters[0] += 1
    this_round = search.counters[0]
    search.counters[1] = 0
    search.round[start] = this_round
    search.position[start] = centre
    search.parent[start] = -1
    search.total[start] = ZERO
    search.state[start] = OPEN
    push(search.heap, search.total, search.counters, start)
    radius_squared = max_radius * max_radius
    while search.counters[1] > 0:
        poly = pop(search.heap, search.total, search.counters)
        search.state[poly] = CLOSED
        size = mesh.poly_size[poly]
        edge = size - 1
        for following in range(size):
            if _passable(mesh.neighbours, mesh.walkable, poly, edge) < 0:
                a = mesh.verts[mesh.poly_verts[poly, edge]]
                b = mesh.verts[mesh.poly_verts[poly, following]]
                d, along = point_to_segment(centre[0], centre[2], a[0], a[2], b[0], b[2])
                if d <= radius_squared:
                    radius_squared = d
                    for axis in range(3):
                        hit[axis] = a[axis] + (b[axis] - a[axis]) * along
            edge = following
        for edge in range(size):
            other = _passable(mesh.neighbours, mesh.walkable, poly, edge)
            if other < 0 or other == search.parent[poly]:
                continue
            a = mesh.verts[mesh.poly_verts[poly, edge]]
            b = mesh.verts[mesh.poly_verts[poly, edge + 1 if edge + 1 < size else 0]]
            d, _ = point_to_segment(centre[0], centre[2], a[0], a[2], b[0], b[2])
            if d > radius_squared:
                continue
            if search.round[other] != this_round:
                search.round[other] = this_round
                search.state[other] = 0
                first = edge_to(mesh.neighbours, mesh.poly_size, poly, other)
                place_at_edge(mesh.verts, mesh.poly_verts, mesh.poly_size, search.position, poly, first, other)
            elif search.state[other] == CLOSED:
                continue
            p, q = search.position[poly], search.position[other]
            total = search.total[poly] + distance(p[0], p[1], p[2], q[0], q[1], q[2])
            if search.state[other] == OPEN and total >= search.total[other]:
                continue
            search.parent[other] = poly
            search.total[other] = total
            if search.state[other] == OPEN:
                moved_up(search.heap, search.total, search.counters, other)
            else:
                search.state[other] = OPEN
                push(search.heap, search.total, search.counters, other)
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
    mesh, held = uncounted(mesh), new_search(mesh.poly_size.shape[0])
    search = uncounted(held)
    for i in range(n):
        distances[i] = nearest_wall(mesh, search, points[i], max_radius, hits[i], normals[i])
    keep(held)
    return distances, hits, normals
