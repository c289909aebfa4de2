"""Shortest paths: habitat-sim's ``PathFinder::findPath`` over Detour's search and string pulling."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled
from condvln.navigation.kernels.astar import Search, find_corridor, new_search
from condvln.navigation.kernels.geometry import ZERO
from condvln.navigation.kernels.mesh import QueryMesh
from condvln.navigation.kernels.projection import ANY_ISLAND, NAN, NO_POLYGON, nearest_polygon, project
from condvln.navigation.kernels.straight import MAX_POINTS, path_length, pull_string
from condvln.navigation.tile import Floats, Indices
from condvln.uncounted import keep, uncounted

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
def route_between(
    mesh: QueryMesh,
    search: Search,
    start: Floats,
    start_poly: int,
    sx: np.float32,
    sy: np.float32,
    sz: np.float32,
    end: Floats,
    end_poly: int,
    ex: np.float32,
    ey: np.float32,
    ez: np.float32,
    points: Floats,
) -> tuple[np.float32, int]:
    """Return the length of the path between two projected points, and its number of corners. The corners are written to
    ``points``. Without a path, the results are infinite and 0.

    ``start`` and ``end`` are the requested points, (sx, sy, sz) and (ex, ey, ez) the snapped ones; the string is pulled
    between the requested ones.
    """
    length, count = INFINITE, 0
    if start_poly != NO_POLYGON and end_poly != NO_POLYGON:
        if _fuzzy_equal(sx, ex) and _fuzzy_equal(sy, ey) and _fuzzy_equal(sz, ez):
            points[0, 0], points[0, 1], points[0, 2] = sx, sy, sz
            points[1, 0], points[1, 1], points[1, 2] = ex, ey, ez
            length, count = ZERO, 2
        elif mesh.island[start_poly] == mesh.island[end_poly]:
            size = find_corridor(mesh, search, start_poly, sx, sy, sz, end_poly, ex, ey, ez)
            if size > 0:
                count = pull_string(mesh, search.corridor, size, start, end, points)
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
    held = (new_search(mesh.poly_size.shape[0]), np.empty((MAX_POINTS, 3), np.float32))
    mesh, starts, ends = uncounted((mesh, starts, ends))
    search, points = uncounted(held)
    start_poly, sx, sy, sz = NO_POLYGON, NAN, NAN, NAN
    end_poly, ex, ey, ez = NO_POLYGON, NAN, NAN, NAN
    used = 0
    for i in range(n):
        start = starts[i if starts.shape[0] > 1 else 0]
        end = ends[i if ends.shape[0] > 1 else 0]
        if i == 0 or starts.shape[0] > 1:
            start_poly, sx, sy, sz = nearest_polygon(mesh, start[0], start[1], start[2], ANY_ISLAND)
        if i == 0 or ends.shape[0] > 1:
            end_poly, ex, ey, ez = nearest_polygon(mesh, end[0], end[1], end[2], ANY_ISLAND)
        length, count = route_between(mesh, search, start, start_poly, sx, sy, sz, end, end_poly, ex, ey, ez, points)
        lengths[i] = length
        counts[i] = count
        if keep_points:
            if used + count > kept.shape[0]:
                grown = np.empty((2 * kept.shape[0] + count, 3), np.float32)
                grown[:used] = kept[:used]
                kept = grown
            kept[used : used + count] = points[:count]
            used += count
    keep(held)
    return lengths, counts, kept[:used] if keep_points else kept


@compiled
def distance_table(mesh: QueryMesh, starts: Floats, ends: Floats) -> Floats:
    """Return the path lengths (n, m) from each of n starts to each of m ends; each point is projected once."""
    table = np.empty((starts.shape[0], ends.shape[0]), np.float32)
    held = (
        new_search(mesh.poly_size.shape[0]),
        np.empty((MAX_POINTS, 3), np.float32),
        project(mesh, starts, ANY_ISLAND),
        project(mesh, ends, ANY_ISLAND),
    )
    mesh, starts, ends = uncounted((mesh, starts, ends))
    search, points, (start_polys, starts_at), (end_polys, ends_at) = uncounted(held)
    for i in range(starts.shape[0]):
        sx, sy, sz = starts_at[i, 0], starts_at[i, 1], starts_at[i, 2]
        for j in range(ends.shape[0]):
            ex, ey, ez = ends_at[j, 0], ends_at[j, 1], ends_at[j, 2]
            table[i, j], _ = route_between(
                mesh, search, starts[i], start_polys[i], sx, sy, sz, ends[j], end_polys[j], ex, ey, ez, points
            )
    keep(held)
    return table


@compiled
def route_to_nearest(
    mesh: QueryMesh, start: Floats, ends: Floats, bounds: Floats, order: npt.NDArray[np.int64]
) -> tuple[np.float32, int, Floats]:
    """Return the shortest of the paths to several ends: its length, the index of its end (-1 for none), and its
    corners.

    Ends are tried in ``order``; an end whose lower bound exceeds the best length so far is skipped, as in habitat-sim.
    """
    held = (new_search(mesh.poly_size.shape[0]), np.empty((MAX_POINTS, 3), np.float32))
    mesh, start, ends = uncounted((mesh, start, ends))
    search, points = uncounted(held)
    best = INFINITE
    goal = -1
    kept = np.empty((0, 3), np.float32)
    start_poly, sx, sy, sz = nearest_polygon(mesh, start[0], start[1], start[2], ANY_ISLAND)
    for i in order:
        if bounds[i] > best or start_poly == NO_POLYGON:
            continue
        end = ends[i]
        end_poly, ex, ey, ez = nearest_polygon(mesh, end[0], end[1], end[2], ANY_ISLAND)
        length, count = route_between(mesh, search, start, start_poly, sx, sy, sz, end, end_poly, ex, ey, ez, points)
        if length < best:
            best = length
            goal = i
            kept = points[:count].copy()
    keep(held)
    return best, goal, kept
