"""Check starts, goals and paths of a scene's episodes against the scene's navmesh and its objects' boxes.

All leaves are checked by the same rules, as if each were gold, and all those of a scene together, fact by fact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Scene
from condvln.verify.budgets import check_budgets
from condvln.verify.certificate import Certificate
from condvln.verify.findings import Findings
from condvln.verify.footprints import Obstacles, Reach
from condvln.verify.geodesics import Geodesics, Routes
from condvln.verify.kernels.separation import clearances, near_goals
from condvln.verify.rules import VerifierRules
from condvln.verify.scene_leaves import ROUNDING, SceneLeaves, Target, ranges
from condvln.verify.walks import Walks
from schemas.config.constants import FURNITURE_DETOUR, SNAP_TOLERANCE, WALL_DETOUR
from schemas.evaluation import ManifestEpisode

__all__ = ["check_placement"]

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

MILLIMETRE: Final = 0.001
"""Tolerances in metres between recomputed lengths and corners and the published ones."""

Verdict = tuple[str, bool, Any, Any]
"""A fact, whether it holds, and the claimed and the found value."""


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
    geodesics = Geodesics(pathfinder)
    placed = SceneLeaves(rows, geodesics)
    findings = Findings(placed.row_ends)
    _Checker(rows, placed, geodesics, findings, scene, rules, walls).check(obstacles)
    check_budgets(rows, placed, geodesics.points, findings, walks, rules)
    findings.record(certificates)


class _Metres(NamedTuple):
    """Geodesic distances in metres.

    direct (g,), final (g,) : to each goal of each leaf, from the start and from the leaf's stop before its goal
    first (s,) : from the start to each subgoal
    around : by target, from each place nearest to the object to all places (n, k), if it is the goal of a leaf
    gaps (p,) : between the goals of two leaves, the shorter of the two directions
    """

    direct: F64
    final: F64
    first: F64
    around: list[F64]
    gaps: F64


class _Checker:
    def __init__(
        self,
        rows: Sequence[ManifestEpisode],
        placed: SceneLeaves,
        geodesics: Geodesics,
        findings: Findings,
        scene: Scene,
        rules: VerifierRules,
        walls: bool,
    ) -> None:
        self._rows, self._placed, self._geodesics, self._findings = rows, placed, geodesics, findings
        self._detour_at_goal = FURNITURE_DETOUR if walls else WALL_DETOUR
        single = scene.single_room
        self._goals, self._island_radius = rules.goals, rules.places.island_radius
        self._success = rules.places.success(single)
        self._range = rules.episodes.range(single)
        self._single, self._detour = single, (rules.episodes.detour_factor, rules.episodes.detour_slack)
        self._separation = rules.places.leaf_separation(single)
        self._reach = Reach(scene)
        self._reach.gather((target.object_id, target.places) for target in placed.targets)
        for target in placed.targets:
            target.measure(self._reach)

    def check(self, obstacles: Obstacles) -> None:
        """Check all facts of all rows."""
        placed, findings, rows = self._placed, self._findings, self._rows
        near = near_goals(
            self._geodesics.points[placed.goals],
            placed.goal_ends,
            placed.row_ends,
            self._separation + 2 * np.sqrt(2) * SNAP_TOLERANCE,
        )
        metres = self._ask(near)
        self._check_crossings(obstacles)
        right = np.array([row.success_distance == self._success for row in rows])
        findings.rows("success_distance", right, lambda k: (rows[k].success_distance, self._success))
        self._check_places(obstacles)
        objects = [_objects(row) for row in rows]
        findings.rows("leaf_objects", np.array([one == other for one, other in objects]), lambda k: objects[k])
        self._check_targets(metres.around)
        self._check_routes(metres)
        self._check_gaps(near, metres.gaps)
        self._check_clearances()
        gold = [row.leaves[row.gold_leaf] if 0 <= row.gold_leaf < len(row.leaves) else None for row in rows]
        lengths = [
            ((row.geodesic_distance, row.route_length), leaf and (leaf.geodesic_distance, leaf.route_length))
            for row, leaf in zip(rows, gold, strict=True)
        ]
        findings.rows(
            "geodesic_distance",
            np.array([claimed == found for claimed, found in lengths]),
            lambda k: lengths[k],
            "gold leaf",
            of=np.array([leaf is not None for leaf in gold]),
        )

    # -- queries to the navmesh
    # -------------------------------------------------------------------------------------------

    def _ask(self, near: I64) -> _Metres:
        """Return all distances that the checks need, which are found together."""
        placed = self._placed
        goal_counts, stop_counts = np.diff(placed.goal_ends, prepend=0), np.diff(placed.stop_ends, prepend=0)
        start = placed.start[placed.row]
        before = start.copy()
        after_others = np.flatnonzero(stop_counts)
        before[after_others] = placed.stops[placed.stop_ends[after_others] - 1]
        fans = [(target.nearest if target.is_goal else [], target.points) for target in placed.targets]
        one, other = placed.goals[near[:, 2]], placed.goals[near[:, 3]]
        asked = [
            (np.repeat(start, goal_counts), placed.goals),
            (np.repeat(before, goal_counts), placed.goals),
            (np.repeat(start, stop_counts), placed.stops),
            (
                np.array([near for nearest, points in fans for near in nearest for _ in points], dtype=np.int64),
                np.array([point for nearest, points in fans for _ in nearest for point in points], dtype=np.int64),
            ),
            # Detour's path back may be shorter than its path there.
            (one, other),
            (other, one),
        ]
        ones, others = (np.concatenate(part) for part in zip(*asked, strict=True))
        found = self._geodesics.metres(ones, others)
        direct, final, first, around, there, back = np.split(found, np.cumsum([len(part) for part, _ in asked])[:-1])
        shapes = [(len(nearest), len(points)) for nearest, points in fans]
        ends = np.cumsum([rows * columns for rows, columns in shapes]).tolist()
        tables = [around[end - n * k : end].reshape(n, k) for (n, k), end in zip(shapes, ends, strict=True)]
        return _Metres(direct, final, first, tables, np.minimum(there, back))

    def _legs(self) -> tuple[Routes, I64]:
        """Return the paths from stop to stop of each leaf, concatenated, and the end index (l,) of each leaf's."""
        placed = self._placed
        stop_counts = np.diff(placed.stop_ends, prepend=0)
        leg_ends = np.cumsum(stop_counts + 1)
        ones, others = np.empty(leg_ends[-1], np.int64), np.empty(leg_ends[-1], np.int64)
        last, first = leg_ends - 1, leg_ends - stop_counts - 1
        inner = np.ones(len(ones), dtype=bool)
        inner[last] = False
        others[inner], others[last] = placed.stops, placed.goals[placed.ends_of_paths()]
        inner[:] = True
        inner[first] = False
        ones[inner], ones[first] = placed.stops, placed.start[placed.row]
        return self._geodesics.routes(ones, others), leg_ends

    # -- facts of rows
    # ----------------------------------------------------------------------------------------------------

    def _check_crossings(self, obstacles: Obstacles) -> None:
        placed, ends = self._placed, self._placed.row_ends
        met = obstacles.crossed(placed.corners, placed.corner_ends)
        free = np.ones(len(ends), dtype=bool)
        free[placed.row[[leaf for leaf, name in enumerate(met) if name is not None]]] = False
        self._findings.rows(
            "in_the_way",
            free,
            lambda k: ("free paths", met[int(ends[k - 1]) if k else 0 : int(ends[k])]),
            "paths",
        )

    def _check_places(self, obstacles: Obstacles) -> None:
        """Check that all points of a row are on the navmesh, on one island, and outside obstacles."""
        placed, at, findings = self._placed, self._geodesics, self._findings
        rows = len(placed.row_ends)
        goal_counts, stop_counts = np.diff(placed.goal_ends, prepend=0), np.diff(placed.stop_ends, prepend=0)
        points = np.concatenate([placed.start, placed.goals, placed.stops])
        row = np.concatenate([np.arange(rows), np.repeat(placed.row, goal_counts), np.repeat(placed.row, stop_counts)])

        def named(k: int, chosen: Bools) -> list[int]:
            return sorted(set(points[(row == k) & chosen].tolist()))

        def without(chosen: Bools) -> Bools:
            good = np.ones(rows, dtype=bool)
            good[row[chosen]] = False
            return good

        astray = ~(at.moved <= SNAP_TOLERANCE)[points]
        findings.rows(
            "standable", without(astray), lambda k: ("on the floor", [at.positions[p] for p in named(k, astray)])
        )
        islands = at.islands[points]
        findings.rows(
            "island",
            without(islands != islands[row]),
            lambda k: ("one island", sorted(set(islands[row == k].tolist()))),
        )
        radii, least = at.island_radii[placed.start], self._island_radius
        findings.rows("island", radii >= least, lambda k: (f"radius of at least {least}", float(radii[k])), "start")
        blocking = obstacles.holding(at.points)
        blocked = np.array([name is not None for name in blocking])[points]
        findings.rows(
            "in_the_way", without(blocked), lambda k: ("free points", [blocking[p] for p in named(k, blocked)])
        )

    def _check_gaps(self, near: I64, metres: F64) -> None:
        """Check that the goals of the leaves of a row are far enough apart. A straight line already shows it for all
        but the goals `near` each other.
        """
        placed = self._placed
        sizes = np.diff(placed.row_ends, prepend=0)
        self._findings.count("leaves_apart", sizes * (sizes - 1) // 2)
        pairs, first = np.unique(near[:, 0] * len(placed.leaves) + near[:, 1], return_index=True)
        if not len(pairs):
            return
        least = np.minimum.reduceat(metres, first)
        for at in np.flatnonzero(~(least >= self._separation - ROUNDING)).tolist():
            leaf, other = near[first[at], :2].tolist()
            row = int(placed.row[leaf])
            begin = int(placed.row_ends[row] - sizes[row])
            self._findings.refute_row(
                row, "leaves_apart", self._separation, float(least[at]), f"leaves {leaf - begin} and {other - begin}"
            )

    def _check_clearances(self) -> None:
        """Check that no path of a leaf enters the success ball of another leaf of its row. A straight line is never
        longer than a path, so a path with enough clearance by it never enters the ball.
        """
        placed = self._placed
        sizes = np.diff(placed.row_ends, prepend=0)
        self._findings.count("path_apart", sizes * (sizes - 1))
        squares = clearances(
            placed.corners,
            placed.corner_ends,
            self._geodesics.points[placed.goals],
            placed.goal_ends,
            placed.row_ends,
            int(sizes.max()),
        )
        away = np.sqrt(squares)
        for leaf, other in np.argwhere(away < self._success - ROUNDING).tolist():
            row = int(placed.row[leaf])
            name = f"path of leaf {leaf - int(placed.row_ends[row] - sizes[row])} and leaf {other}"
            self._findings.refute_row(row, "path_apart", self._success, float(away[leaf, other]), name)

    # -- facts of leaves
    # ----------------------------------------------------------------------------------------------------

    def _check_targets(self, around: Sequence[F64]) -> None:
        """Check the goals of each leaf and its subgoals. What holds of a target is found once."""
        placed, findings = self._placed, self._findings
        near = [self._judge_reach(target) for target in placed.targets]
        side = [
            self._judge_side(target, its) if target.is_goal else []
            for target, its in zip(placed.targets, around, strict=True)
        ]
        stop_counts = np.diff(placed.stop_ends, prepend=0)
        leaf = np.concatenate([np.repeat(np.arange(len(placed.leaves)), stop_counts), np.arange(len(placed.leaves))])
        of = np.concatenate([placed.stops_of, placed.goals_of])
        for fact, judged, leaves, targets in (
            ("goal_reach", near, leaf, of),
            ("goal_side", side, np.arange(len(placed.leaves)), placed.goals_of),
        ):
            checks = np.array([len(verdicts) for verdicts in judged], dtype=np.int64)[targets]
            rows = np.bincount(placed.row[leaves], weights=checks, minlength=len(placed.row_ends))
            findings.count(fact, rows.astype(np.int64))
        good = np.array([all(held for _, held, _, _ in (*n, *s)) for n, s in zip(near, side, strict=True)])
        findings.leaf_by_leaf()
        for k in sorted(set(leaf[~good[of]].tolist())):
            own = [*of[leaf == k].tolist()]
            for verdicts in [*(near[target] for target in own), side[own[-1]]]:
                for fact, held, claimed, found in verdicts:
                    if not held:
                        findings.refute_leaf(k, fact, claimed, found)

    def _judge_reach(self, target: Target) -> list[Verdict]:
        if not target.away:
            return [("goal_reach", False, target.object_id, "no such object")]
        # Farther points are used only if no nearer one is walkable, so never both.
        reach = self._goals.reach if min(target.away) <= self._goals.reach else self._goals.reach_at_most
        farthest = max(target.away)
        wrong = [place for place, good in zip(target.places, target.here, strict=True) if not good]
        return [
            ("goal_reach", farthest <= reach + ROUNDING, (target.object_id, reach), farthest),
            ("goal_reach", not wrong, ("on the floor and in the room of", target.object_id), wrong),
        ]

    def _judge_side(self, target: Target, around: F64) -> list[Verdict]:
        found: list[Verdict] = []
        half = self._reach.half_round(target.object_id)
        if half is not None:
            walk = float(around.max(axis=1).min())
            most = half + self._detour_at_goal
            found.append(("goal_side", walk <= most + ROUNDING, most, walk))
        few = len(target.places) <= self._goals.points
        found.append(("goal_side", few, self._goals.points, len(target.places)))
        return found

    def _check_routes(self, metres: _Metres) -> None:
        placed, findings, leaves = self._placed, self._findings, self._placed.leaves
        first_goal = placed.goal_ends - np.diff(placed.goal_ends, prepend=0)
        direct = np.minimum.reduceat(metres.direct, first_goal)
        claimed = np.array([leaf.geodesic_distance for leaf in leaves])
        findings.leaves(
            "geodesic_distance",
            np.abs(claimed - direct) <= MILLIMETRE,
            lambda k: (leaves[k].geodesic_distance, float(direct[k])),
        )
        first = metres.direct[first_goal]
        findings.leaves("goal_order", first <= direct + MILLIMETRE, lambda k: (float(first[k]), float(direct[k])))
        reached, final = metres.final[placed.ends_of_paths()], np.minimum.reduceat(metres.final, first_goal)
        findings.leaves("route_end", reached <= final + MILLIMETRE, lambda k: (float(reached[k]), float(final[k])))
        legs, leg_ends = self._legs()
        lengths = np.add.reduceat(legs.metres, np.concatenate([[0], leg_ends[:-1]]))
        routes = np.array([leaf.route_length for leaf in leaves])
        findings.leaves(
            "route_length",
            np.abs(routes - lengths) <= MILLIMETRE,
            lambda k: (leaves[k].route_length, float(lengths[k])),
        )
        self._check_corners(legs, leg_ends)
        low, high = self._range
        findings.leaves("distance_range", (low <= direct) & (direct <= high), lambda k: ((low, high), float(direct[k])))
        if not self._single:
            most = self._detour[0] * direct + self._detour[1]
            findings.leaves("detour", routes <= most + MILLIMETRE, lambda k: (float(most[k]), leaves[k].route_length))
        nearest = direct.copy()
        stop_counts = np.diff(placed.stop_ends, prepend=0)
        np.minimum.at(nearest, np.repeat(np.arange(len(leaves)), stop_counts), metres.first)
        apart = 2 * self._success
        findings.leaves("start_apart", nearest > apart, lambda k: (apart, float(nearest[k])))

    def _check_corners(self, legs: Routes, leg_ends: I64) -> None:
        """Check that the corners of each leaf's path are its start and those of the paths from stop to stop."""
        placed, leaves = self._placed, self._placed.leaves
        more = np.maximum(legs.count - 1, 0)  # each path begins where the one before it ended
        own = placed.row
        firsts = np.concatenate([[0], leg_ends[:-1]])
        counts = 1 + np.add.reduceat(more, firsts)
        ends = np.cumsum(counts)
        found = np.empty((int(ends[-1]), 3))
        starting = np.zeros(len(found), dtype=bool)
        starting[ends - counts] = True
        found[starting] = self._geodesics.points[placed.start[own]]
        found[~starting] = legs.corners[ranges(legs.first + 1, more)]
        claimed = np.diff(placed.corner_ends, prepend=0)
        equal = counts == claimed
        off = np.abs(found[np.repeat(equal, counts)] - placed.corners[np.repeat(equal, claimed)]).max(axis=1)
        agreed = equal.copy()
        agreed[np.repeat(np.flatnonzero(equal), counts[equal])[~(off <= MILLIMETRE + ROUNDING)]] = False

        def details(k: int) -> tuple[Any, Any]:
            path = found[int(ends[k] - counts[k]) : int(ends[k])].tolist()
            return leaves[k].reference_path, tuple(tuple(corner) for corner in path)

        self._findings.leaves("reference_path", agreed, details)


def _objects(row: ManifestEpisode) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Return the numbers and objects of a row's leaves, as its leaves and as its program have them."""
    numbers = [leaf.leaf for leaf in row.leaves]
    objects = [[*(stop.object_id for stop in leaf.subgoals), leaf.object_id] for leaf in row.leaves]
    moves = [[move.object_id for move in leaf.moves] for leaf in row.program.leaves]
    return (numbers, objects), ([*range(len(moves))], moves)
