"""Try starts for a program: routes from places to the nearest goal points of objects, each found once a scene."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined
from condvln.episodes.kernels.distances import distance_between, straight_distance
from condvln.episodes.kernels.ways import comes_within, passes_through
from condvln.navigation.kernels.astar import Search, new_search
from condvln.navigation.kernels.mesh import QueryMesh
from condvln.navigation.kernels.straight import MAX_POINTS
from condvln.navigation.tile import Floats, Indices
from condvln.uncounted import keep, uncounted

__all__ = [
    "FITS",
    "FULL",
    "NOTHING_FITS",
    "REFUSALS",
    "KnownWays",
    "Places",
    "first_fit",
    "route_lengths",
]

Doubles = npt.NDArray[np.float64]

FITS, NOTHING_FITS, FULL = 0, 1, 2
"""Outcomes: a start was found; every start was refused; ``KnownWays`` needs more room before the next start."""

REFUSALS = ("unreachable", "path_through_furniture", "path_enters_other_leaf", "route_missed")
"""Reasons why a start is refused, in the order of their counts."""
UNREACHABLE, FURNITURE, OTHER_LEAF, LENGTH = 0, 1, 2, 3
ACCEPTED = -1
NO_ROOM = -2
UNKNOWN = -3

PER_METRE = 1000.0
"""Positions are rounded to 1/1000 m."""


class Places(NamedTuple):
    """The s starts and p goal points of a scene with n objects. A place is a number: a start, or s + a goal point."""

    asked: Floats
    """(s + p, 3) as requested"""
    polys: Indices
    """(s + p,) polygon below"""
    at: Floats
    """(s + p, 3) as projected onto the navmesh"""
    exact: Doubles
    """(s + p, 3) as published"""
    first: Indices
    """(n + 1,) first goal point of each object"""
    distance: Doubles
    """(s, n) geodesic distance from each start to the nearest goal point of each object, metres; NaN if not known"""
    nearest: Indices
    """(s, n) that goal point"""
    center: Doubles
    """(b, 2) rectangles that no path may cross, see ``passes_through``"""
    half: Doubles
    axes: Doubles


class KnownWays(NamedTuple):
    """The ways found so far, from a place to the nearest goal point of an object. Way k has the corners
    ``corners[begin[k] : begin[k] + sizes[k]]``, rounded to 1 mm; none if there is no path.
    """

    keys: Indices
    """(h,) hash table of ``place · n + object``; -1 where it is free"""
    ways: Indices
    """(h,) the way of each key"""
    point: Indices
    """(m,) the goal point"""
    distance: Doubles
    """(m,) metres; infinite without a path"""
    begin: Indices
    sizes: Indices
    crosses: npt.NDArray[np.bool_]
    """(m,) the way crosses a rectangle after its second corner"""
    corners: Doubles
    """(c, 3)"""
    used: Indices
    """(2,) ways, corners"""


@compiled
def _slot(keys: Indices, key: int) -> int:
    """Return the position of a key in the hash table, or the free position where it belongs."""
    mask = keys.shape[0] - 1
    at = (key * 0x9E3779B1) & mask
    while keys[at] != -1 and keys[at] != key:
        at = (at + 1) & mask
    return int(at)


@compiled
def put_keys(keys: Indices, ways: Indices, new_keys: Indices, new_ways: Indices) -> None:
    """Copy a hash table into a larger one."""
    for i in range(keys.shape[0]):
        if keys[i] != -1:
            at = _slot(new_keys, keys[i])
            new_keys[at], new_ways[at] = keys[i], ways[i]


@compiled
def _known_way(keys: Indices, ways: Indices, key: int) -> int:
    """Return the way of a key, or ``UNKNOWN``."""
    at = _slot(keys, key)
    return ways[at] if keys[at] == key else UNKNOWN


@compiled
def _new_way(
    mesh: QueryMesh,
    search: Search,
    places: Places,
    known: KnownWays,
    place: int,
    goal: int,
    points: Floats,
    kept: Floats,
) -> int:
    """Find the way from a place to the nearest goal point of an object, keep it and return it; ``NO_ROOM`` if there is
    no room for it.
    """
    starts = places.distance.shape[0]
    key = place * (places.first.shape[0] - 1) + goal
    at = _slot(known.keys, key)
    way = known.used[0]
    begin = known.used[1]
    if way == known.point.shape[0] or 2 * way >= known.keys.shape[0] or begin + MAX_POINTS > known.corners.shape[0]:
        return NO_ROOM
    best, length, count = places.first[goal], math.inf, 0
    if place < starts:
        best = places.nearest[place, goal]
        length = places.distance[place, goal]
        if length < math.inf:
            _, count = distance_between(mesh, search, places.asked, places.polys, places.at, place, starts + best, kept)
    else:
        for point in range(places.first[goal], places.first[goal + 1]):
            if straight_distance(places.at, place, starts + point) > length:
                continue
            found, corners = distance_between(
                mesh, search, places.asked, places.polys, places.at, place, starts + point, points
            )
            if found < length:
                best, length, count = point, found, corners
                kept[:corners] = points[:corners]
    for i in range(count):
        for axis in range(3):
            known.corners[begin + i, axis] = np.rint(float(kept[i, axis]) * PER_METRE) / PER_METRE + 0.0
    known.keys[at], known.ways[at] = key, way
    known.point[way], known.distance[way] = best, length
    known.begin[way], known.sizes[way] = begin, count
    known.crosses[way] = count > 2 and passes_through(
        known.corners[begin + 1 : begin + count], places.center, places.half, places.axes
    )
    known.used[0], known.used[1] = way + 1, begin + count
    return int(way)


@compiled
def route_lengths(
    mesh: QueryMesh, places: Places, known: KnownWays, moves: Indices, starts: Indices, lengths: Doubles
) -> bool:
    """Write to ``lengths`` (k,) the lengths in metres of the routes from each of k starts through all ``moves``, each
    time to the nearest goal point of the next object. Return whether there was room for all ways.
    """
    mesh, places, known = uncounted((mesh, places, known))
    held = new_search(mesh.poly_size.shape[0]), np.empty((2, MAX_POINTS, 3), np.float32)
    search, corners = uncounted(held)
    points, kept = corners[0], corners[1]
    first, objects = places.distance.shape[0], places.first.shape[0] - 1
    room = True
    for i in range(starts.shape[0]):
        at = places.nearest[starts[i], moves[0]]
        onward = 0.0
        for k in range(1, moves.shape[0]):
            way = _known_way(known.keys, known.ways, (first + at) * objects + moves[k])
            if way == UNKNOWN:
                way = _new_way(mesh, search, places, known, first + at, moves[k], points, kept)
            if way == NO_ROOM:
                room = False
                break
            onward += known.distance[way]
            at = known.point[way]
        if not room:
            break
        lengths[i] = places.distance[starts[i], moves[0]] + onward
    keep(held)
    return room


@inlined
def _extended(path: Doubles, size: int, known: KnownWays, way: int) -> int:
    """Append the corners of a way but its first to a path of ``size`` corners; return the new size."""
    begin = known.begin[way]
    for i in range(1, known.sizes[way]):
        path[size] = known.corners[begin + i]
        size += 1
    return size


@inlined
def _judged(
    mesh: QueryMesh,
    search: Search,
    places: Places,
    known: KnownWays,
    start: int,
    moves: Indices,
    first_move: Indices,
    apart: float,
    least: float,
    most: float,
    paths: Doubles,
    sizes: Indices,
    stops: Indices,
    lengths: Doubles,
    points: Floats,
    kept: Floats,
) -> int:
    """Write the routes of all leaves from a start; return ``ACCEPTED``, why the start is refused, or ``NO_ROOM``."""
    leaves = first_move.shape[0] - 1
    starts, objects = places.distance.shape[0], places.first.shape[0] - 1
    for leaf in range(leaves):
        place, size = start, int(leaves > 0)
        paths[leaf, 0] = places.exact[start]
        lengths[leaf] = 0.0
        crosses = False
        for k in range(first_move[leaf], first_move[leaf + 1]):
            way = _known_way(known.keys, known.ways, place * objects + moves[k])
            if way == UNKNOWN:
                way = _new_way(mesh, search, places, known, place, moves[k], points, kept)
            if way == NO_ROOM:
                return NO_ROOM
            if known.sizes[way] == 0:
                return UNREACHABLE
            before = size
            size = _extended(paths[leaf], size, known, way)
            if size > before:
                first = paths[leaf, before - 1 : before + 1]
                crosses = crosses or known.crosses[way]
                crosses = crosses or passes_through(first, places.center, places.half, places.axes)
            lengths[leaf] += known.distance[way]
            stops[k] = known.point[way]
            place = starts + known.point[way]
        sizes[leaf] = size
        if crosses:
            return FURNITURE
    for leaf in range(leaves):
        for other in range(leaves):
            goal = moves[first_move[other + 1] - 1]
            if leaf != other and comes_within(
                paths[leaf, : sizes[leaf]],
                places.exact[starts + places.first[goal] : starts + places.first[goal + 1]],
                apart,
            ):
                return OTHER_LEAF
    for leaf in range(leaves):
        if not least <= lengths[leaf] <= most:
            return LENGTH
    return ACCEPTED


@compiled
def first_fit(
    mesh: QueryMesh,
    places: Places,
    known: KnownWays,
    moves: Indices,
    first_move: Indices,
    order: Indices,
    apart: float,
    least: float,
    most: float,
    refused: Indices,
) -> tuple[int, int, Doubles, Indices, Indices, Doubles]:
    """Find the first start from which the routes of all leaves meet the rules.

    Parameters
    ----------
    moves : (m,) objects of all leaves; those of leaf k are ``moves[first_move[k] : first_move[k + 1]]``
    order : (t,) starts to try
    apart : metres that a leaf's path must keep from the goals of all other leaves
    least, most : bounds of every route's length, metres
    refused : (4,) to which the number of starts refused for each of ``REFUSALS`` is added

    Returns
    -------
    the outcome; the number of starts that were refused; the corners (c, 3) of the paths of all leaves, with their
    numbers (l,); the goal point (m,) of each move; and the lengths (l,) of the routes in metres
    """
    leaves = first_move.shape[0] - 1
    most_moves = 0
    for leaf in range(leaves):
        most_moves = max(most_moves, first_move[leaf + 1] - first_move[leaf])
    mesh, places, known = uncounted((mesh, places, known))
    held = (
        np.empty((leaves, most_moves * MAX_POINTS + 1, 3)),
        new_search(mesh.poly_size.shape[0]),
        np.empty((2, MAX_POINTS, 3), np.float32),
    )
    paths, search, buffers = uncounted(held)
    points, kept = buffers[0], buffers[1]
    sizes, lengths = np.zeros(leaves, np.int64), np.zeros(leaves)
    stops = np.zeros(moves.shape[0], np.int64)
    outcome, tried = NOTHING_FITS, 0
    while tried < order.shape[0]:
        found = _judged(
            mesh, search, places, known, order[tried], moves, first_move, apart, least, most,
            paths, sizes, stops, lengths, points, kept,
        )  # fmt: skip
        if found == ACCEPTED:
            outcome = FITS
            break
        if found == NO_ROOM:
            outcome = FULL
            break
        refused[found] += 1
        tried += 1
    corners = np.empty((sizes.sum() if outcome == FITS else 0, 3))
    if outcome == FITS:
        used = 0
        for leaf in range(leaves):
            corners[used : used + sizes[leaf]] = paths[leaf, : sizes[leaf]]
            used += sizes[leaf]
    keep(held)
    return outcome, tried, corners, sizes, stops, lengths
