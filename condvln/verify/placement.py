"""Check starts, goals, paths and step budgets of a scene's episodes against the scene's navmesh and its objects' boxes.

All leaves are checked by the same rules, as if each were gold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain, combinations, islice, pairwise, permutations
from typing import Any, Final, NamedTuple

import numpy as np
import shapely

from condvln.arrays import F64
from condvln.navigation.follower import Follower, Length
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Scene
from condvln.verify.certificate import Certificate, VerifierRules
from condvln.verify.footprints import Obstacles, Point, Reach
from condvln.verify.program_check import leads_to
from condvln.verify.standpoint import yaw_of
from schemas.config.constants import FURNITURE_DETOUR, GROUP_SIZE, LEAD_INSIDE, SINK, SNAP_TOLERANCE, WALL_DETOUR
from schemas.episode import EpisodeLeaf
from schemas.evaluation import ManifestEpisode
from schemas.program import RoomRef

__all__ = ["check_placement"]

Pair = tuple[Point, Point]

ROUNDING: Final = 1e-6
"""Tolerance in metres by which a distance may violate a bound because of rounding."""
MILLIMETRE: Final = 0.001
"""Tolerances in metres between recomputed lengths and corners and the published ones."""

Verdict = tuple[str, bool, Any, Any]
"""A fact, whether it holds, and the claimed and the found value."""


class PlannedWalk(NamedTuple):
    """A walk: where it starts, the heading there in radians, and the points at which it stops in turn."""

    start: Point
    yaw: float
    stops: tuple[Point, ...]


def check_placement(
    rows: Sequence[ManifestEpisode],
    certificates: Sequence[Certificate],
    scene: Scene,
    pathfinder: Pathfinder,
    obstacles: Obstacles,
    rules: VerifierRules,
    *,
    walls: bool,
) -> None:
    """Check all positions, paths and distances of the episodes of one scene. `walls`: the scene's walls are known."""
    checker = _Checker(scene, pathfinder, rules, FURNITURE_DETOUR if walls else WALL_DETOUR)
    for row, certificate in zip(rows, certificates, strict=True):
        certificate.same("success_distance", row.success_distance, rules.places.success(scene.single_room))
        certificate.same("leaf_objects", *_objects(row))
        if 0 <= row.gold_leaf < len(row.leaves):
            gold = row.leaves[row.gold_leaf]
            claimed, found = (row.geodesic_distance, row.route_length), (gold.geodesic_distance, gold.route_length)
            certificate.same("geodesic_distance", claimed, found, "gold leaf")
    checker.check_places(rows, certificates, obstacles)
    checker.check_targets(rows, certificates)
    checker.check_routes(rows, certificates)
    checker.check_apart(rows, certificates)
    _check_budgets(rows, certificates, pathfinder, rules)


def _points(row: ManifestEpisode) -> list[Point]:
    """Return the start of a row, and all goals and subgoals of its leaves."""
    goals = [goal for leaf in row.leaves for goal in leaf.goals]
    return [row.start_position, *goals, *(stop.position for leaf in row.leaves for stop in leaf.subgoals)]


def _end(leaf: EpisodeLeaf) -> Point:
    """Return the goal at which a leaf's path ends: the one nearest to the path's last corner."""
    return min(leaf.goals, key=lambda goal: math.dist(goal, leaf.reference_path[-1]))


class _Checker:
    """Checks the rows of one scene. What they ask of the navmesh is found together."""

    def __init__(self, scene: Scene, pathfinder: Pathfinder, rules: VerifierRules, detour_at_goal: float) -> None:
        self._pathfinder, self._rules, self._detour_at_goal = pathfinder, rules, detour_at_goal
        self._scene = scene
        self._single = scene.single_room
        self._success = rules.places.success(self._single)
        self._separation = rules.places.leaf_separation(self._single)
        self._reach = Reach(scene)

    def _metres(self, pairs: Sequence[Pair]) -> list[float]:
        """Return the geodesic distances in metres of pairs of points; infinite where no path exists."""
        found = self._pathfinder.geodesic_distances(*np.array(pairs).reshape(-1, 2, 3).transpose(1, 0, 2))
        metres: list[float] = np.where(np.isnan(found), np.inf, found.astype(np.float64)).tolist()
        return metres

    def check_places(
        self, rows: Sequence[ManifestEpisode], certificates: Sequence[Certificate], obstacles: Obstacles
    ) -> None:
        """Check that all points of a row are on the navmesh, on one island that is wide enough, and that they and the
        paths avoid furniture that the navmesh ignores.
        """
        leaves = [leaf for row in rows for leaf in row.leaves]
        corners = np.array([*chain.from_iterable(leaf.reference_path for leaf in leaves)], np.float64).reshape(-1, 3)
        crossed = iter(obstacles.crossed(corners, np.cumsum([len(leaf.reference_path) for leaf in leaves])))
        points = [*dict.fromkeys(chain.from_iterable(_points(row) for row in rows))]
        asked = np.array(points)
        snapped, islands = self._pathfinder.snap_to_islands(asked)
        moved = np.abs(np.asarray(snapped, dtype=np.float64) - asked)
        on_floor = (np.hypot(moved[:, 0], moved[:, 2]) <= SNAP_TOLERANCE) & (moved[:, 1] <= SNAP_TOLERANCE)
        places = zip(obstacles.holding(asked), on_floor.tolist(), islands.tolist(), strict=True)
        known = dict(zip(points, places, strict=True))
        radii = {island: self._pathfinder.island_radius(island) for island in {*islands.tolist()} - {-1}}
        least = self._rules.places.island_radius
        for row, certificate in zip(rows, certificates, strict=True):
            met = [next(crossed) for _ in row.leaves]
            certificate.holds("in_the_way", not any(met), "free paths", met, "paths")
            own = _points(row)
            blocked = sorted({name for point in own if (name := known[point][0]) is not None})
            certificate.holds("in_the_way", not blocked, "free points", blocked)
            astray = sorted({point for point in own if not known[point][1]})
            certificate.holds("standable", not astray, "on the floor", astray)
            on = sorted({known[point][2] for point in own})
            certificate.holds("island", len(on) == 1, "one island", on)
            radius = radii.get(known[own[0]][2], 0.0)
            certificate.holds("island", radius >= least, f"radius of at least {least}", radius, "start")

    def check_targets(self, rows: Sequence[ManifestEpisode], certificates: Sequence[Certificate]) -> None:
        """Check the subgoals and goals of each leaf: that each is near its object, and on one side of walls. Many
        leaves share a target.
        """
        judged: dict[tuple[str, tuple[Point, ...], bool], list[Verdict]] = {}
        for row, certificate in zip(rows, certificates, strict=True):
            ends: dict[int, Point] = {}
            goals = np.array([goal for leaf in row.leaves for goal in leaf.goals])
            for k, leaf in enumerate(row.leaves):
                rooms = _lead_rooms(row, k) if k < len(row.program.leaves) else {}
                for j, ((condition, room), stop) in enumerate(zip(rooms.items(), leaf.subgoals, strict=False)):
                    inside = self._in_room(room.room_id, stop.position, LEAD_INSIDE - ROUNDING)
                    certificate.holds("lead_place", inside, room.room_id, stop.position, f"leaf {k}")
                    told, own = stop.outline, self._outline(room.room_id)
                    same = told is not None and own is not None and np.array_equal(told, own)
                    certificate.holds("lead_place", same, "the outline of its room", room.room_id, f"leaf {k}")
                    outside = j > 0 or not self._in_room(room.room_id, row.start_position)
                    certificate.holds("lead_place", outside, "a start outside", row.start_position, f"leaf {k}")
                    end = ends.setdefault(condition, stop.position)
                    certificate.holds("lead_place", end == stop.position, "one end for all leaves", end, f"leaf {k}")
                    apart = float(np.linalg.norm(goals - stop.position, axis=1).min())
                    certificate.holds("lead_place", apart > row.success_distance, "no goal there", apart, f"leaf {k}")
                plain = all(stop.outline is None for stop in leaf.subgoals[len(rooms) :])
                certificate.holds("lead_place", plain, "no outline of an object", plain, f"leaf {k}")
                targets = [(stop.object_id, (stop.position,), False) for stop in leaf.subgoals[len(rooms) :]]
                for target in (*targets, (leaf.object_id, leaf.goals, True)):
                    if target not in judged:
                        judged[target] = self._judge(*target)
                    for fact, held, claimed, found in judged[target]:
                        certificate.holds(fact, held, claimed, found, f"leaf {k}")

    def _outline(self, room_id: str) -> F64 | None:
        room = self._scene.room_of.get(room_id)
        return None if room is None else room.polygon

    def _in_room(self, room_id: str, place: Point, inside: float = 0.0) -> bool:
        """Return whether a place is on the floor of a room, at least `inside` metres from its outline."""
        room = self._scene.room_of.get(room_id)
        if room is None or room.polygon is None or abs(place[1] - room.floor_y) > SINK:
            return False
        outline, point = shapely.make_valid(shapely.Polygon(room.polygon)), shapely.Point(place[0], place[2])
        return bool(outline.covers(point)) and outline.boundary.distance(point) >= inside

    def _judge(self, object_id: str, places: tuple[Point, ...], are_goals: bool) -> list[Verdict]:
        away, here = self._reach.around(object_id, places)
        if not away:
            return [("goal_reach", False, object_id, "no such object")]
        rules = self._rules.goals
        wrong = [place for place, good in zip(places, here, strict=True) if not good]
        found: list[Verdict] = [
            ("goal_reach", max(away) <= rules.reach_at_most + ROUNDING, (object_id, rules.reach_at_most), max(away)),
            ("goal_reach", not wrong, ("on the floor and in the room of", object_id), wrong),
        ]
        if are_goals:
            # Several may be nearest within rounding.
            nearest = [one for one, its in zip(places, away, strict=True) if its <= min(away) + ROUNDING]
            metres = np.reshape(self._metres([(one, other) for one in nearest for other in places]), (-1, len(places)))
            walk, most = float(metres.max(axis=1).min()), self._reach.half_round(object_id) + self._detour_at_goal
            found.append(("goal_side", walk <= most + ROUNDING, most, walk))
            found.append(("goal_side", len(places) <= rules.points, rules.points, len(places)))
        return found

    def check_routes(self, rows: Sequence[ManifestEpisode], certificates: Sequence[Certificate]) -> None:
        """Check the path and the distances of each leaf."""
        leaves = [
            (row, certificate, k)
            for row, certificate in zip(rows, certificates, strict=True)
            for k in range(len(row.leaves))
        ]
        asked: list[Pair] = []
        legs: list[Pair] = []
        for row, _, k in leaves:
            leaf, start = row.leaves[k], row.start_position
            stops = [stop.position for stop in leaf.subgoals]
            before = stops[-1] if stops else start
            lead = stops[: len(_lead_rooms(row, k))][-1:] or [start]
            asked += [(start, goal) for goal in leaf.goals]
            asked += [(start, stop) for stop in stops]
            asked += [(before, goal) for goal in leaf.goals]
            asked += [(lead[0], goal) for goal in leaf.goals]
            legs += pairwise((start, *stops, _end(leaf)))
        metres = iter(self._metres(asked))
        lengths, counts, corners = self._pathfinder.path_corners(*np.array(legs).transpose(1, 0, 2))
        rounded = np.split(np.round(corners.astype(np.float64), 3) + 0.0, np.cumsum(counts)[:-1])
        routes = zip(lengths.tolist(), rounded, strict=True)
        for row, certificate, k in leaves:
            leaf = row.leaves[k]
            sizes = (len(leaf.goals), len(leaf.subgoals), len(leaf.goals), len(leaf.goals))
            direct, passed, last, led = ([*islice(metres, size)] for size in sizes)
            own = [*islice(routes, len(leaf.subgoals) + 1)]
            shortest = min(led) + sum(leg for leg, _ in own[: len(_lead_rooms(row, k))])
            self._check_route(row.start_position, leaf, direct, passed, last, shortest, own, certificate, f"leaf {k}")

    def _check_route(
        self,
        start: Point,
        leaf: EpisodeLeaf,
        direct: list[float],
        passed: list[float],
        last: list[float],
        shortest: float,
        legs: list[tuple[float, F64]],
        certificate: Certificate,
        name: str,
    ) -> None:
        """Check one leaf.

        direct, passed : metres from the start to each goal and to each stop before it
        last : metres from the last stop before the goals to each goal
        shortest : metres from the start past the leads to the nearest goal
        legs : the paths from the start through the stops to the goal at its end, each with its length and its corners
        """
        rules, least = self._rules.episodes, min(direct)
        certificate.close("geodesic_distance", leaf.geodesic_distance, least, MILLIMETRE, name)
        certificate.holds("goal_order", direct[0] <= least + MILLIMETRE, direct[0], least, name)
        reached, final = last[leaf.goals.index(_end(leaf))], min(last)
        certificate.holds("route_end", reached <= final + MILLIMETRE, reached, final, name)
        certificate.close("route_length", leaf.route_length, sum(leg for leg, _ in legs), MILLIMETRE, name)
        path = np.concatenate([[start], *(corners[1:] for _, corners in legs)])
        claimed = np.array(leaf.reference_path)
        same = path.shape == claimed.shape and bool((np.abs(path - claimed) <= MILLIMETRE + ROUNDING).all())
        certificate.holds("reference_path", same, leaf.reference_path, path.tolist(), name)
        low, high = rules.range(self._single)
        certificate.holds("distance_range", low <= least <= high, (low, high), least, name)
        if not self._single:
            most = rules.detour_factor * shortest + rules.detour_slack
            certificate.holds("detour", leaf.route_length <= most + MILLIMETRE, most, leaf.route_length, name)
        nearest = min([least, *passed])
        certificate.holds("start_apart", nearest > 2 * self._success, 2 * self._success, nearest, name)

    def check_apart(self, rows: Sequence[ManifestEpisode], certificates: Sequence[Certificate]) -> None:
        """Check that the goals of two leaves are far enough apart, and that no path of a leaf enters the success ball
        of another leaf. A straight line is never longer than a path, so it already shows it for most.
        """
        bound = self._separation + 2 * math.sqrt(2) * SNAP_TOLERANCE
        leaves = [
            (row, certificate, *pair)
            for row, certificate in zip(rows, certificates, strict=True)
            for pair in combinations(range(len(row.leaves)), 2)
        ]
        near = [
            [
                (one, other)
                for one in row.leaves[k].goals
                for other in row.leaves[j].goals
                if math.dist(one, other) < bound
            ]
            for row, _, k, j in leaves
        ]
        # Detour's path back may be shorter than its path there.
        there = iter(self._metres([pair for pairs in near for pair in pairs]))
        back = iter(self._metres([(other, one) for pairs in near for one, other in pairs]))
        for (_, certificate, k, j), pairs in zip(leaves, near, strict=True):
            least = min((min(next(there), next(back)) for _ in pairs), default=math.inf)
            apart = least >= self._separation - ROUNDING
            certificate.holds("leaves_apart", apart, self._separation, least, f"leaves {k} and {j}")
        for row, certificate in zip(rows, certificates, strict=True):
            away = _clearances(row.leaves).tolist()
            for k, j in permutations(range(len(row.leaves)), 2):
                clear = away[k][j] >= self._success - ROUNDING
                name = f"path of leaf {k} and leaf {j}"
                certificate.holds("path_apart", clear, self._success, away[k][j], name)


def _clearances(leaves: Sequence[EpisodeLeaf]) -> F64:
    """Return the distance (n, n) in metres from the path of each leaf to the nearest goal of each leaf."""
    goals = np.array([goal for leaf in leaves for goal in leaf.goals])
    sides = np.array([side for leaf in leaves for side in pairwise(leaf.reference_path)])
    begin, side = sides[:, 0], sides[:, 1] - sides[:, 0]
    away = goals - begin[:, None]
    square = (side * side).sum(axis=1)
    along = np.clip((away * side[:, None]).sum(axis=2) / np.where(square > 0, square, 1)[:, None], 0, 1)
    away -= along[..., None] * side[:, None]
    metres: F64 = np.sqrt((away * away).sum(axis=2))
    firsts = (
        np.cumsum([0, *sizes[:-1]])
        for sizes in ([len(leaf.reference_path) - 1 for leaf in leaves], [len(leaf.goals) for leaf in leaves])
    )
    for axis, its in enumerate(firsts):
        metres = np.minimum.reduceat(metres, its, axis=axis)
    return metres


def _objects(row: ManifestEpisode) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Return the numbers and objects of a row's leaves, as its leaves and as its program have them."""
    numbers = [leaf.leaf for leaf in row.leaves]
    objects = [[*(stop.object_id for stop in leaf.subgoals), leaf.object_id] for leaf in row.leaves]
    moves = [
        [*(room.room_id for room in _lead_rooms(row, k).values()), *(move.object_id for move in leaf.moves)]
        for k, leaf in enumerate(row.program.leaves)
    ]
    return (numbers, objects), ([*range(len(moves))], moves)


def _lead_rooms(row: ManifestEpisode, leaf: int) -> dict[int, RoomRef]:
    """Return the rooms of the leads on the way to a leaf, by the conditions that follow."""
    return {branch.condition: branch.lead for branch in leads_to(row.program, leaf) if branch.lead is not None}


def _lengths(follower: Follower, walks: Sequence[PlannedWalk]) -> list[Length]:
    """Return how long walks are. Equal ones are made once, since leaves of several episodes share walks."""
    new = [*dict.fromkeys(walks)]
    made = follower.lengths(
        np.array([walk.start for walk in new]).reshape(-1, 3),
        [walk.yaw for walk in new],
        np.array([stop for walk in new for stop in walk.stops]).reshape(-1, 3),
        np.cumsum([len(walk.stops) for walk in new]),
    )
    known = dict(zip(new, made, strict=True))
    return [known[walk] for walk in walks]


def _check_budgets(
    rows: Sequence[ManifestEpisode], certificates: Sequence[Certificate], pathfinder: Pathfinder, rules: VerifierRules
) -> None:
    """Check the step budget of each row against the configuration, the actions of the longest leaf and, if the budget
    is proportional to the text, the number of words of the longest text of its counterfactual group. Rows whose start
    is not turned about the vertical are left out.
    """
    planned: list[list[PlannedWalk]] = []
    groups: dict[str, list[int]] = {}
    for row, certificate in zip(rows, certificates, strict=True):
        yaw = yaw_of(row.start_rotation)
        upright = certificate.holds("start_rotation", yaw is not None, "a turn about the vertical", row.start_rotation)
        planned.append(
            [
                PlannedWalk(row.start_position, yaw or 0.0, (*(stop.position for stop in leaf.subgoals), _end(leaf)))
                for leaf in (row.leaves if upright else ())
            ]
        )
        if row.group_id is not None:
            groups.setdefault(row.group_id, []).append(len(row.instruction_text.split()))
    ceiling, proportional = rules.episodes.step_ceiling, rules.episodes.max_steps == "proportional"
    made = iter(_lengths(Follower(pathfinder, max_actions=ceiling), [*chain.from_iterable(planned)]))
    for row, certificate, its in zip(rows, certificates, planned, strict=True):
        lengths = [next(made) for _ in its]
        if not lengths:
            continue
        for k, length in enumerate(lengths):
            certificate.holds("budget", length.arrived, "a walk that arrives", length.outcome, f"leaf {k}")
        twice = 2 * max(length.actions for length in lengths)
        certificate.holds("budget", twice <= ceiling, f"at most {ceiling}", twice, "twice the actions")
        words = [len(row.instruction_text.split())]
        if row.group_id is not None:
            words = groups[row.group_id]
            certificate.same("group", GROUP_SIZE, len(words), f"members of {row.group_id}")
        expected = max(rules.text.steps_per_word * max(words), twice) if proportional else ceiling
        certificate.same("budget", row.max_steps, expected)
