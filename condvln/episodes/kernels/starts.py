"""Try starts for a program: routes from places to the nearest goal points of objects, each found once a scene and only
if some rule depends on it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined
from condvln.episodes.kernels.distances import (
    comes_within,
    distance_between,
    nearest_point,
    passes_through,
    straight_distance,
    straight_to_object,
)
from condvln.navigation.kernels.mesh import QueryMesh
from condvln.navigation.kernels.path import MAX_POINTS, Search, new_search
from condvln.navigation.tile import Floats, Indices

__all__ = [
    "FITS",
    "FULL",
    "NOTHING_FITS",
    "REFUSALS",
    "Bounds",
    "KnownWays",
    "Places",
    "first_fit",
    "possible_starts",
]

Doubles = npt.NDArray[np.float64]

FITS, NOTHING_FITS, FULL = 0, 1, 2
"""Outcomes: a start was found; every start was refused; ``KnownWays`` needs more room before the next start."""
OUT_OF_RANGE, DETOUR, TOO_FAR = 3, 4, 5
"""Rules that none of the starts meets."""

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


class Bounds(NamedTuple):
    """Where a program may start, by distances along the floor. All in metres, but the factor."""

    near: float
    """A start must be farther than this from every stop and goal."""
    low: float
    """least and greatest distance to the goals"""
    high: float
    factor: float
    """A route with stops may have at most this factor times the distance to its goal by way of its leads, plus the
    slack."""
    slack: float
    least: float
    """least and greatest length of all routes"""
    most: float


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
def _from_start(mesh: QueryMesh, search: Search, places: Places, start: int, goal: int, points: Floats) -> float:
    """Return the distance from a start to the nearest goal point of an object. It is found once, with that point."""
    length = places.distance[start, goal]
    if math.isnan(length):
        starts, first = places.distance.shape[0], places.first
        length, point = nearest_point(
            mesh, search, places.asked, places.polys, places.at, start, starts + first[goal], starts + first[goal + 1],
            points,
        )  # fmt: skip
        places.distance[start, goal], places.nearest[start, goal] = length, point - starts
    return float(length)


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
        length = _from_start(mesh, search, places, place, goal, points)
        best = places.nearest[place, goal]
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
def _way(
    mesh: QueryMesh,
    search: Search,
    places: Places,
    known: KnownWays,
    place: int,
    goal: int,
    points: Floats,
    kept: Floats,
) -> int:
    """Return the way from a place to the nearest goal point of an object, which is found once; or ``NO_ROOM``."""
    way = _known_way(known.keys, known.ways, place * (places.first.shape[0] - 1) + goal)
    return int(_new_way(mesh, search, places, known, place, goal, points, kept) if way == UNKNOWN else way)


@inlined
def _in_range(
    mesh: QueryMesh,
    search: Search,
    places: Places,
    start: int,
    moves: Indices,
    first_move: Indices,
    bounds: Bounds,
    points: Floats,
) -> bool:
    """Return whether all stops and goals are far enough from a start, and no goal is too far. The straight lines to all
    of them are tested before the first path is sought.
    """
    first, starts = places.first, places.distance.shape[0]
    good = True
    for turn in range(2):
        for leaf in range(first_move.shape[0] - 1):
            for k in range(first_move[leaf], first_move[leaf + 1]):
                if not good:
                    break
                move, is_goal = moves[k], k == first_move[leaf + 1] - 1
                away = places.distance[start, move]
                if math.isnan(away):
                    straight = straight_to_object(places.at, start, starts + first[move], starts + first[move + 1])
                    good = not (is_goal and straight > bounds.high)
                    if turn == 0 or not good or (straight > bounds.near and not is_goal):
                        continue
                    away = _from_start(mesh, search, places, start, move, points)
                good = away > bounds.near and (not is_goal or bounds.low <= away <= bounds.high)
    return good


@inlined
def _detour(
    mesh: QueryMesh,
    search: Search,
    places: Places,
    known: KnownWays,
    start: int,
    moves: Indices,
    first_move: Indices,
    leads: Indices,
    bounds: Bounds,
    points: Floats,
    kept: Floats,
) -> int:
    """Return ``ACCEPTED`` if no leaf's route from a start is too long for the distance to its goal by way of its leads,
    ``DETOUR`` if one is, or ``NO_ROOM``.
    """
    starts = places.distance.shape[0]
    result = ACCEPTED
    for leaf in range(first_move.shape[0] - 1):
        begin, end = first_move[leaf], first_move[leaf + 1]
        if result != ACCEPTED or end - begin < 2:
            continue
        length, direct, place = 0.0, places.distance[start, moves[end - 1]], start
        for k in range(begin, end):
            way = -1
            if k == begin:
                length = _from_start(mesh, search, places, start, moves[begin], points)
                place = starts + places.nearest[start, moves[begin]]
            else:
                way = _way(mesh, search, places, known, place, moves[k], points, kept)
                if way != NO_ROOM:
                    length += known.distance[way]
                    place = starts + known.point[way]
            if way != NO_ROOM and k == begin + leads[leaf] - 1:
                way = _way(mesh, search, places, known, place, moves[end - 1], points, kept)
                if way != NO_ROOM:
                    direct = length + known.distance[way]
            if way == NO_ROOM:
                result = NO_ROOM
                break
        if result == ACCEPTED and not length <= bounds.factor * direct + bounds.slack:
            result = DETOUR
    return result


@inlined
def _can_have_length(
    places: Places, start: int, moves: Indices, first_move: Indices, least: float, most: float
) -> bool:
    """Return whether the route of every leaf can have a length from ``least`` to ``most``: a route is never shorter
    than the distance to its goal, and equal to it if the leaf has a single stop.
    """
    good = True
    for leaf in range(first_move.shape[0] - 1):
        direct = places.distance[start, moves[first_move[leaf + 1] - 1]]
        good = good and direct <= most and (direct >= least or first_move[leaf + 1] - first_move[leaf] > 1)
    return good


@compiled
def possible_starts(
    mesh: QueryMesh,
    places: Places,
    known: KnownWays,
    moves: Indices,
    first_move: Indices,
    leads: Indices,
    bounds: Bounds,
    possible: Indices,
) -> tuple[int, int]:
    """Write the starts within the ``bounds`` of a program to ``possible`` (s,), ascending.

    Returns
    -------
    their number; and ``FITS``, ``FULL`` if there was no room for all ways, or else the rule that none of the starts
    meets which meet the rules before it: ``OUT_OF_RANGE``, ``DETOUR`` or ``TOO_FAR``
    """
    search, corners = new_search(mesh.poly_size.shape[0]), np.empty((2, MAX_POINTS, 3), np.float32)
    points, kept = corners[0], corners[1]
    count, outcome = 0, OUT_OF_RANGE
    # Lengths need no further path, so they come before detours. If no start is left, it is asked again whether all that
    # were in range were detours.
    for turn in range(2):
        for start in range(places.distance.shape[0]):
            if outcome == FULL or (turn == 1 and outcome != DETOUR):
                break
            if not _in_range(mesh, search, places, start, moves, first_move, bounds, points):
                continue
            if turn == 0:
                outcome = DETOUR if outcome == OUT_OF_RANGE else outcome
                if not _can_have_length(places, start, moves, first_move, bounds.least, bounds.most):
                    continue
            judged = ACCEPTED
            if bounds.factor < math.inf:
                judged = _detour(mesh, search, places, known, start, moves, first_move, leads, bounds, points, kept)
            if judged == NO_ROOM:
                outcome = FULL
            elif judged == ACCEPTED and turn == 1:
                outcome = TOO_FAR
            elif judged == ACCEPTED:
                possible[count] = start
                count += 1
                outcome = FITS
    return count, outcome


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
    starts = places.distance.shape[0]
    for leaf in range(leaves):
        place, size = start, int(leaves > 0)
        paths[leaf, 0] = places.exact[start]
        lengths[leaf] = 0.0
        crosses = False
        for k in range(first_move[leaf], first_move[leaf + 1]):
            way = _way(mesh, search, places, known, place, moves[k], points, kept)
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
) -> tuple[int, int, Doubles, Indices, Indices, Doubles, Doubles, Indices]:
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
    numbers (l,); the goal point (m,) of each move; the lengths (l,) of the routes in metres; and of each leaf the
    distance (l,) in metres from the start to the nearest goal point, with that point (l,)
    """
    leaves = first_move.shape[0] - 1
    most_moves = 0
    for leaf in range(leaves):
        most_moves = max(most_moves, first_move[leaf + 1] - first_move[leaf])
    paths = np.empty((leaves, most_moves * MAX_POINTS + 1, 3))
    search, buffers = new_search(mesh.poly_size.shape[0]), np.empty((2, MAX_POINTS, 3), np.float32)
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
    direct, nearest = np.empty(leaves), np.empty(leaves, np.int64)
    if outcome == FITS:
        used = 0
        for leaf in range(leaves):
            goal = moves[first_move[leaf + 1] - 1]
            direct[leaf] = _from_start(mesh, search, places, order[tried], goal, points)
            nearest[leaf] = places.nearest[order[tried], goal]
            corners[used : used + sizes[leaf]] = paths[leaf, : sizes[leaf]]
            used += sizes[leaf]
    return outcome, tried, corners, sizes, stops, lengths, direct, nearest
