"""Place a program on a navmesh: choose one start, and for every leaf its goal points, stops and path."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.episodes.facing import HEADINGS, Facings, Headings
from condvln.episodes.footprint import Footprints
from condvln.episodes.goals import blocked_footprints, is_standable, wide_islands
from condvln.episodes.kernels.starts import REFUSALS, Bounds
from condvln.episodes.starts import ANY_LENGTH, FoundLeaf, GoalField, Leaves, Route, Starts
from condvln.instructions.stops import Stops
from condvln.navigation.follower import FollowedRoute, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Scene, round_mm
from condvln.scene.scene import EVERYTHING_SEEN, Sightings
from condvln.seeding import FewDraws, generator
from schemas.config import EpisodeConfig, PlacesConfig, Thresholds
from schemas.program import Program

if TYPE_CHECKING:
    from condvln.episodes.leads import LeadPlaces

__all__ = [
    "Outlook",
    "PlacedLeaf",
    "Placement",
    "Placer",
    "Rejected",
    "Routes",
    "heading_degrees",
    "reachable_stops",
    "yaw_quaternion",
]


COMPASS_STEP: Final = math.pi / 4
"""Yaw step in radians of texts that name the start heading: the eight compass points."""


NOT_FIT: Final = "observability_missed"
"""Rejection reason: other rules can be met, but not the cell's observability."""


ROUTE_MISSED: Final = "route_missed"
"""Rejection reason: other rules can be met, but the routes are shorter or longer than the cell asks for."""


LOOKING: Final = ("looking_unseen", "looking_detour", "looking_budget")
"""Rejection reasons of looking paths."""


LEAD_MARGIN: Final = 0.1
"""Metres, in addition to the success distance, between where a lead ends and any goal."""
LEAD_TRIES: Final = 3
"""Number of ways in which it is tried to end the leads of a program."""


LOOKS: Final = 5
"""Number of starts after which a program is given up because of its looking paths: they are costly, and what a start
can't see, the others mostly can't either."""


class Rejected(Exception):
    """A program can't be placed; `reason` is a key of ``candidates.REASONS``; `final` from no start at all."""

    def __init__(self, reason: str, *, final: bool = False) -> None:
        self.reason, self.final = reason, final
        super().__init__(reason)


@dataclass(frozen=True, eq=False, slots=True)
class PlacedLeaf:
    """One leaf, computed as if it were gold: its goals, route, geodesic distance and ground-truth walk.

    goals : (k, 3) metres, the one nearest to the start first; the route ends at one of them
    The distance is the geodesic from start to goal as Habitat measures it; the walk is that of a map-aware follower.
    """

    objects: tuple[str, ...]
    goals: F64
    route: Route
    geodesic_distance: float
    walk: FollowedRoute

    @property
    def steps(self) -> int:
        """Number of ground-truth actions, STOP included."""
        return len(self.walk.actions)


@dataclass(frozen=True, eq=False, slots=True)
class Outlook:
    """What an agent may see before it must choose a leaf.

    start (3,) metres; yaw in radians about +Y; the path (n, 3) to each leaf
    """

    start: F64
    yaw: float
    paths: tuple[F64, ...]


Fit: TypeAlias = Callable[[Outlook], float | None]


@dataclass(frozen=True, eq=False, slots=True)
class Routes:
    """A start that meets all rules on distances: start (3,) in metres, yaw in radians about +Y, the objects and the
    route of each leaf.
    """

    start: F64
    yaw: float
    objects: tuple[tuple[str, ...], ...]
    leaves: tuple[FoundLeaf, ...]
    success_distance: float


@dataclass(frozen=True, eq=False, slots=True)
class Placement:
    """The start of an instruction and all its leaves; start (3,) in metres, yaw in radians about +Y."""

    start: F64
    yaw: float
    leaves: tuple[PlacedLeaf, ...]
    success_distance: float

    @property
    def outlook(self) -> Outlook:
        """The start and paths from which observability is computed."""
        return Outlook(self.start, self.yaw, tuple(leaf.route.path for leaf in self.leaves))

    @property
    def steps(self) -> int:
        """Number of ground-truth actions of the longest leaf. The number is thus the same whichever leaf is gold."""
        return max(leaf.steps for leaf in self.leaves)


def yaw_quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion ``[x, y, z, w]`` of a rotation by `yaw` radians about +Y."""
    return (0.0, math.sin(yaw / 2), 0.0, math.cos(yaw / 2))


def heading_degrees(yaw: float) -> float:
    """Return the compass heading of a yaw (radians about +Y) in degrees clockwise from north (−Z), in [0, 360)."""
    return round(math.degrees(-yaw) % 360.0, 6) % 360.0


def reachable_stops(pathfinder: Pathfinder, field: GoalField, separation: float) -> Stops:
    """Return, for the program sampler, which objects have goal points, and which pairs of them are far enough apart.

    separation : least geodesic distance in metres between goals of two leaves
    """
    on = np.zeros((len(field.goals), pathfinder.num_islands), dtype=bool)
    for k, points in enumerate(field.goals.values()):
        on[k, pathfinder.get_islands(points)] = True
    # Two objects without a path between them do not count as apart: a program could not lead from one to the other.
    shared = (on.astype(np.int64) @ on.T.astype(np.int64)) > 0
    return Stops(tuple(field.goals), field.apart(separation) & shared)


class Placer:
    """Places programs in one scene. The result depends only on scene, navmesh, goals, rules and seed, not on the order
    of calls.

    Parameters
    ----------
    goals : goal points (k, 3) by object id, see ``goals.scene_goals``
    max_climb : largest step in metres that the agent can climb
    thresholds : bounds of the egocentric directions
    sightings : objects that can't be seen; words of a text never refer to them
    """

    def __init__(
        self,
        scene: Scene,
        pathfinder: Pathfinder,
        goals: Mapping[str, F64],
        places: PlacesConfig,
        rules: EpisodeConfig,
        seed: int,
        *,
        max_climb: float,
        thresholds: Thresholds | None = None,
        sightings: Sightings = EVERYTHING_SEEN,
    ) -> None:
        self.thresholds, self.sightings = thresholds or Thresholds(), sightings
        self.scene = scene
        self.pathfinder = pathfinder
        self.places = places
        self.rules = rules
        self.seed = seed
        self.tau = places.success(scene.single_room)
        self.obstacles = blocked_footprints(scene, pathfinder, max_climb)
        # STOP is one more action
        self._follower = Follower(pathfinder, max_actions=max(1, rules.step_ceiling // 2 - 1))
        self._solid = Footprints([footprint for _, footprint in self.obstacles])
        self.field = GoalField(pathfinder, goals)
        self.leads: LeadPlaces | None = None
        """where leads end; without them, no program may have leads"""

    @cached_property
    def starts(self) -> F64:
        """The start positions (s, 3) to try, drawn by the seed. Each is on the floor of a wide island and outside all
        objects on the floor.
        """
        islands = wide_islands(self.pathfinder, self.places)
        if not islands:
            return np.empty((0, 3))
        rng = generator(self.seed, self.scene.scene_id, "starts")
        drawn = np.concatenate(
            [self.pathfinder.get_random_navigable_points(2 * self.rules.starts, rng, island) for island in islands]
        )
        points = np.unique(round_mm(drawn), axis=0)
        keep = is_standable(self.pathfinder, points, self.places)
        for _, footprint in self.obstacles:
            keep &= footprint.distance(points) > 0.0
        points = points[keep]
        # np.unique sorted the points; the pool's order must not favour one end of the apartment.
        order = generator(self.seed, self.scene.scene_id, "start order").permutation(len(points))
        return np.asarray(points[order][: self.rules.starts], dtype=np.float64)

    @cached_property
    def _from_starts(self) -> Starts:
        return Starts(self.pathfinder, self._targets[0], self.starts, self._solid)

    @cached_property
    def _targets(self) -> tuple[GoalField, dict[str, int]]:
        """The objects, and after them each place at which a lead may end; and the number of each room's first place."""
        targets, first = dict(self.field.goals), dict[str, int]()
        for room in self.scene.rooms:
            first[room.room_id] = len(targets)
            ends = () if self.leads is None else self.leads.points(room.room_id)
            targets.update({f"{room.room_id} {k}": at[None] for k, at in enumerate(ends)})
        return GoalField(self.pathfinder, targets), first

    @cached_property
    def _apart(self) -> list[list[bool]]:
        """Whether two objects are at least the leaf separation apart; lists, since single pairs are asked about."""
        apart: list[list[bool]] = self.field.apart(self.leaf_separation).tolist()
        return apart

    @property
    def leaf_separation(self) -> float:
        """Minimum geodesic distance in metres that the goals of two leaves must have in this scene."""
        return self.places.leaf_separation(self.scene.single_room)

    def _is_near(self, one: int, other: int, least: float) -> bool:
        """Return whether the geodesic distance between two objects is less than `least`, which is at most the leaf
        separation.
        """
        return not self._apart[one][other] and (one == other or self.field.gap(one, other) < least)

    @cached_property
    def _order(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.field.goals)}

    def check_objects(self, program: Program) -> None:
        """Check the rules that need no start: every stop has goal points; leaves and stops are far enough apart.

        Raises
        ------
        Rejected : a rule does not hold
        """
        names = [[move.object_id for move in leaf.moves] for leaf in program.leaves]
        if not all(name in self._order for moves in names for name in moves):
            raise Rejected("object_without_goal_point")
        stops = [[self._order[name] for name in moves] for moves in names]
        for k, one in enumerate(stops):
            for other in stops[k + 1 :]:
                if self._is_near(one[-1], other[-1], self.leaf_separation):
                    raise Rejected("leaves_too_close")
        for moves in stops:
            for one_stop, next_stop in pairwise(moves):
                if self._is_near(one_stop, next_stop, 2 * self.tau):
                    raise Rejected("moves_too_close")

    def place(
        self,
        program: Program,
        instruction_id: str,
        *,
        compass: bool,
        fit: Fit | None = None,
        lengths: tuple[float, float] | None = None,
        members: Sequence[Program] | None = None,
        look: Callable[[Routes], None] | None = None,
    ) -> Placement:
        """Find one start for `program` from which every leaf meets every rule. Where its leads end is tried in several
        ways.

        Parameters
        ----------
        compass : the text names the start heading, so the yaw must be a compass point
        fit : further rule on the start and paths: returns the yaw that meets it, or None
        lengths : inclusive bounds in metres of every leaf's route
        members : the programs that share the start, `program` alone by default
        look : checks the looking paths; raises `Rejected`

        Raises
        ------
        Rejected : no start meets every rule; `reason` says which rule failed
        """
        if not len(self.starts):
            raise Rejected("no_start")
        self.check_objects(program)
        refused: Rejected | None = None
        for ends in self._lead_ends(members or (program,)):
            stops = [[ends[at] for at in program.led_branches(leaf)] for leaf in range(len(program.leaves))]
            for its, leaf in zip(stops, program.leaves, strict=True):
                its += [self._order[move.object_id] for move in leaf.moves]
            try:
                return self._with_stops(program, instruction_id, stops, compass, fit, lengths, members, look)
            except Rejected as rejected:
                refused = refused or rejected
        assert refused is not None
        raise refused

    def _lead_ends(self, programs: Sequence[Program]) -> list[dict[int, int]]:
        """Return several choices of where the leads of programs with equal leads end: for each branch with a lead, the
        number of a target from which its condition can be decided, and that is not near the goal of any leaf.

        Raises
        ------
        Rejected : a lead has no such place
        """
        goals = np.concatenate([self.field.goals[leaf.goal.object_id] for leaf in programs[0].leaves])
        allowed: dict[int, list[int]] = {}
        for at, branch in enumerate(programs[0].branches):
            if branch.lead is None:
                continue
            assert self.leads is not None, "a program has leads, but where they may end is not known"
            room_id = branch.lead.room_id
            away = np.linalg.norm(self.leads.points(room_id)[:, None] - goals, axis=2).min(axis=1)
            shown = [self.leads.showing(program.conditions[branch.condition]) for program in programs]
            fit = np.all(shown, axis=0) & (away > self.tau + LEAD_MARGIN)
            if not fit.any():
                raise Rejected("lead_unseen", final=True)
            allowed[at] = (self._targets[1][room_id] + np.flatnonzero(fit)).tolist()
        tries = [[fit[k * len(fit) // LEAD_TRIES] for fit in allowed.values()] for k in range(LEAD_TRIES)]
        return [dict(zip(allowed, ends, strict=True)) for ends in dict.fromkeys(map(tuple, tries))]

    def _with_stops(
        self,
        program: Program,
        instruction_id: str,
        stops: Sequence[Sequence[int]],
        compass: bool,
        fit: Fit | None,
        lengths: tuple[float, float] | None,
        members: Sequence[Program] | None,
        look: Callable[[Routes], None] | None,
    ) -> Placement:
        """Do what `place` does, with the targets of each leaf's stops."""
        leads = [len(its) - len(leaf.moves) for its, leaf in zip(stops, program.leaves, strict=True)]
        leaves = Leaves(stops, leads)
        possible = self._from_starts.possible(
            leaves, self._bounds if lengths is None else self._bounds._replace(least=lengths[0], most=lengths[1])
        )
        if isinstance(possible, str):
            raise Rejected(possible)
        first = program.branches[0].lead
        if first is not None and self.leads is not None:
            possible = possible[~self.leads.holds(first.room_id, self.starts[possible])]
            if not len(possible):
                raise Rejected("no_start_in_range")
        draws = FewDraws(self.seed, self.scene.scene_id, "place", instruction_id)
        facing = self._facing(members or (program,), draws)
        if facing is not None:
            possible = possible[facing.possible[possible]]
            if not len(possible):
                raise Rejected("no_heading")
        order = possible[draws.uniforms(len(possible)).argsort(kind="stable")[: self.rules.starts_per_program]]
        yaws = self._yaws(draws, order, facing, compass=compass)
        refused = np.zeros(len(REFUSALS), np.int64)
        failures: Counter[str] = Counter()
        at = looked = 0
        while at < len(order):
            found = self._from_starts.first_fit(leaves, order[at:], self.tau, lengths, refused)
            if found is None:
                break
            at += found.refused
            try:
                return self._placed(program, int(order[at]), yaws[at], found.leaves, fit, look)
            except Rejected as rejected:
                failures[rejected.reason] += 1
                looked += rejected.reason in LOOKING
                if rejected.final or looked == LOOKS:
                    raise
            at += 1
        failures.update({reason: count for reason, count in zip(REFUSALS, refused.tolist(), strict=True) if count})
        for reason in (NOT_FIT, ROUTE_MISSED):
            if reason in failures:
                raise Rejected(reason)
        raise Rejected(max(sorted(failures), key=lambda reason: failures[reason]))

    def _yaws(
        self, draws: FewDraws, order: NDArray[np.int64], facing: Headings | None, *, compass: bool
    ) -> list[float]:
        """Return the yaw in radians for each start of `order`."""
        if facing is None:
            drawn: list[float] = ((2.0 * draws.uniforms(len(order)) - 1.0) * math.pi).tolist()
            return [round(yaw / COMPASS_STEP) * COMPASS_STEP for yaw in drawn] if compass else drawn
        return [math.radians(-float(draws.choice(facing.headings[facing.fit[k]]))) for k in order]

    def _facing(self, programs: Sequence[Program], draws: FewDraws) -> Headings | None:
        """Return the start poses that the egocentric statements of `programs` allow; None if there are no such
        statements.
        """
        if all(program.start_room is None for program in programs):
            return None
        return self._facings.headings(programs, draws.uniform() * 360.0 / HEADINGS)

    @cached_property
    def _facings(self) -> Facings:
        return Facings(self.scene, self.starts, self.thresholds, self.sightings)

    @cached_property
    def _bounds(self) -> Bounds:
        """The bounds of programs whose routes may have any length."""
        low, high = self.rules.range(self.scene.single_room)
        # In a single room no route is a detour.
        factor = math.inf if self.scene.single_room else self.rules.detour_factor
        return Bounds(2 * self.tau, low, high, factor, self.rules.detour_slack, *ANY_LENGTH)

    def _placed(
        self,
        program: Program,
        at: int,
        yaw: float,
        leaves: Sequence[FoundLeaf],
        fit: Fit | None,
        look: Callable[[Routes], None] | None,
    ) -> Placement:
        """Return the placement at start number `at`, whose `leaves` meet the rules.

        Raises
        ------
        Rejected : the start's view does not fit, or a walk does not arrive
        """
        start = self.starts[at]
        if fit is not None:
            fitting = fit(Outlook(start, yaw, tuple(found.route.path for found in leaves)))
            if fitting is None:
                raise Rejected(NOT_FIT)
            yaw = fitting
        objects = tuple([program.stops(leaf) for leaf in range(len(program.leaves))])
        if look is not None:
            look(Routes(start, yaw, objects, tuple(leaves), self.tau))
        walks = [self._follower.follow(start, yaw, found.route.stops) for found in leaves]
        for walk in walks:
            if walk.outcome == "too long":
                raise Rejected("over_step_budget")
            if not walk.arrived:
                raise Rejected("follower_stuck")
        placed = [
            PlacedLeaf(names, goals, route, distance, walk)
            for names, (route, distance, goals), walk in zip(objects, leaves, walks, strict=True)
        ]
        return Placement(start, yaw, tuple(placed), self.tau)
