"""Find a corridor of polygons by A*: ``dtNavMeshQuery::findPath`` with its node pool and binary heap.

The corridor depends on which of two equal candidates comes first, so the heap is Detour's own, not a library's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined
from condvln.navigation.kernels.geometry import HALF, ZERO, distance
from condvln.navigation.kernels.mesh import QueryMesh
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
    remaining: Floats
    """straight-line distance from the position to the goal"""
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
        np.empty(polygons, np.float32),
        np.empty(polygons + 1, np.int64),
        np.empty(MAX_CORRIDOR, np.int64),
        np.zeros(2, np.int64),
    )


@compiled
def bubble_up(heap: Indices, total: Floats, place: int, node: int) -> None:
    """Move ``node`` from ``place`` towards the root of the heap as long as its total is less than its parent's. The
    arrays are those of the ``Search``, here and below.
    """
    least = total[node]
    parent = (place - 1) // 2
    while place > 0 and total[heap[parent]] > least:
        heap[place] = heap[parent]
        place = parent
        parent = (place - 1) // 2
    heap[place] = node


@compiled
def push(heap: Indices, total: Floats, counters: Indices, node: int) -> None:
    """Put a node on the heap."""
    counters[1] += 1
    bubble_up(heap, total, counters[1] - 1, node)


@compiled
def moved_up(heap: Indices, total: Floats, counters: Indices, node: int) -> None:
    """Restore the order of the heap after the total of ``node`` has decreased."""
    place = 0
    while place < counters[1] and heap[place] != node:
        place += 1
    if place < counters[1]:
        bubble_up(heap, total, place, node)


@compiled
def pop(heap: Indices, total: Floats, counters: Indices) -> int:
    """Remove and return the node with the least total, which is the root of the heap. As in Detour, the gap at the root
    first sinks to a leaf of the heap; then the heap's last node is put into this gap and rises.
    """
    result = heap[0]
    counters[1] -= 1
    size = counters[1]
    last = heap[size]
    place = 0
    child = 1
    while child < size:
        if child + 1 < size and total[heap[child]] > total[heap[child + 1]]:
            child += 1
        heap[place] = heap[child]
        place = child
        child = place * 2 + 1
    bubble_up(heap, total, place, last)
    return int(result)


@compiled
def edge_to(neighbours: Indices, poly_size: Indices, poly: int, other: int) -> int:
    """Return the first edge of ``poly`` that leads to ``other``, -1 for none. The arrays are those of the
    ``QueryMesh``.
    """
    edge, size = 0, poly_size[poly]
    while edge < size and neighbours[poly, edge] != other:
        edge += 1
    return edge if edge < size else -1


@compiled
def place_at_edge(
    verts: Floats, poly_verts: Indices, poly_size: Indices, position: Floats, poly: int, edge: int, other: int
) -> None:
    """Set the position of the node ``other`` to the middle of an edge of ``poly``. The arrays are those of the
    ``QueryMesh`` and the ``Search``.
    """
    a = poly_verts[poly, edge]
    b = poly_verts[poly, edge + 1 if edge + 1 < poly_size[poly] else 0]
    position[other, 0] = (verts[a, 0] + verts[b, 0]) * HALF
    position[other, 1] = (verts[a, 1] + verts[b, 1]) * HALF
    position[other, 2] = (verts[a, 2] + verts[b, 2]) * HALF


@inlined
def find_corridor(
    mesh: QueryMesh,
    search: Search,
    start: int,
    sx: np.float32,
    sy: np.float32,
    sz: np.float32,
    end: int,
    ex: np.float32,
    ey: np.float32,
    ez: np.float32,
) -> int:
    """Write the polygons from ``start`` to ``end`` into ``search.corridor``; return their number, 0 if there is no
    path.
    """
    corridor = search.corridor
    if start == end:
        corridor[0] = start
        return 1
    search.counters[0] += 1
    this_round = search.counters[0]
    verts, poly_verts, poly_size, neighbours = mesh.verts, mesh.poly_verts, mesh.poly_size, mesh.neighbours
    position, state, total, cost, parent = search.position, search.state, search.total, search.cost, search.parent
    heap, counters, visited, remaining = search.heap, search.counters, search.round, search.remaining
    counters[1] = 0
    visited[start] = this_round
    nodes = 1
    position[start, 0], position[start, 1], position[start, 2] = sx, sy, sz
    remaining[start] = distance(sx, sy, sz, ex, ey, ez)
    parent[start] = -1
    cost[start] = ZERO
    total[start] = remaining[start] * HEURISTIC_SCALE
    state[start] = OPEN
    push(heap, total, counters, start)
    reached = False
    while counters[1] > 0:
        best = pop(heap, total, counters)
        state[best] = CLOSED
        if best == end:
            reached = True
            break
        x, y, z = position[best, 0], position[best, 1], position[best, 2]
        so_far, before = cost[best], parent[best]
        for edge in range(poly_size[best]):
            other = neighbours[best, edge]
            if other < 0 or other == before or not mesh.walkable[other]:
                continue
            if visited[other] != this_round:
                if nodes >= MAX_NODES:
                    return 0
                nodes += 1
                visited[other] = this_round
                state[other] = 0
                place_at_edge(
                    verts, poly_verts, poly_size, position, best, edge, other
                )  # the first edge that leads there
                ahead = distance(position[other, 0], position[other, 1], position[other, 2], ex, ey, ez)
                remaining[other] = ahead
            else:
                ahead = remaining[other]
            step = distance(x, y, z, position[other, 0], position[other, 1], position[other, 2])
            if other == end:
                new_cost = so_far + step + ahead
                new_total = new_cost
            else:
                new_cost = so_far + step
                new_total = new_cost + ahead * HEURISTIC_SCALE
            if state[other] != 0 and new_total >= total[other]:
                continue
            parent[other] = best
            cost[other] = new_cost
            total[other] = new_total
            if state[other] == OPEN:
                moved_up(heap, total, counters, other)
            else:
                state[other] = OPEN
                push(heap, total, counters, other)
    if not reached:
        return 0
    length = 1
    node = end
    while node != start:
        node = parent[node]
        length += 1
        if length > MAX_CORRIDOR:
            return 0
    node = end
    for i in range(length - 1, -1, -1):
        corridor[i] = node
        node = parent[node] if i else node
    return length
