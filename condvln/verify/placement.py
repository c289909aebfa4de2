"""Check starts, goals and paths of a scene's episodes against the scene's navmesh and its objects' boxes.

All leaves are checked by the same rules, as if each were gold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain, pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Scene
from condvln.verify.certificate import Certificate
from condvln.verify.footprints import Obstacles, Reach
from condvln.verify.geodesics import Geodesics, Point
from condvln.verify.heading import yaw_of
from condvln.verify.kernels.separation import clearances, near_goals
from condvln.verify.rules import VerifierRules
from condvln.verify.walks import Walks, Way
from schemas.config.constants import FURNITURE_DETOUR, GROUP_SIZE, SNAP_TOLERANCE, WALL_DETOUR
from schemas.episode import EpisodeLeaf
from schemas.evaluation import ManifestEpisode

__all__ = ["check_placement"]

F64 = NDArray[np.float64]

MILLIMETRE: Final = 0.001
"""Tolerances in metres between recomputed lengths and corners and the published ones."""
ROUNDING: Final = 1e-6
"""Tolerance in metres by which a distance may violate a bound because of rounding."""
LEAF_NAMES: Final = tuple(f"leaf {k}" for k in range(8))


Verdict = tuple[str, bool, Any, Any]
"""A fact, whether it holds, and the claimed and the found value."""


class _Target:
    """An object, and the places from which an agent reaches it: the goals of a leaf, or one subgoal. Many leaves of a
    scene share it, so that what holds of it alone is found once.

    points : index of each place
    away, here : for each place, metres from the object, and whether it is on its floor and in its room; empty if the
        object does not exist
    around : queries from each place nearest to the object to all places
    near, side : verdicts on these, and on whether a wall is between the places; None until they are asked for
    """

    def __init__(self, object_id: str, places: tuple[Point, ...], reach: Reach, walks: Geodesics) -> None:
        self.object_id, self.places = object_id, places
        self.points = tuple([walks.point(place) for place in places])
        self.away, self.here = reach.around(object_id, places)
        # Several may be nearest within rounding; the wall check starts from each of them.
        least = min(self.away, default=0.0) + ROUNDING
        nearest = [one for one, metres in zip(self.points, self.away or (0.0,), strict=False) if metres <= least]
        self.around = [[walks.pair(one, other) for other in self.points] for one in nearest]
        self.near: list[Verdict] | None = None
        self.side: list[Verdict] | None = None


class _Leaf(NamedTuple):
    """One leaf, with the indices of its points and queries.

    end : index of the goal at which its path ends
    target, subgoals : its object, and those of its stops before
    direct : queries from the start to the goals; final : from the last stop to the goals; first : from the start to the
        subgoals; legs : from stop to stop
    """

    leaf: EpisodeLeaf
    end: int
    target: _Target
    subgoals: tuple[_Target, ...]
    stops: tuple[int, ...]
    direct: tuple[int, ...]
    final: tuple[int, ...]
    first: tuple[int, ...]
    legs: tuple[int, ...]


class _Placed(NamedTuple):
    """A row's start and leaves.

    gaps : by pair of leaves the queries about their goals, if a straight line does not show that they are apart
    clearances (l, l) : least metres from each leaf's path to another leaf's goals
    """

    start: int
    leaves: tuple[_Leaf, ...]
    gaps: dict[tuple[int, int], list[int]]
    clearances: list[list[float]]


def check_placement(
    rows: Sequence[ManifestEpisode],
    certificates: Sequence[Certificate],
    scene: Scene,
    pathfinder: Pathfinder,
    walks: Walks,
    obstacles: Obstacles,
    rules: VerifierRules,
    *,
    walls: bool,
) -> None:
    """Check all positions, paths and distances of the episodes of one scene. `walls`: the scene's walls are known."""
    lines = _Lines(rows)
    checker = _Checker(scene, rules, walls)
    placed = checker.note(rows, lines)
    checker.walks.ask(pathfinder)
    checker.look_out(obstacles)
    crossed = iter(obstacles.crossed(lines.corners, lines.corner_ends))
    groups = _Groups(rows)
    ways = [_ways(row, places) for row, places in zip(rows, placed, strict=True)]
    walks.ask(way for its in ways for way in its)
    for row, certificate, places, its in zip(rows, certificates, placed, ways, strict=True):
        met = [next(crossed) for _ in row.leaves]
        certificate.holds("in_the_way", met.count(None) == len(met), "free paths", met, "paths")
        checker.check(row, places, certificate)
        _check_budget(row, its, groups, walks, rules, certificate)


class _Lines:
    """The paths and goals of all leaves of a scene's rows, concatenated.

    corners (n, 3), goals (m, 3); corner_ends, goal_ends (l,) : end index of each leaf; row_ends (r,) : end index of
        each row's leaves
    """

    def __init__(self, rows: Sequence[ManifestEpisode]) -> None:
        leaves = [leaf for row in rows for leaf in row.leaves]
        self.corners = _points([leaf.reference_path for leaf in leaves])
        self.goals = _points([leaf.goals for leaf in leaves])
        self.corner_ends = np.cumsum([len(leaf.reference_path) for leaf in leaves])
        self.goal_ends = np.cumsum([len(leaf.goals) for leaf in leaves])
        self.row_ends = np.cumsum([len(row.leaves) for row in rows])

    def clearances(self) -> list[list[float]]:
        """Return for each leaf the distances in metres from its path to the nearest goal of every leaf of the same
        episode. The entry of the leaf itself is infinite.

        A straight line is never longer than a path, so a path with enough clearance by it never enters the success
        ball.
        """
        widest = int(np.diff(self.row_ends, prepend=0).max())
        squares = clearances(self.corners, self.corner_ends, self.goals, self.goal_ends, self.row_ends, widest)
        found: list[list[float]] = np.sqrt(squares).tolist()
        return found

    def near_goals(self, within: float) -> list[list[int]]:
        """Return the pairs of goals that are less than `within` metres apart in a straight line. Only these can violate
        the minimum gap between two leaves.
        """
        found: list[list[int]] = near_goals(self.goals, self.goal_ends, self.row_ends, within).tolist()
        return found


class _Checker:
    def __init__(self, scene: Scene, rules: VerifierRules, walls: bool) -> None:
        self.detour_at_goal = FURNITURE_DETOUR if walls else WALL_DETOUR
        single = scene.single_room
        self.goals, self.island_radius = rules.goals, rules.places.island_radius
        self.success = rules.places.success(single)
        self.range = rules.episodes.range(single)
        self.single, self.detour = single, (rules.episodes.detour_factor, rules.episodes.detour_slack)
        self.separation = rules.places.leaf_separation(single)
        self.walks = Geodesics()
        self.reach = Reach(scene)
        self._targets: dict[tuple[str, tuple[Point, ...]], _Target] = {}
        self._fans: dict[tuple[int, tuple[int, ...]], tuple[int, ...]] = {}
        self._inside: dict[int, str] = {}
        self._astray: set[int] = set()

    # -- queries to the navmesh
    # -------------------------------------------------------------------------------------------

    def note(self, rows: Sequence[ManifestEpisode], lines: _Lines) -> list[_Placed]:
        """Hand all path queries of all rows to `walks`, which answers them together; return the queries' numbers."""
        away = lines.clearances()
        near = iter(lines.near_goals(self.separation + 2 * math.sqrt(2) * SNAP_TOLERANCE))
        pair = next(near, None)
        placed = []
        first, first_goal = 0, 0
        for row in rows:
            start = self.walks.point(row.start_position)
            leaves = tuple([self._note_leaf(start, leaf) for leaf in row.leaves])
            names = [goal for leaf in leaves for goal in leaf.target.points]
            last = first + len(leaves)
            gaps: dict[tuple[int, int], list[int]] = {}
            while pair is not None and pair[0] < last:
                one, other, goal, other_goal = pair
                ends = names[goal - first_goal], names[other_goal - first_goal]
                # Detour's path back may be shorter than its path there.
                asked = (self.walks.pair(*ends), self.walks.pair(*reversed(ends)))
                gaps.setdefault((one - first, other - first), []).extend(asked)
                pair = next(near, None)
            placed.append(_Placed(start, leaves, gaps, [line[: len(leaves)] for line in away[first:last]]))
            first, first_goal = last, first_goal + len(names)
        return placed

    def _note_leaf(self, start: int, leaf: EpisodeLeaf) -> _Leaf:
        target = self._target(leaf.object_id, leaf.goals)
        subgoals = tuple([self._target(subgoal.object_id, (subgoal.position,)) for subgoal in leaf.subgoals])
        before = tuple([subgoal.points[0] for subgoal in subgoals])
        end = _end(leaf)
        stops = (start, *before, target.points[end])
        direct = self._fan(start, target.points)
        return _Leaf(
            leaf=leaf,
            end=end,
            target=target,
            subgoals=subgoals,
            stops=stops,
            direct=direct,
            final=self._fan(stops[-2], target.points) if before else direct,
            first=self._fan(start, before),
            legs=tuple([self.walks.leg(one, other) for one, other in pairwise(stops)]),
        )

    def _target(self, object_id: str, places: tuple[Point, ...]) -> _Target:
        target = self._targets.get((object_id, places))
        if target is None:
            target = self._targets[object_id, places] = _Target(object_id, places, self.reach, self.walks)
        return target

    def _fan(self, one: int, others: tuple[int, ...]) -> tuple[int, ...]:
        """Return the queries from one point to others."""
        fan = self._fans.get((one, others))
        if fan is None:
            fan = self._fans[one, others] = tuple([self.walks.pair(one, other) for other in others])
        return fan

    def look_out(self, obstacles: Obstacles) -> None:
        """Find out which of the registered points are off the navmesh, and which are inside obstacles."""
        blocked = obstacles.holding(self.walks.points)
        self._inside = {p: name for p, name in enumerate(blocked) if name is not None}
        self._astray = set(np.flatnonzero(~(self.walks.moved <= SNAP_TOLERANCE)).tolist())

    # -- results
    # ----------------------------------------------------------------------------------------------------------

    def check(self, row: ManifestEpisode, placed: _Placed, certificate: Certificate) -> None:
        """Check one row against the results."""
        certificate.same("success_distance", row.success_distance, self.success)
        self._check_stand(placed, certificate)
        numbers = [leaf.leaf for leaf in row.leaves]
        moves = [[move.object_id for move in leaf.moves] for leaf in row.program.leaves]
        objects = [[*(s.object_id for s in leaf.subgoals), leaf.object_id] for leaf in row.leaves]
        certificate.same("leaf_objects", (numbers, objects), ([*range(len(moves))], moves))
        for leaf, name in zip(placed.leaves, LEAF_NAMES, strict=False):
            self._check_reach(leaf, certificate, name)
            self._check_route(row, leaf, certificate, name)
        self._check_apart(placed, certificate)
        if 0 <= row.gold_leaf < len(row.leaves):
            gold = row.leaves[row.gold_leaf]
            claimed = (row.geodesic_distance, row.route_length)
            certificate.same("geodesic_distance", claimed, (gold.geodesic_distance, gold.route_length), "gold leaf")

    def _check_stand(self, placed: _Placed, certificate: Certificate) -> None:
        walks = self.walks
        points = {placed.start}.union(*[leaf.stops + leaf.target.points for leaf in placed.leaves])
        off = [walks.positions[p] for p in sorted(points & self._astray)]
        certificate.holds("standable", not off, "on the floor", off)
        islands = {walks.islands[p] for p in points}
        certificate.holds("island", len(islands) == 1, "one island", sorted(islands))
        radius, least = walks.island_radii[placed.start], self.island_radius
        certificate.holds("island", radius >= least, f"radius of at least {least}", radius, "start")
        inside = [self._inside[p] for p in sorted(points & self._inside.keys())]
        certificate.holds("in_the_way", not inside, "free points", inside)

    def _check_reach(self, placed: _Leaf, certificate: Certificate, name: str) -> None:
        target = placed.target
        for one in (*placed.subgoals, target):
            if one.near is None:
                one.near = self._judge_reach(one)
            for verdict in one.near:
                certificate.holds(*verdict, name)
        if target.side is None:
            target.side = self._judge_side(target)
        for verdict in target.side:
            certificate.holds(*verdict, name)

    def _judge_reach(self, target: _Target) -> list[Verdict]:
        if not target.away:
            return [("goal_reach", False, target.object_id, "no such object")]
        # Farther points are used only if no nearer one is walkable, so never both.
        reach = self.goals.reach if min(target.away) <= self.goals.reach else self.goals.reach_at_most
        farthest = max(target.away)
        wrong = [place for place, good in zip(target.places, target.here, strict=True) if not good]
        return [
            ("goal_reach", farthest <= reach + ROUNDING, (target.object_id, reach), farthest),
            ("goal_reach", not wrong, ("on the floor and in the room of", target.object_id), wrong),
        ]

    def _judge_side(self, target: _Target) -> list[Verdict]:
        found: list[Verdict] = []
        half = self.reach.half_round(target.object_id)
        if half is not None:
            walk = min(max(self.walks.metres(ways)) for ways in target.around)
            most = half + self.detour_at_goal
            found.append(("goal_side", walk <= most + ROUNDING, most, walk))
        few = len(target.places) <= self.goals.points
        found.append(("goal_side", few, self.goals.points, len(target.places)))
        return found

    def _check_route(self, row: ManifestEpisode, placed: _Leaf, certificate: Certificate, name: str) -> None:
        leaf, walks = placed.leaf, self.walks
        direct = min(walks.metres(placed.direct))
        certificate.close("geodesic_distance", leaf.geodesic_distance, direct, MILLIMETRE, name)
        first = walks.metres(placed.direct)[0]
        certificate.holds("goal_order", first <= direct + MILLIMETRE, first, direct, name)
        final = walks.metres(placed.final)
        reached = final[placed.end]
        certificate.holds("route_end", reached <= min(final) + MILLIMETRE, reached, min(final), name)
        ways = [walks.way(leg) for leg in placed.legs]
        certificate.close("route_length", leaf.route_length, math.fsum(length for length, _ in ways), MILLIMETRE, name)
        corners = (row.start_position, *(corner for _, path in ways for corner in path[1:]))
        agreed = leaf.reference_path == corners or _are_close(leaf.reference_path, corners)
        certificate.holds("reference_path", agreed, leaf.reference_path, corners, name)
        low, high = self.range
        certificate.holds("distance_range", low <= direct <= high, (low, high), direct, name)
        if not self.single:
            most = self.detour[0] * direct + self.detour[1]
            certificate.holds("detour", leaf.route_length <= most + MILLIMETRE, most, leaf.route_length, name)
        nearest = min(direct, *walks.metres(placed.first)) if placed.first else direct
        certificate.holds("start_apart", nearest > 2 * self.success, 2 * self.success, nearest, name)

    def _check_apart(self, placed: _Placed, certificate: Certificate) -> None:
        n = len(placed.leaves)
        certificate.checked["leaves_apart"] += n * (n - 1) // 2 - len(placed.gaps)
        for (k, j), pairs in placed.gaps.items():
            gap = min(self.walks.metres(pairs))
            agreed = gap >= self.separation - ROUNDING
            certificate.holds("leaves_apart", agreed, self.separation, gap, f"leaves {k} and {j}")
        certificate.checked["path_apart"] += n * (n - 1)
        for k, away in enumerate(placed.clearances):
            if min(away) < self.success - ROUNDING:
                for j, metres in enumerate(away):
                    if metres < self.success - ROUNDING:
                        name = f"path of leaf {k} and leaf {j}"
                        certificate.checked["path_apart"] -= 1
                        certificate.holds("path_apart", False, self.success, metres, name)


def _points(lists: Sequence[Sequence[Point]]) -> F64:
    """Return the points (n, 3) of all lists."""
    points = chain.from_iterable(lists)
    return np.fromiter(chain.from_iterable(points), np.float64, 3 * sum(map(len, lists))).reshape(-1, 3)


def _end(leaf: EpisodeLeaf) -> int:
    """Return the index, among a leaf's goals, of the goal at which the leaf's path ends."""
    last = leaf.reference_path[-1]
    return min(range(len(leaf.goals)), key=lambda k: math.dist(leaf.goals[k], last))


class _Groups:
    """The number of words of each text, by counterfactual group. All step budgets of a group follow from the group's
    longest text.
    """

    def __init__(self, rows: Sequence[ManifestEpisode]) -> None:
        self._words: dict[str, list[int]] = {}
        for row in rows:
            if row.group_id is not None:
                self._words.setdefault(row.group_id, []).append(len(row.instruction_text.split()))

    def words(self, row: ManifestEpisode, certificate: Certificate) -> int:
        """Return the number of words that determines a row's step budget: the words of the longest text in the row's
        group, or of the row's own text if it has no group.
        """
        if row.group_id is None:
            return len(row.instruction_text.split())
        members = self._words[row.group_id]
        certificate.same("group", GROUP_SIZE, len(members), f"members of {row.group_id}")
        return max(members)


def _ways(row: ManifestEpisode, placed: _Placed) -> list[Way]:
    """Return the walks to the leaves of a row; none if its rotation is not about the vertical axis."""
    yaw = yaw_of(row.start_rotation)
    if yaw is None:
        return []
    return [
        (
            row.start_position,
            yaw,
            (*[subgoal.places[0] for subgoal in leaf.subgoals], leaf.target.places[leaf.end]),
        )
        for leaf in placed.leaves
    ]


def _check_budget(
    row: ManifestEpisode,
    ways: Sequence[Way],
    groups: _Groups,
    walks: Walks,
    rules: VerifierRules,
    certificate: Certificate,
) -> None:
    """Check the step budget against the configuration, the actions of the longest leaf and, if the budget is
    proportional to the text, the number of words.
    """
    certificate.holds("start_rotation", bool(ways), "a turn about the vertical", row.start_rotation)
    if not ways:
        return
    steps = 0
    for k, way in enumerate(ways):
        walk = walks.length(way)
        certificate.holds("budget", walk.arrived, "a walk that arrives", walk.outcome, f"leaf {k}")
        steps = max(steps, walk.actions)
    ceiling, per_word = rules.episodes.step_ceiling, rules.text.steps_per_word
    certificate.holds("budget", 2 * steps <= ceiling, f"at most {ceiling}", 2 * steps, "twice the actions")
    words = per_word * groups.words(row, certificate)
    proportional = rules.episodes.max_steps == "proportional"
    certificate.same("budget", row.max_steps, max(words, 2 * steps) if proportional else ceiling)


def _are_close(one: Sequence[Sequence[float]], other: Sequence[Sequence[float]]) -> bool:
    if len(one) != len(other):
        return False
    return bool(np.abs(np.array(one) - np.array(other)).max() <= MILLIMETRE + ROUNDING)
