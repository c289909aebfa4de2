"""Starts, goals and paths of a scene's episodes, held against its navmesh and its boxes.

All leaves are held to the same rules, as if each were gold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.follower import Follower
from condvln.scene import Scene
from condvln.verify.certificate import Certificate
from condvln.verify.heading import yaw_of
from condvln.verify.rules import Rules
from condvln.verify.standing import Obstacles, Reach
from condvln.verify.walks import Walks
from schemas.episode import EpisodeLeaf
from schemas.evaluation import ManifestEpisode

__all__ = ["check_placement"]

F64 = NDArray[np.float64]

MILLIMETRE: Final = 0.001
"""How far re-derived lengths and corners may be from the published ones."""
ROUNDING: Final = 1e-6
"""Metres by which a distance may fall short of a bound that it was held to in other arithmetic."""
ON_FLOOR: Final = 0.05
"""Metres that snapping may move a point that stands on the floor."""
DETOUR: Final = 1.0
"""Metres that the way between two goals of one object may be longer than half way round it; more means a wall."""


@dataclass(frozen=True, eq=False, slots=True)
class _Leaf:
    """One leaf, with the indices of its points and of the questions about them.

    path (n, 3), goal_points (k, 3) : the published ones
    direct : from the start to the goals; final : from the last stop to the goals; first : from the start to the
    subgoals; around : from the goal nearest to the object to all; legs : from stop to stop
    """

    leaf: EpisodeLeaf
    path: F64
    goal_points: F64
    stops: tuple[int, ...]
    goals: tuple[int, ...]
    direct: tuple[int, ...]
    final: tuple[int, ...]
    first: tuple[int, ...]
    around: tuple[int, ...]
    legs: tuple[int, ...]


@dataclass(frozen=True, eq=False, slots=True)
class _Placed:
    """A row's start, leaves, and the questions about the gaps between every two leaves."""

    start: int
    leaves: tuple[_Leaf, ...]
    gaps: dict[tuple[int, int], list[int]]


def check_placement(
    rows: Sequence[ManifestEpisode],
    certificates: Sequence[Certificate],
    scene: Scene,
    follower: Follower,
    rules: Rules,
) -> None:
    """Everything about the episodes of one scene that has a place."""
    checker = _Checker(scene, rules)
    placed = [checker.note(row) for row in rows]
    checker.walks.ask(follower.pathfinder)
    obstacles = Obstacles(scene, follower.pathfinder, rules.agent.max_climb)
    checker.blocked = obstacles.holding(np.array(checker.walks.positions).reshape(-1, 3))
    crossed = iter(obstacles.crossed([leaf.path for places in placed for leaf in places.leaves]))
    for row, certificate, places in zip(rows, certificates, placed, strict=True):
        met = [next(crossed) for _ in row.leaves]
        certificate.holds("in_the_way", met.count(None) == len(met), "free paths", met, "paths")
        checker.check(row, places, certificate)
        _check_budget(row, follower, rules, certificate)


class _Checker:
    def __init__(self, scene: Scene, rules: Rules) -> None:
        episodes = rules.episodes
        single = scene.single_room
        self.rules = episodes
        self.success = episodes.success_distance_single_room if single else episodes.success_distance
        self.range = episodes.distance_single_room if single else episodes.distance
        self.separation = 2 * self.success + episodes.leaf_gap
        self.walks = Walks()
        self.reach = Reach(scene)
        self.blocked: list[str | None] = []

    # -- what is wanted of the navmesh ---------------------------------------------------------------------------------

    def note(self, row: ManifestEpisode) -> _Placed:
        """Note every question about a row."""
        start = self.walks.point(row.start_position)
        leaves = tuple(self._note_leaf(start, leaf) for leaf in row.leaves)
        return _Placed(start, leaves, self._note_gaps(leaves))

    def _note_leaf(self, start: int, leaf: EpisodeLeaf) -> _Leaf:
        point, pair = self.walks.point, self.walks.pair
        goals = tuple([point(goal) for goal in leaf.goals])
        subgoals = tuple([point(subgoal.position) for subgoal in leaf.subgoals])
        stops = (start, *subgoals, goals[0])
        direct = tuple([pair(start, goal) for goal in goals])
        away = [distance for distance, _ in self.reach.around(leaf.object_id, leaf.goals) or ((0.0, True),)]
        nearest = goals[away.index(min(away))]
        return _Leaf(
            leaf=leaf,
            path=np.array(leaf.reference_path),
            goal_points=np.array(leaf.goals),
            stops=stops,
            goals=goals,
            direct=direct,
            final=tuple([pair(stops[-2], goal) for goal in goals]) if subgoals else direct,
            first=tuple([pair(start, subgoal) for subgoal in subgoals]),
            around=tuple([pair(nearest, goal) for goal in goals]),
            legs=tuple([self.walks.leg(one, other) for one, other in pairwise(stops)]),
        )

    def _note_gaps(self, leaves: Sequence[_Leaf]) -> dict[tuple[int, int], list[int]]:
        """Pairs of goals so close that they may tell the gap of two leaves: a way is no shorter than the line."""
        points = np.concatenate([leaf.goal_points for leaf in leaves])
        names = [goal for leaf in leaves for goal in leaf.goals]
        owners = [k for k, leaf in enumerate(leaves) for _ in leaf.goals]
        apart = points[:, None] - points[None]
        near = np.einsum("ijk,ijk->ij", apart, apart) < self.separation**2
        gaps: dict[tuple[int, int], list[int]] = {
            (k, j): [] for k in range(len(leaves)) for j in range(k + 1, len(leaves))
        }
        for one, other in np.argwhere(near).tolist():
            if owners[one] < owners[other]:
                gaps[owners[one], owners[other]].append(self.walks.pair(names[one], names[other]))
        return gaps

    # -- what comes out ------------------------------------------------------------------------------------------------

    def check(self, row: ManifestEpisode, placed: _Placed, certificate: Certificate) -> None:
        """Hold one row against the answers."""
        certificate.same("success_distance", row.success_distance, self.success)
        self._check_stand(placed, certificate)
        numbers = [leaf.leaf for leaf in row.leaves]
        moves = [[move.object_id for move in leaf.moves] for leaf in row.program.leaves]
        objects = [[*(s.object_id for s in leaf.subgoals), leaf.object_id] for leaf in row.leaves]
        certificate.same("leaf_objects", (numbers, objects), ([*range(len(moves))], moves))
        for k, leaf in enumerate(placed.leaves):
            self._check_reach(leaf, certificate, f"leaf {k}")
            self._check_route(row, leaf, certificate, f"leaf {k}")
        self._check_apart(placed, certificate)
        if 0 <= row.gold_leaf < len(row.leaves):
            gold = row.leaves[row.gold_leaf]
            claimed = (row.geodesic_distance, row.route_length)
            certificate.same("geodesic_distance", claimed, (gold.geodesic_distance, gold.route_length), "gold leaf")

    def _check_stand(self, placed: _Placed, certificate: Certificate) -> None:
        walks = self.walks
        points = {placed.start}.union(*(leaf.stops for leaf in placed.leaves), *(leaf.goals for leaf in placed.leaves))
        off = [walks.positions[p] for p in points if not max(walks.sideways[p], walks.upwards[p]) <= ON_FLOOR]
        certificate.holds("standable", not off, "on the floor", off)
        islands = {walks.islands[p] for p in points}
        certificate.holds("island", len(islands) == 1, "one island", sorted(islands))
        radius, least = walks.island_radii[placed.start], self.rules.island_radius
        certificate.holds("island", radius >= least, f"radius of at least {least}", radius, "start")
        inside = [self.blocked[p] for p in points if self.blocked[p] is not None]
        certificate.holds("in_the_way", not inside, "free points", inside)

    def _check_reach(self, placed: _Leaf, certificate: Certificate, name: str) -> None:
        leaf, rules = placed.leaf, self.rules
        for object_id, positions in (
            *((subgoal.object_id, (subgoal.position,)) for subgoal in leaf.subgoals),
            (leaf.object_id, leaf.goals),
        ):
            found = self.reach.around(object_id, positions)
            if found is None:
                certificate.holds("goal_reach", False, object_id, "no such object", name)
                continue
            away = [distance for distance, _ in found]
            # Farther points only where nothing nearer can be stood on, so never both.
            reach = rules.goal_reach if min(away) <= rules.goal_reach else rules.goal_reach_at_most
            certificate.holds("goal_reach", max(away) <= reach + ROUNDING, (object_id, reach), max(away), name)
            wrong = [position for position, (_, here) in zip(positions, found, strict=True) if not here]
            certificate.holds("goal_reach", not wrong, ("on the floor and in the room of", object_id), wrong, name)
        around = self.reach.half_round(leaf.object_id)
        if around is not None:
            walk = max(self.walks.metres(placed.around))
            certificate.holds("goal_side", walk <= around + DETOUR + ROUNDING, around + DETOUR, walk, name)
        certificate.holds("goal_side", len(leaf.goals) <= rules.goal_points, rules.goal_points, len(leaf.goals), name)

    def _check_route(self, row: ManifestEpisode, placed: _Leaf, certificate: Certificate, name: str) -> None:
        leaf, walks = placed.leaf, self.walks
        direct = min(walks.metres(placed.direct))
        certificate.close("geodesic_distance", leaf.geodesic_distance, direct, MILLIMETRE, name)
        final = walks.metres(placed.final)
        certificate.holds("goal_order", final[0] <= min(final) + MILLIMETRE, final[0], min(final), name)
        ways = [walks.way(leg) for leg in placed.legs]
        certificate.close("route_length", leaf.route_length, math.fsum(length for length, _ in ways), MILLIMETRE, name)
        corners = (row.start_position, *(corner for _, path in ways for corner in path[1:]))
        agreed = leaf.reference_path == corners or _are_close(leaf.reference_path, corners)
        certificate.holds("reference_path", agreed, leaf.reference_path, corners, name)
        low, high = self.range
        certificate.holds("distance_range", low <= direct <= high, (low, high), direct, name)
        nearest = min(direct, *walks.metres(placed.first)) if placed.first else direct
        certificate.holds("start_apart", nearest > 2 * self.success, 2 * self.success, nearest, name)

    def _check_apart(self, placed: _Placed, certificate: Certificate) -> None:
        for (k, j), pairs in placed.gaps.items():
            gap = min(self.walks.metres(pairs), default=self.separation)
            agreed = gap >= self.separation - ROUNDING
            certificate.holds("leaves_apart", agreed, self.separation, gap, f"leaves {k} and {j}")
        away = _clearances(placed.leaves)
        close = np.argwhere(away < self.success - ROUNDING).tolist()
        for k, j in close:
            name = f"path of leaf {k} and leaf {j}"
            certificate.holds("path_apart", False, self.success, float(away[k, j]), name)
        certificate.checked["path_apart"] += len(away) * (len(away) - 1) - len(close)


def _check_budget(row: ManifestEpisode, follower: Follower, rules: Rules, certificate: Certificate) -> None:
    """The budget by the words of the text, and by the actions to the leaf that takes most of them."""
    yaw = yaw_of(row.start_rotation)
    certificate.holds("start_rotation", yaw is not None, "a turn about the vertical", row.start_rotation)
    if yaw is None:
        return
    steps = 0
    for k, leaf in enumerate(row.leaves):
        stops = [*(subgoal.position for subgoal in leaf.subgoals), leaf.goals[0]]
        route = follower.follow(row.start_position, yaw, stops)
        certificate.holds("budget", route.arrived, "a walk that arrives", route.outcome, f"leaf {k}")
        steps = max(steps, len(route.actions))
    ceiling, words = rules.episodes.max_steps, rules.episodes.steps_per_word * len(row.instruction_text.split())
    certificate.holds("budget", 2 * steps <= ceiling, f"at most {ceiling}", 2 * steps, "twice the actions")
    certificate.same("budget", row.max_steps, min(ceiling, max(words, 2 * steps)))


def _are_close(one: Sequence[Sequence[float]], other: Sequence[Sequence[float]]) -> bool:
    if len(one) != len(other):
        return False
    return bool(np.abs(np.array(one) - np.array(other)).max() <= MILLIMETRE + ROUNDING)


def _clearances(leaves: Sequence[_Leaf]) -> F64:
    """(l, l) least straight-line metres from each leaf's path to another leaf's goals; infinite on the diagonal.

    A straight line is never longer than a way, so that a path that keeps clear by it never enters the ball.
    """
    begins = np.concatenate([leaf.path[:-1] for leaf in leaves])
    along = np.concatenate([leaf.path[1:] for leaf in leaves]) - begins
    goals = np.concatenate([leaf.goal_points for leaf in leaves])
    squares = (along * along).sum(axis=1)
    to_goals = goals[None] - begins[:, None]
    part = np.einsum("ijk,ik->ij", to_goals, along) / np.where(squares > 0.0, squares, 1.0)[:, None]
    off = to_goals - np.minimum(np.maximum(part, 0.0), 1.0)[..., None] * along[:, None]
    away = np.sqrt(np.einsum("ijk,ijk->ij", off, off))
    rows = np.cumsum([0, *(len(leaf.path) - 1 for leaf in leaves[:-1])])
    columns = np.cumsum([0, *(len(leaf.goals) for leaf in leaves[:-1])])
    least: F64 = np.minimum.reduceat(np.minimum.reduceat(away, rows, axis=0), columns, axis=1)
    np.fill_diagonal(least, np.inf)
    return least
