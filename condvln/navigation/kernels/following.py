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

from condvln.compiled import compiled, constant, inlined
from condvln.navigation.kernels.astar import Search, new_search
from condvln.navigation.kernels.geometry import ONE, ZERO
from condvln.navigation.kernels.mesh import QueryMesh
from condvln.navigation.kernels.movement import Place, StepMemory, copy_place, new_place, new_step_memory, put, step
from condvln.navigation.kernels.route import INFINITE, route_between
from condvln.navigation.kernels.straight import MAX_POINTS
from condvln.navigation.tile import Floats, Indices
from condvln.uncounted import keep, uncounted

STOP, FORWARD, LEFT, RIGHT = 0, 1, 2, 3  # the action ids of VLN-CE
ARRIVED, NO_PATH, STUCK, TOO_LONG = 0, 1, 2, 3

# Metres: a path corner nearer than this gives no direction; the next corner is used.
TOO_NEAR_TO_AIM = np.float32(0.01)
# A step is taken without comparing all headings if it shortens the path by this share of a full step.
GOOD_PROGRESS = np.float32(0.5)
# Without sliding, steps that end at a wall are also considered if progress is below this share of a full step.
SLOW_PROGRESS = np.float32(0.25)
# Metres: a step that shortens the path by less is not progress.
LEAST_PROGRESS = np.float32(1e-3)
# Number of positions tried in the search for a path around, and the distance in metres under which two are merged.
MAX_AROUND = 512
SAME_PLACE = np.float32(0.02)
# A walk that is not careful; see `follow`.
BOLD = constant(False)
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


@compiled
def _remaining(mesh: QueryMesh, search: Search, place: Place, goal: Place, points: Floats) -> tuple[np.float32, int]:
    """Return the geodesic distance from a place to the goal, and the number of corners of the path. The corners are
    written to ``points``.
    """
    at, to = place.at, goal.at
    return route_between(
        mesh, search, place.asked, place.poly[0], at[0], at[1], at[2], goal.asked, goal.poly[0], to[0], to[1], to[2],
        points,
    )  # fmt: skip


@inlined
def _turns_to_aim(gait: Gait, heading: int, points: Floats, count: int) -> float:
    """Return how many turn actions lead from ``heading`` to the direction of the path ``points``: a fraction, positive
    for left turns, at most 180° either way.
    """
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
def _try_heading(mesh: QueryMesh, gait: Gait, place: Place, heading: int, memory: StepMemory, reached: Place) -> bool:
    """Step from a place along a heading, and write the end of the step to ``reached``. Return whether no wall was
    hit.
    """
    end = memory.end
    end[0] = place.asked[0] + gait.moves[heading, 0]
    end[1] = place.asked[1]
    end[2] = place.asked[2] + gait.moves[heading, 1]
    step(mesh, place, gait.sliding, memory, reached)
    return bool(reached.asked[0] == end[0] and reached.asked[2] == end[2])


@inlined
def _best_heading(
    mesh: QueryMesh,
    search: Search,
    memory: StepMemory,
    gait: Gait,
    place: Place,
    heading: int,
    off: float,
    distance: np.float32,
    goal: Place,
    near_enough: np.float32,
    contact: bool,
    points: Floats,
    tried: Place,
) -> tuple[int, np.float32, int]:
    """Return the heading of the best step from a place, and the geodesic distance after this step. The results are -1
    and infinity if no step is possible.

    The current heading is tried first if it is within one turn of the path's direction, then the headings nearest to
    that direction. The first with good progress is taken, otherwise the one with most progress. In the first case
    ``tried`` is the end of the step, ``points`` the path from there, and the third value the number of corners of this
    path; otherwise the third value is 0.
    """
    headings = gait.moves.shape[0]
    best_heading = -1
    best = INFINITE
    straight_first = abs(off) <= 1.0 + TURN_SLACK
    for number in range(-1 if straight_first else 0, headings):
        turns = 0 if number < 0 else _candidate(number, off)
        if number >= 0 and straight_first and turns == 0:
            continue
        candidate = (heading + turns) % headings
        free = _try_heading(mesh, gait, place, candidate, memory, tried)
        if not (free or contact):
            continue
        after, corners = _remaining(mesh, search, tried, goal, points)
        if not (free or gait.sliding):
            corners = 0  # the next line overwrites the points
            if not _can_go_on(mesh, search, memory, gait, tried, after, goal, points):
                continue
        if after < best:
            best = after
            best_heading = candidate
        if distance - after >= GOOD_PROGRESS * gait.length or after <= near_enough:
            return candidate, after, corners
    return best_heading, best, 0


@inlined
def _can_go_on(
    mesh: QueryMesh,
    search: Search,
    memory: StepMemory,
    gait: Gait,
    place: Place,
    distance: np.float32,
    goal: Place,
    points: Floats,
) -> bool:
    """Return whether some step from a place at a wall shortens the path to the goal."""
    held, found = new_place(), False
    tried = uncounted(held)
    for heading in range(gait.moves.shape[0]):
        _try_heading(mesh, gait, place, heading, memory, tried)
        after, _ = _remaining(mesh, search, tried, goal, points)
        if distance - after >= LEAST_PROGRESS:
            found = True
            break
    keep(held)
    return found


@inlined
def _way_around(
    mesh: QueryMesh,
    search: Search,
    memory: StepMemory,
    gait: Gait,
    place: Place,
    distance: np.float32,
    goal: Place,
    contact: bool,
    points: Floats,
) -> Indices:
    """Return the headings of steps that lead from a place around an obstacle to a position from which the path to the
    goal is shorter. The result is empty if no such steps were found.

    Best-first search over positions reached by steps, nearest to the goal first.
    """
    held = np.empty((2, MAX_AROUND, 3), np.float32), np.empty((MAX_AROUND, 1), np.int64), new_place()
    both, polys, tried = uncounted(held)
    places, snapped = both[0], both[1]
    found = np.empty(0, np.int64)
    left = np.empty(MAX_AROUND, np.float32)
    parent = np.empty(MAX_AROUND, np.int64)
    taken = np.empty(MAX_AROUND, np.int64)
    done = np.zeros(MAX_AROUND, np.bool_)
    copy_place(place, Place(places[0], snapped[0], polys[0]))
    left[0], parent[0], taken[0] = distance, -1, -1
    count, searching = int(ONE), True
    while searching:
        node = -1
        for i in range(count):
            if not done[i] and (node < 0 or left[i] < left[node]):
                node = i
        if node < 0:
            break
        done[node] = True
        begin = Place(places[node], snapped[node], polys[node])
        for heading in range(gait.moves.shape[0]):
            free = _try_heading(mesh, gait, begin, heading, memory, tried)
            if not (free or contact) or _known(places, count, tried.asked):
                continue
            after, _ = _remaining(mesh, search, tried, goal, points)
            if count == MAX_AROUND:
                searching = False
                break
            copy_place(tried, Place(places[count], snapped[count], polys[count]))
            left[count], parent[count], taken[count] = after, node, heading
            count += 1
            if after < distance - LEAST_PROGRESS:
                found = _headings_to(parent, taken, count - 1)
                searching = False
                break
    keep(held)
    return found


@inlined
def _known(places: Floats, count: int, place: Floats) -> bool:
    for i in range(count):
        dx = places[i, 0] - place[0]
        dy = places[i, 1] - place[1]
        dz = places[i, 2] - place[2]
        if dx * dx + dy * dy + dz * dz < SAME_PLACE * SAME_PLACE:
            return True
    return False


@inlined
def _headings_to(parent: Indices, taken: Indices, node: int) -> Indices:
    length = 0
    at = node
    while parent[at] >= 0:
        length += 1
        at = parent[at]
    headings = np.empty(length, np.int64)
    at = node
    for i in range(length - 1, -1, -1):
        headings[i] = taken[at]
        at = parent[at]
    return headings


@inlined
def _plan(
    mesh: QueryMesh,
    search: Search,
    memory: StepMemory,
    gait: Gait,
    place: Place,
    heading: int,
    path: Floats,
    corners: int,
    distance: np.float32,
    goal: Place,
    limits: Limits,
    careful: bool,
    points: Floats,
    tried: Place,
) -> tuple[Indices, np.float32, int]:
    """Return the headings of the next steps: of one step that shortens the path, or of several steps around an
    obstacle; empty if neither exists.

    The other two values are those that :func:`_best_heading` returns. If the last one is not 0, the step has already
    been made.
    """
    off = _turns_to_aim(gait, heading, path, corners)
    best, after, known = -1, INFINITE, 0
    for attempt in range(1 if gait.sliding or careful else 2):
        if attempt == 1 and distance - after >= SLOW_PROGRESS * gait.length:
            break
        contact = gait.sliding or attempt == 1
        other, after_other, known_other = _best_heading(
            mesh, search, memory, gait, place, heading, off, distance, goal, limits.stop_within, contact, points, tried
        )
        known = 0
        if after_other < after:
            best, after, known = other, after_other, known_other
    if distance - after >= LEAST_PROGRESS:
        return np.full(1, best, np.int64), after, known
    around = np.empty(0, np.int64)
    if distance > limits.arrive_within:
        for attempt in range(1 if gait.sliding else 2):
            contact = gait.sliding or attempt == 1
            around = _way_around(mesh, search, memory, gait, place, distance, goal, contact, points)
            if around.shape[0] > 0:
                break
    return around, after, 0


class _WalkMemory(NamedTuple):
    """Working memory of one thread for walks."""

    search: Search
    step: StepMemory
    place: Place
    reached: Place
    goal: Place
    corners: Floats
    """(2, MAX_POINTS, 3)"""


@compiled
def _new_walk_memory(polygons: int) -> _WalkMemory:
    return _WalkMemory(
        new_search(polygons),
        new_step_memory(),
        new_place(),
        new_place(),
        new_place(),
        np.empty((2, MAX_POINTS, 3), np.float32),
    )


@compiled
def _walk(
    mesh: QueryMesh,
    gait: Gait,
    start: Floats,
    goals: Floats,
    limits: Limits,
    max_actions: int,
    careful: bool,
    held: _WalkMemory,
    actions: npt.NDArray[np.int8],
    locations: Floats,
    arrivals: Indices,
) -> tuple[int, int, np.float32, int]:
    """Walk as `follow` says, and write to ``actions``, ``locations`` and ``arrivals``, which are long enough. Return
    the number of actions before STOP, that of forward steps, the remaining geodesic metres, and the outcome.
    """
    headings = gait.moves.shape[0]
    search, memory, place, reached, goal = held.search, held.step, held.place, held.reached, held.goal
    points, scratch = held.corners[0], held.corners[1]
    locations[0] = start
    for number in range(goals.shape[0]):
        arrivals[number] = -1
    put(mesh, start, place)
    locations[0] = start
    made, walked, heading = 0, 0, int(ZERO)  # a literal would make numba compile the callees again
    status = ARRIVED
    distance = ZERO
    for number in range(goals.shape[0]):
        put(mesh, goals[number], goal)
        distance, count = _remaining(mesh, search, place, goal, points)
        if distance == INFINITE:
            status = NO_PATH
        plan = np.empty(0, np.int64)
        taken, known, after = 0, 0, INFINITE
        while status == ARRIVED and distance > limits.stop_within:
            if taken == plan.shape[0]:
                plan, after, known = _plan(
                    mesh,
                    search,
                    memory,
                    gait,
                    place,
                    heading,
                    points,
                    count,
                    distance,
                    goal,
                    limits,
                    careful,
                    scratch,
                    reached,
                )
                taken = 0
                if plan.shape[0] == 0:
                    if distance > limits.arrive_within:
                        status = STUCK
                    break
            towards = plan[taken]
            taken += 1
            turns = (towards - heading) % headings
            turned = LEFT
            if turns > headings - turns:
                turns = headings - turns
                turned = RIGHT
            if made + turns + 1 > max_actions:
                status = TOO_LONG
                break
            for _ in range(turns):
                actions[made] = turned
                made += 1
            actions[made] = FORWARD
            made += 1
            walked += 1
            heading = towards
            if known > 0:
                # The step was made in planning, and the path from its end is in ``scratch``.
                distance, count = after, known
                points, scratch = scratch, points
                known = 0
            else:
                _try_heading(mesh, gait, place, heading, memory, reached)
                distance, count = _remaining(mesh, search, reached, goal, points)
            place, reached = reached, place
            for axis in range(3):
                locations[walked, axis] = place.asked[axis]
        if status != ARRIVED:
            break
        arrivals[number] = walked
    actions[made] = STOP
    return made, walked, distance, status


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
    arrivals = np.empty(goals.shape[0], np.int64)
    held = _new_walk_memory(mesh.poly_size.shape[0])
    made, walked, distance, status = _walk(
        uncounted(mesh), uncounted(gait), uncounted(start), uncounted(goals), limits, max_actions, careful,
        uncounted(held), uncounted(actions), uncounted(locations), uncounted(arrivals),
    )  # fmt: skip
    keep(held)
    return actions[: made + 1].copy(), locations[: walked + 1].copy(), arrivals, distance, status


@compiled
def replay(mesh: QueryMesh, gait: Gait, start: Floats, actions: npt.NDArray[np.int8]) -> tuple[Floats, Indices]:
    """Return the positions (n + 1, 3) and headings (n + 1,) of an agent before the first of n actions and after each
    action.
    """
    mesh, gait = uncounted(mesh), uncounted(gait)
    headings = gait.moves.shape[0]
    places = np.empty((actions.shape[0] + 1, 3), np.float32)
    facing = np.empty(actions.shape[0] + 1, np.int64)
    places[0], facing[0] = start, 0
    held = (new_step_memory(), new_place(), new_place())
    memory, place, reached = uncounted(held)
    put(mesh, uncounted(start), place)
    for i in range(actions.shape[0]):
        facing[i + 1] = facing[i]
        if actions[i] == FORWARD:
            _try_heading(mesh, gait, place, facing[i], memory, reached)
            place, reached = reached, place
        elif actions[i] == LEFT:
            facing[i + 1] = (facing[i] + 1) % headings
        elif actions[i] == RIGHT:
            facing[i + 1] = (facing[i] - 1) % headings
        for axis in range(3):
            places[i + 1, axis] = place.asked[axis]
    keep(held)
    return places, facing


@compiled
def follow_many(
    mesh: QueryMesh,
    gait: Gait,
    moves: Floats,
    headings: npt.NDArray[np.float64],
    starts: Floats,
    goals: Floats,
    goal_ends: Indices,
    limits: Limits,
    max_actions: int,
) -> tuple[npt.NDArray[np.int8], Indices, Floats, Indices, Indices, Floats, Indices]:
    """Return what `follow` returns for each of n walks: the actions and the locations, concatenated and each with the
    end index (n,) of each walk, the arrivals (g,), the remaining distances (n,) and the outcomes (n,).

    moves (n, h, 2), headings (n,), starts (n, 3) : of each walk, or one of all walks; ``gait`` holds the rest, which
        all share
    goals (g, 3), goal_ends (n,) : of all walks, concatenated
    """
    count, longest = len(goal_ends), max_actions + 1
    actions, locations = np.empty(2 * longest, np.int8), np.empty((2 * longest, 3), np.float32)
    ends, location_ends, arrivals = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(len(goals), np.int64)
    distances, outcomes = np.empty(count, np.float32), np.empty(count, np.int64)
    held = _new_walk_memory(mesh.poly_size.shape[0])
    first, made, walked = 0, 0, 0
    for walk in range(count):
        if made + longest > len(actions):  # locations are never more than actions
            more, longer = np.empty(2 * len(actions), np.int8), np.empty((2 * len(actions), 3), np.float32)
            for k in range(made):  # value by value: assigning a part of an array takes seconds to compile
                more[k] = actions[k]
            for k in range(walked):
                for axis in range(3):
                    longer[k, axis] = locations[k, axis]
            actions, locations = more, longer
        of = min(walk, len(starts) - 1)
        own = Gait(moves[of], headings[of], gait.turn, gait.length, gait.sliding)
        turns, steps, distances[walk], outcomes[walk] = _walk(
            uncounted(mesh), uncounted(own), uncounted(starts[of]), uncounted(goals[first : goal_ends[walk]]), limits,
            max_actions, BOLD, uncounted(held), uncounted(actions[made:]), uncounted(locations[walked:]),
            uncounted(arrivals[first : goal_ends[walk]]),
        )  # fmt: skip
        first, made, walked = goal_ends[walk], made + turns + 1, walked + steps + 1
        ends[walk], location_ends[walk] = made, walked
    keep(held)
    return actions[:made].copy(), ends, locations[:walked].copy(), location_ends, arrivals, distances, outcomes


@compiled
def replay_many(
    mesh: QueryMesh,
    gait: Gait,
    moves: Floats,
    headings: npt.NDArray[np.float64],
    starts: Floats,
    actions: npt.NDArray[np.int8],
    ends: Indices,
) -> tuple[Floats, Indices]:
    """Return the start of each of n walks and the position after each of its forward steps, concatenated (p, 3), and
    the end index (n,) of each walk there.

    moves, headings, starts, gait : as for `follow_many`
    actions (a,), ends (n,) : of all walks, concatenated, and where each ends
    """
    found, found_ends = np.empty((len(starts) + len(actions), 3), np.float32), np.empty(len(starts), np.int64)
    first, count = 0, 0
    for walk in range(len(starts)):
        own = Gait(moves[walk], headings[walk], gait.turn, gait.length, gait.sliding)
        places, _ = replay(mesh, own, starts[walk], actions[first : ends[walk]])
        for at in range(len(places)):
            if at == 0 or actions[first + at - 1] == FORWARD:
                found[count] = places[at]
                count += 1
        first, found_ends[walk] = ends[walk], count
    return found[:count], found_ends
