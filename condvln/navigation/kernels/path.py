"""Shortest paths: habitat-sim's ``PathFinder::findPath`` over Detour's A* search (``findPath``) and its funnel
algorithm (``findStraightPath``).

The corridor depends on which of two equal candidates comes first, so the heap is Detour's own, not a library's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined
from condvln.navigation.kernels.mesh import (
    HALF,
    ZERO,
    Point,
    QueryMesh,
    clamp_to_polygon,
    corner,
    distance,
    point_to_segment,
    turn,
)
from condvln.navigation.kernels.projection import NO_POLYGON, Place, place_of
from condvln.navigation.tile import Floats, Indices

MAX_CORRIDOR = 256  # in polygons; habitat-sim treats a longer path as unreachable
MAX_NODES = 2048  # size of Detour's node pool; if it is exhausted, the goal counts as unreachable, too
HEURISTIC_SCALE = np.float32(0.999)
OPEN, CLOSED = 1, 2


class Search(NamedTuple):
    """Working memory of one thread for searches over p polygons. Each polygon is one node. A node counts as visited if
    its entry in ``round`` is the number of the current search round.
    """

    round: Indices
    parent: Indices
    state: npt.NDArray[np.uint8]
    cost: Floats
    total: Floats
    position: Floats
    heap: Indices
    corridor: Indices
    counters: Indices
    """(2,): current round, size of the heap"""


@compiled
def new_search(polygons: int) -> Search:
    """Return empty working memory."""
    return Search(
        np.zeros(polygons, np.int64),
        np.empty(polygons, np.int64),
        np.empty(polygons, np.uint8),
        np.empty(polygons, np.float32),
        np.empty(polygons, np.float32),
        np.empty((polygons, 3), np.float32),
        np.empty(polygons + 1, np.int64),
        np.empty(MAX_CORRIDOR, np.int64),
        np.zeros(2, np.int64),
    )


@compiled
def bubble_up(search: Search, place: int, node: int) -> None:
    """Move ``node`` from ``place`` towards the root of the heap as long as its total is less than its parent's."""
    heap, total = search.heap, search.total
    parent = (place - 1) // 2
    while place > 0 and total[heap[parent]] > total[node]:
        heap[place] = heap[parent]
        place = parent
        parent = (place - 1) // 2
    heap[place] = node


@compiled
def push(search: Search, node: int) -> None:
    """Open a node, or restore the order of the heap after the total of an open node has decreased."""
    place = 0
    if search.state[node] == OPEN:
        while search.heap[place] != node:
            place += 1
    else:
        search.state[node] = OPEN
        place = search.counters[1]
        search.counters[1] += 1
    bubble_up(search, place, node)


@compiled
def pop(search: Search) -> int:
    """Close and return the node with the least total, which is the root of the heap. As in Detour, the gap at the root
    first sinks to a leaf of the heap; then the heap's last node is put into this gap and rises.
    """
    heap, total = search.heap, search.total
    result = int(heap[0])
    search.counters[1] -= 1
    size = search.counters[1]
    last = heap[size]
    place = 0
    child = 1
    while child < size:
        if child + 1 < size and total[heap[child]] > total[heap[child + 1]]:
            child += 1
        heap[place] = heap[child]
        place = child
        child = place * 2 + 1
    bubble_up(search, place, last)
    search.state[result] = CLOSED
    return result


@compiled
def begin_search(search: Search, start: int, at: Point, total: np.float32) -> None:
    """Begin a new round with one open node."""
    search.counters[0] += 1
    search.counters[1] = 0
    search.round[start] = search.counters[0]
    search.state[start] = 0
    search.parent[start] = -1
    search.cost[start] = ZERO
    search.total[start] = total
    for axis in range(3):
        search.position[start, axis] = at[axis]
    push(search, start)


@compiled
def visit(mesh: QueryMesh, search: Search, poly: int, edge: int, other: int) -> bool:
    """Make ``other`` a node of this round, placed in the middle of an edge of ``poly``. Return whether it is new."""
    if search.round[other] == search.counters[0]:
        return False
    search.round[other] = search.counters[0]
    search.state[other] = 0
    a = mesh.poly_verts[poly, edge]
    b = mesh.poly_verts[poly, edge + 1 if edge + 1 < mesh.poly_size[poly] else 0]
    for axis in range(3):
        search.position[other, axis] = (mesh.verts[a, axis] + mesh.verts[b, axis]) * HALF
    return True


@compiled
def edge_to(mesh: QueryMesh, poly: int, other: int) -> int:
    """Return the first edge of ``poly`` that leads to ``other``, -1 for none."""
    edge, size = 0, mesh.poly_size[poly]
    while edge < size and mesh.neighbours[poly, edge] != other:
        edge += 1
    return edge if edge < size else -1


@inlined
def find_corridor(mesh: QueryMesh, search: Search, start: Place, end: Place) -> int:
    """Write the polygons from ``start`` to ``end`` into ``search.corridor``; return their number, 0 if there is no
    path.
    """
    corridor, position, parent = search.corridor, search.position, search.parent
    if start.poly == end.poly:
        corridor[0] = start.poly
        return 1
    begin_search(search, start.poly, start.at, distance(start.at, end.at) * HEURISTIC_SCALE)
    nodes = 1
    reached = False
    while search.counters[1] > 0:
        best = pop(search)
        if best == end.poly:
            reached = True
            break
        for edge in range(mesh.poly_size[best]):
            other = mesh.neighbours[best, edge]
            if other < 0 or other == parent[best] or not mesh.walkable[other]:
                continue
            if visit(mesh, search, best, edge, other):
                nodes += 1
                if nodes > MAX_NODES:
                    return 0
            ahead = distance(corner(position, other), end.at)
            new_cost = search.cost[best] + distance(corner(position, best), corner(position, other))
            if other == end.poly:
                new_cost = new_cost + ahead
                new_total = new_cost
            else:
                new_total = new_cost + ahead * HEURISTIC_SCALE
            if search.state[other] != 0 and new_total >= search.total[other]:
                continue
            parent[other] = best
            search.cost[other] = new_cost
            search.total[other] = new_total
            push(search, other)
    if not reached:
        return 0
    length = 1
    node = end.poly
    while node != start.poly:
        node = parent[node]
        length += 1
        if length > MAX_CORRIDOR:
            return 0
    node = end.poly
    for i in range(length - 1, -1, -1):
        corridor[i] = node
        node = parent[node] if i else node
    return length


MAX_POINTS = 256  # habitat-sim's buffer; a path that fills it counts as unreachable
# Squared metres: points nearer than 1/16384 m are equal; a portal nearer than 1 mm to the start counts as passed.
SAME_POINT = np.float32(1.0 / 16384.0) * np.float32(1.0 / 16384.0)
AT_PORTAL = np.float32(0.001) * np.float32(0.001)


@compiled
def _same_point(a: Point, b: Point) -> bool:
    """Return whether two points are less than 1/16384 m apart."""
    dx = b[0] - a[0]
    dy = b[1] - a[1]
    dz = b[2] - a[2]
    return bool(dx * dx + dy * dy + dz * dz < SAME_POINT)


@compiled
def _append(points: Floats, count: int, point: Point) -> int:
    """Append a point unless it repeats the last one; return the new number of points."""
    if count > 0 and _same_point(corner(points, count - 1), point):
        return count
    for axis in range(3):
        points[count, axis] = point[axis]
    return count + 1


@inlined
def pull_string(mesh: QueryMesh, corridor: Indices, size: int, start: Point, end: Point, points: Floats) -> int:
    """Write to ``points`` the corners of the shortest path through the first ``size`` polygons of ``corridor``. The
    path runs between the requested points, not the snapped ones.

    Returns the number of points, or 0 if they fill the buffer.
    """
    first, last = clamp_to_polygon(mesh, corridor[0], start), clamp_to_polygon(mesh, corridor[size - 1], end)
    count = _append(points, 0, first)
    apex, left, right = first, first, first
    left_index = 0
    right_index = 0
    i = 0
    while i < size and size > 1:
        new_left, new_right = last, last
        if i + 1 < size:
            poly = corridor[i]
            edge = edge_to(mesh, poly, corridor[i + 1])
            new_left = corner(mesh.verts, mesh.poly_verts[poly, edge])
            new_right = corner(mesh.verts, mesh.poly_verts[poly, edge + 1 if edge + 1 < mesh.poly_size[poly] else 0])
            if i == 0:
                d, _ = point_to_segment(apex[0], apex[2], new_left[0], new_left[2], new_right[0], new_right[2])
                if d < AT_PORTAL:
                    i += 1
                    continue
        turned = 0  # 1: the right side crossed the left one, which becomes a corner; 2: the reverse
        if turn(apex, right, new_right) <= ZERO:
            if _same_point(apex, right) or turn(apex, left, new_right) > ZERO:
                right, right_index = new_right, i
            else:
                turned = 1
        if turned == 0 and turn(apex, left, new_left) >= ZERO:
            if _same_point(apex, left) or turn(apex, right, new_left) < ZERO:
                left, left_index = new_left, i
            else:
                turned = 2
        if turned:
            i = left_index if turned == 1 else right_index
            apex = left if turned == 1 else right
            before = count
            count = _append(points, count, apex)
            if count >= MAX_POINTS:
                return 0
            if count > before and i == size - 1:
                return count  # the corner is the end itself
            left, right, left_index, right_index = apex, apex, i, i
        i += 1
    count = _append(points, count, last)
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


INFINITE = np.float32(np.inf)
# Magnum's absolute and relative tolerance, under which habitat-sim treats two snapped points as equal.
FUZZY = np.float32(1e-5)


@compiled
def _fuzzy_equal(a: np.float32, b: np.float32) -> bool:
    """Return whether two numbers are equal up to rounding errors: Magnum's ``TypeTraits<Float>::equals``."""
    if a == b:
        return True
    difference = abs(a - b)
    if a == ZERO or b == ZERO or difference < FUZZY:
        return bool(difference < FUZZY)
    return bool(difference / (abs(a) + abs(b)) < FUZZY)


@compiled
def route_between(mesh: QueryMesh, search: Search, start: Place, end: Place, points: Floats) -> tuple[np.float32, int]:
    """Return the length of the path between two places, and its number of corners. The corners are written to
    ``points``. Without a path, the results are infinite and 0.

    The string is pulled between the requested points, not the snapped ones.
    """
    length, count = INFINITE, 0
    if start.poly != NO_POLYGON and end.poly != NO_POLYGON:
        a, b = start.at, end.at
        if _fuzzy_equal(a[0], b[0]) and _fuzzy_equal(a[1], b[1]) and _fuzzy_equal(a[2], b[2]):
            for axis in range(3):
                points[0, axis], points[1, axis] = a[axis], b[axis]
            length, count = ZERO, 2
        elif mesh.island[start.poly] == mesh.island[end.poly]:
            size = find_corridor(mesh, search, start, end)
            if size > 0:
                count = pull_string(mesh, search.corridor, size, start.asked, end.asked, points)
            if count > 0:
                length = path_length(points, count)
    return length, count


@compiled
def routes(mesh: QueryMesh, starts: Floats, ends: Floats, keep_points: bool) -> tuple[Floats, Indices, Floats]:
    """Return the paths of n pairs: lengths (n,), numbers of corners (n,), and the corners of all paths in one array.
    This array is empty unless ``keep_points``.

    A single start is paired with every end, and a single end with every start; the single point is projected once.
    """
    n = max(starts.shape[0], ends.shape[0]) if min(starts.shape[0], ends.shape[0]) > 0 else 0
    lengths = np.empty(n, np.float32)
    counts = np.empty(n, np.int64)
    kept = np.empty((n * 4 + MAX_POINTS if keep_points else 0, 3), np.float32)
    search, points = new_search(mesh.poly_size.shape[0]), np.empty((MAX_POINTS, 3), np.float32)
    used = 0
    for i in range(n):
        if i == 0 or starts.shape[0] > 1:
            start = place_of(mesh, starts[i])
        if i == 0 or ends.shape[0] > 1:
            end = place_of(mesh, ends[i])
        lengths[i], count = route_between(mesh, search, start, end, points)
        counts[i] = count
        if keep_points:
            if used + count > kept.shape[0]:
                grown = np.empty((2 * kept.shape[0] + count, 3), np.float32)
                grown[:used] = kept[:used]
                kept = grown
            kept[used : used + count] = points[:count]
            used += count
    return lengths, counts, kept[:used] if keep_points else kept


@compiled
def distance_table(mesh: QueryMesh, starts: Floats, ends: Floats) -> Floats:
    """Return the path lengths (n, m) from each of n starts to each of m ends; each point is projected once."""
    goals = [place_of(mesh, end) for end in ends]
    table = np.empty((starts.shape[0], ends.shape[0]), np.float32)
    search, points = new_search(mesh.poly_size.shape[0]), np.empty((MAX_POINTS, 3), np.float32)
    for i in range(starts.shape[0]):
        start = place_of(mesh, starts[i])
        for j in range(ends.shape[0]):
            table[i, j], _ = route_between(mesh, search, start, goals[j], points)
    return table


@compiled
def route_to_nearest(
    mesh: QueryMesh, start: Floats, ends: Floats, bounds: Floats, order: npt.NDArray[np.int64]
) -> tuple[np.float32, int, Floats]:
    """Return the shortest of the paths to several ends: its length, the index of its end (-1 for none), and its
    corners.

    Ends are tried in ``order``; an end whose lower bound exceeds the best length so far is skipped, as in habitat-sim.
    """
    search, points = new_search(mesh.poly_size.shape[0]), np.empty((MAX_POINTS, 3), np.float32)
    best = INFINITE
    goal = -1
    kept = np.empty((0, 3), np.float32)
    begin = place_of(mesh, start)
    for i in order:
        if bounds[i] > best:
            continue
        length, count = route_between(mesh, search, begin, place_of(mesh, ends[i]), points)
        if length < best:
            best = length
            goal = i
            kept = points[:count].copy()
    return best, goal, kept
