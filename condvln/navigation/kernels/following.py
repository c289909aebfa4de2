"""Walk to goals with discrete actions: greedily by geodesic distance, with a search around obstacles.

The direction rule is that of habitat-lab's ``ShortestPathFollower`` (MIT): continue as long as the path's direction is
within one turn of the heading. In addition, each step is tried on the navmesh before it is taken.

Without sliding, an agent that touches a wall may be unable to leave it: habitat-sim stops a step at the first wall, and
a step that begins at a wall hits it at once. Such walks avoid contact as long as they make progress without it, and
touch a wall only where some step leads on from there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined
from condvln.navigation.kernels.mesh import ZERO, Point, QueryMesh
from condvln.navigation.kernels.movement import step
from condvln.navigation.kernels.path import INFINITE, MAX_POINTS, Search, new_search, route_between
from condvln.navigation.kernels.projection import Place, place_of
from condvln.navigation.tile import Floats, Indices

STOP, FORWARD, LEFT, RIGHT = 0, 1, 2, 3  # the action ids of VLN-CE
ARRIVED, NO_PATH, STUCK, TOO_LONG = 0, 1, 2, 3

# Metres: a path corner nearer than this gives no direction; the next corner is used.
TOO_NEAR_TO_AIM = np.float32(0.01)
# A step is taken without comparing all headings if it shortens the path by this share of a full step.
GOOD_PROGRESS = np.float32(0.9)
# Without sliding, steps that end at a wall are also considered if progress is below this share of a full step.
SLOW_PROGRESS = np.float32(0.25)
# Metres: a step that shortens the path by less is not progress.
LEAST_PROGRESS = np.float32(1e-3)
# Number of positions tried in the search for a path around, and the distance in metres under which two are merged.
MAX_AROUND = 512
SAME_PLACE = np.float32(0.02)
# Tolerance in radians of "within one turn", for rounding.
TURN_SLACK = 1e-6


class Gait(NamedTuple):
    """The steps and turns of an agent. A heading is given as its number of counter-clockwise turns from the first
    heading.
    """

    moves: Floats
    """(h, 2) step along x and z for each heading, metres"""
    first_heading: float
    """radians, counter-clockwise from −z"""
    turn: float
    """radians"""
    length: np.float32
    """of a step, metres"""
    sliding: bool


class Limits(NamedTuple):
    """The geodesic distances in metres within which a goal counts as reached."""

    stop_within: np.float32
    """at any time"""
    arrive_within: np.float32
    """if no step leads nearer"""


class Leg(NamedTuple):
    """What a walk to one goal needs."""

    mesh: QueryMesh
    search: Search
    gait: Gait
    goal: Place
    limits: Limits
    corners: Floats
    """(MAX_POINTS, 3) corners of the path that was measured last"""


@compiled
def _remaining(leg: Leg, place: Place) -> tuple[np.float32, int]:
    """Return the geodesic distance from a place to the goal, and the number of corners of the path."""
    return route_between(leg.mesh, leg.search, place, leg.goal, leg.corners)


@inlined
def _turns_to_aim(leg: Leg, heading: int, count: int) -> float:
    """Return how many turn actions lead from ``heading`` to the direction of the path of ``count`` corners: a fraction,
    positive for left turns, at most 180° either way.
    """
    points, gait = leg.corners, leg.gait
    for i in range(1, count):
        dx = points[i, 0] - points[0, 0]
        dz = points[i, 2] - points[0, 2]
        if dx * dx + dz * dz > TOO_NEAR_TO_AIM * TOO_NEAR_TO_AIM:
            wanted = math.atan2(-dx, -dz)
            off = wanted - (gait.first_heading + heading * gait.turn)
            off = off - 2.0 * math.pi * math.floor(off / (2.0 * math.pi) + 0.5)
            return off / gait.turn
    return 0.0


@inlined
def _candidate(number: int, off: float) -> int:
    """Return the integer nearest to ``off`` for ``number`` 0, the second nearest for ``number`` 1, and so on."""
    nearest = math.floor(off + 0.5)
    side = 1 if off >= nearest else -1
    away = (number + 1) // 2
    return int(nearest + (side * away if number % 2 == 1 else -side * away))


@compiled
def _step_along(mesh: QueryMesh, gait: Gait, place: Place, heading: int) -> tuple[Place, bool]:
    """Return the place after a step along a heading, and whether no wall was hit."""
    end = np.array(place.asked, np.float32)
    end[0] = end[0] + gait.moves[heading, 0]
    end[2] = end[2] + gait.moves[heading, 1]
    reached = step(mesh, place, end, gait.sliding)
    return reached, bool(reached.asked[0] == end[0] and reached.asked[2] == end[2])


@compiled
def _best_heading(
    leg: Leg, place: Place, heading: int, off: float, distance: np.float32, contact: bool
) -> tuple[int, np.float32]:
    """Return the heading of the best step from a place, and the geodesic distance after this step; -1 and infinity if
    no step is possible.

    The current heading is tried first if it is within one turn of the path's direction, then the headings nearest to
    that direction. The first with good progress is taken, otherwise the one with most progress.
    """
    headings, sliding = leg.gait.moves.shape[0], leg.gait.sliding
    best_heading = -1
    best = INFINITE
    straight_first = abs(off) <= 1.0 + TURN_SLACK
    for number in range(-1 if straight_first else 0, headings):
        turns = 0 if number < 0 else _candidate(number, off)
        if number >= 0 and straight_first and turns == 0:
            continue
        candidate = (heading + turns) % headings
        reached, free = _step_along(leg.mesh, leg.gait, place, candidate)
        if not (free or contact):
            continue
        after, _ = _remaining(leg, reached)
        if not (free or sliding or _can_go_on(leg, reached, after)):
            continue
        if after < best:
            best = after
            best_heading = candidate
        if distance - after >= GOOD_PROGRESS * leg.gait.length or after <= leg.limits.stop_within:
            return candidate, after
    return best_heading, best


@compiled
def _can_go_on(leg: Leg, place: Place, distance: np.float32) -> bool:
    """Return whether some step from a place at a wall shortens the path to the goal."""
    for heading in range(leg.gait.moves.shape[0]):
        reached, _ = _step_along(leg.mesh, leg.gait, place, heading)
        after, _ = _remaining(leg, reached)
        if distance - after >= LEAST_PROGRESS:
            return True
    return False


@compiled
def _way_around(leg: Leg, place: Place, distance: np.float32, contact: bool) -> Indices:
    """Return the headings of steps that lead from a place around an obstacle to a position from which the path to the
    goal is shorter. The result is empty if no such steps were found.

    Best-first search over positions reached by steps, nearest to the goal first.
    """
    places = np.empty((MAX_AROUND, 3), np.float32)
    left = np.empty(MAX_AROUND, np.float32)
    parent = np.empty(MAX_AROUND, np.int64)
    taken = np.empty(MAX_AROUND, np.int64)
    done = np.zeros(MAX_AROUND, np.bool_)
    places[0] = np.array(place.asked)
    left[0], parent[0], taken[0] = distance, -1, -1
    count = 1
    while True:
        node = -1
        for i in range(count):
            if not done[i] and (node < 0 or left[i] < left[node]):
                node = i
        if node < 0:
            return np.empty(0, np.int64)
        done[node] = True
        begin = place_of(leg.mesh, places[node])
        for heading in range(leg.gait.moves.shape[0]):
            reached, free = _step_along(leg.mesh, leg.gait, begin, heading)
            if not (free or contact) or _known(places, count, reached.asked):
                continue
            after, _ = _remaining(leg, reached)
            if count == MAX_AROUND:
                return np.empty(0, np.int64)
            places[count] = np.array(reached.asked)
            left[count], parent[count], taken[count] = after, node, heading
            count += 1
            if after < distance - LEAST_PROGRESS:
                return _headings_to(parent, taken, count - 1)


@inlined
def _known(places: Floats, count: int, place: Point) -> bool:
    for i in range(count):
        dx = places[i, 0] - place[0]
        dy = places[i, 1] - place[1]
        dz = places[i, 2] - place[2]
        if dx * dx + dy * dy + dz * dz < SAME_PLACE * SAME_PLACE:
            return True
    return False


@compiled
def _headings_to(parent: Indices, taken: Indices, node: int) -> Indices:
    backwards = np.empty(node, np.int64)
    length = 0
    while parent[node] >= 0:
        backwards[length] = taken[node]
        length += 1
        node = parent[node]
    return backwards[:length][::-1].copy()


@compiled
def _plan(leg: Leg, place: Place, heading: int, corners: int, distance: np.float32, careful: bool) -> Indices:
    """Return the headings of the next steps: of one step that shortens the path, or of several steps around an
    obstacle; empty if neither exists. The path from the place is the one that was measured last.
    """
    sliding = leg.gait.sliding
    off = _turns_to_aim(leg, heading, corners)
    best, after = -1, INFINITE
    for attempt in range(1 if sliding or careful else 2):
        if attempt == 1 and distance - after >= SLOW_PROGRESS * leg.gait.length:
            break
        other, after_other = _best_heading(leg, place, heading, off, distance, sliding or attempt == 1)
        if after_other < after:
            best, after = other, after_other
    if distance - after >= LEAST_PROGRESS:
        return np.full(1, best, np.int64)
    around = np.empty(0, np.int64)
    if distance > leg.limits.arrive_within:
        around = _way_around(leg, place, distance, sliding)
        if around.shape[0] == 0 and not sliding:
            around = _way_around(leg, place, distance, True)
    return around


@compiled
def follow(
    mesh: QueryMesh,
    gait: Gait,
    start: Floats,
    goals: Floats,
    limits: Limits,
    max_actions: int,
    careful: bool,
) -> tuple[npt.NDArray[np.int8], Floats, Indices, np.float32, int]:
    """Walk from ``start`` to each of ``goals`` (g, 3) in turn.

    Returns the actions (STOP last), the positions before the first and after each forward step, the number of forward
    steps at which each goal was reached (-1: not reached), the remaining geodesic distance in metres, and the outcome.
    A ``careful`` walk without sliding touches a wall only if it would not make progress otherwise.
    """
    actions = np.empty(max_actions + 1, np.int8)
    locations = np.empty((max_actions + 1, 3), np.float32)
    arrivals = np.full(goals.shape[0], -1, np.int64)
    search, corners = new_search(mesh.poly_size.shape[0]), np.empty((MAX_POINTS, 3), np.float32)
    headings = gait.moves.shape[0]
    place = place_of(mesh, start)
    locations[0] = start
    made, walked, heading = 0, 0, 0
    status = ARRIVED
    distance = ZERO
    for number in range(goals.shape[0]):
        leg = Leg(mesh, search, gait, place_of(mesh, goals[number]), limits, corners)
        distance, count = _remaining(leg, place)
        if distance == INFINITE:
            status = NO_PATH
        plan, taken = np.empty(0, np.int64), 0
        while status == ARRIVED and distance > limits.stop_within:
            if taken == plan.shape[0]:
                plan, taken = _plan(leg, place, heading, count, distance, careful), 0
                if plan.shape[0] == 0:
                    if distance > limits.arrive_within:
                        status = STUCK
                    break
            turns = (plan[taken] - heading) % headings
            turned = LEFT
            if turns > headings - turns:
                turns = headings - turns
                turned = RIGHT
            if made + turns + 1 > max_actions:
                status = TOO_LONG
                break
            actions[made : made + turns] = turned
            actions[made + turns] = FORWARD
            made += turns + 1
            walked += 1
            heading = plan[taken]
            taken += 1
            place, _ = _step_along(mesh, gait, place, heading)
            distance, count = _remaining(leg, place)
            locations[walked] = np.array(place.asked)
        if status != ARRIVED:
            break
        arrivals[number] = walked
    actions[made] = STOP
    return actions[: made + 1].copy(), locations[: walked + 1].copy(), arrivals, distance, status


@compiled
def replay(mesh: QueryMesh, gait: Gait, start: Floats, actions: npt.NDArray[np.int8]) -> tuple[Floats, Indices]:
    """Return the positions (n + 1, 3) and headings (n + 1,) of an agent before the first of n actions and after each
    action.
    """
    headings = gait.moves.shape[0]
    places = np.empty((actions.shape[0] + 1, 3), np.float32)
    facing = np.zeros(actions.shape[0] + 1, np.int64)
    places[0] = start
    place = place_of(mesh, start)
    for i in range(actions.shape[0]):
        facing[i + 1] = facing[i]
        if actions[i] == FORWARD:
            place, _ = _step_along(mesh, gait, place, facing[i])
        elif actions[i] == LEFT:
            facing[i + 1] = (facing[i] + 1) % headings
        elif actions[i] == RIGHT:
            facing[i + 1] = (facing[i] - 1) % headings
        places[i + 1] = np.array(place.asked)
    return places, facing
