"""Looking paths: the walk to a leaf of an agent that sees the evidence of each condition before it acts on it.

The plan is a shortest path over places of the floor from which the evidence is recognised: the conditions of the leaf's
route in the order in which they are evaluated, each one after its lead, then its moves. The agent walks it with the
ground-truth actions and a level camera: it stops at the first place from which a turn decides the next condition,
turns, and goes on from there.
So what it sees on the way counts, and no place is nearer to the evidence than it must be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise, permutations
from operator import itemgetter
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.arrays import F64, Bools
from condvln.episodes.floor import standing_points
from condvln.episodes.goals import wide_islands
from condvln.episodes.observability import Observer, SightNeed, row_by_row
from condvln.episodes.placing import Rejected, Routes, yaw_quaternion
from condvln.episodes.starts import FoundLeaf
from condvln.episodes.view import SceneView
from condvln.kept import kept
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, VLN_CE, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import EDGE, Recognition, View, eyes_at, in_view, visible_extent
from condvln.scene import Scene, round_mm
from schemas.config import EpisodeConfig, PlacesConfig
from schemas.config.constants import EYE_SPACING, LEVEL_CAMERA
from schemas.program import Program

__all__ = ["LookingPath", "LookingPaths"]


SPACING: Final = 0.75
"""Metres between the places from which the plan looks; the walk looks from where it first can on the way to them."""
_MOST_PLACES: Final = 8
"""Largest number of places from which a plan looks at one floor."""
_AT_ONCE: Final = 6
"""Number of objects that may be seen in any order: the time doubles with each."""
_NEAR: Final = 0.1
"""Metres from a place at which the walk counts as there."""
_ARRIVED: Final = 0.5
"""Metres from the goal at which a walk may end, as the ground-truth follower."""
_ASTRAY: Final = 0.25
"""Metres up to which a walk may leave its path."""
_TURN: Final = math.radians(VLN_CE.turn)
_SPARE: Final = 1.5
"""The step budget must be at least this many times the actions of a looking walk."""

_TRIES: Final = 4
"""Number of plans that are tried for one routes."""
START: Final = -1
"""The start, among the numbers of places."""

Ways: TypeAlias = Sequence[frozenset[SightNeed]]
_Stop: TypeAlias = tuple[int, int]
"""A condition, and the place from which the plan looks for its evidence."""
_Plan: TypeAlias = tuple[float, tuple[_Stop, ...]]
_Sides: TypeAlias = tuple[frozenset[int], frozenset[int]]
"""The leaves of the branch that is taken, and those of the other one."""


@dataclass(frozen=True, eq=False, slots=True)
class LookingPath:
    """The looking walk of a leaf; its columns in the table ``episodes`` have these names.

    path : (n, 3) corners rounded to 1 mm; length in metres
    actions : (a,) of the walk with its turns; the last one is STOP
    decided : of each condition of the leaf's route, the number of actions after which it is decided
    locations : (f + 1, 3) the start and the position after each forward step, rounded to 1 mm
    """

    path: F64
    length: float
    actions: NDArray[np.int8]
    decided: tuple[int, ...]
    locations: F64


@dataclass(frozen=True, eq=False, slots=True)
class _Plans:
    """The best plan that ends at each of n places: its length, infinite without a plan, and where it looks."""

    cost: F64
    stops: list[tuple[_Stop, ...]]

    def best_of(self, other: _Plans) -> _Plans:
        """Return the shorter plan to each place."""
        better = other.cost < self.cost
        stops = [two if more else one for one, two, more in zip(self.stops, other.stops, better, strict=True)]
        return _Plans(np.minimum(self.cost, other.cost), stops)

    def onward(self, metres: F64, number: int, into: Bools) -> _Plans:
        """Return the plans that go on to the places in `into` (n,) and look there for condition `number`. `metres`
        (n, n) are the distances between places.
        """
        total = self.cost[:, None] + metres
        last = total.argmin(axis=0)
        cost = np.where(into, total[last, np.arange(len(last))], np.inf)
        stops: list[tuple[_Stop, ...]] = [()] * len(cost)
        for k in np.flatnonzero(np.isfinite(cost)).tolist():
            stops[k] = (*self.stops[last[k]], (number, k))
        return _Plans(cost, stops)

    def moved(self, metres: F64, to: Bools) -> _Plans:
        """Return the best plan that goes on to the one place in `to` (n,) and need not look there."""
        total = self.cost + metres[:, to.argmax()]
        last = int(total.argmin())
        return _Plans(np.where(to, total[last], np.inf), [self.stops[last]] * len(to))

    def only(self, places: Bools, number: int | None = None) -> _Plans:
        """Return the plans that end at these places (n,); with a `number`, they also look there for that condition."""
        cost, stops = np.where(places, self.cost, np.inf), self.stops
        if number is not None:
            stops = [(*stops[k], (number, k)) for k in range(len(stops))]
        return _Plans(cost, stops)


class _Legs(NamedTuple):
    """The ways from a start to the p places of a scene.

    metres : (p,), infinite without a way; points : (m, 3) on all ways, but not within SPACING of their ends, since a
    walk often sees there what it goes for; leg : (m,) the place to which the way of each point leads
    """

    metres: F64
    points: F64
    leg: NDArray[np.int64]


class LookingPaths:
    """Finds the looking paths of placed programs of one scene. Distances and views from its places are computed once.

    observer : says what the evidence of a condition is
    """

    def __init__(
        self,
        scene: Scene,
        view: SceneView,
        pathfinder: Pathfinder,
        places: PlacesConfig,
        rules: EpisodeConfig,
        observer: Observer,
    ) -> None:
        self._scene, self.pathfinder, self.observer = scene, pathfinder, observer
        self._places, self.rules, self.view, self.eye_height = places, rules, view, places.eye_height
        self.camera = View(places.sight_range, *LEVEL_CAMERA)
        self.rule = Recognition.of(places, rules)
        self.towards_place = Follower(pathfinder, stop_within=_NEAR, max_actions=rules.step_ceiling)
        self.to_goal = Follower(pathfinder, max_actions=rules.step_ceiling)
        self._enough: dict[SightNeed, Bools] = {}
        self._to_object: dict[str, F64] = {}
        self._starts: dict[bytes, _Legs] = {}
        self._sights: dict[tuple[SightNeed, bytes], Bools] = {}
        self._rows: dict[SightNeed, dict[bytes, Bools]] = {}

    def path(self, program: Program, routes: Routes, leaf: int) -> LookingPath:
        """Return the looking path of a leaf, after the plans of all leaves were checked as if they were gold.

        Raises
        ------
        Rejected : a leaf has no plan, its plan is too long, or the walk of this one does not see the evidence in time
        """
        if not self._possible(program, routes):
            raise Rejected("looking_unseen", final=True)
        self._rows.clear()  # the walks of one placement have many places in common
        without: set[int] = set()
        for _ in range(_TRIES):
            planned = self._planned(program, routes, without, leaf)
            for one, (length, _) in zip(routes.leaves, planned, strict=True):
                if not math.isfinite(length):
                    raise Rejected("looking_unseen")
                if length > self.rules.looking_detour.most(one.route.length):
                    raise Rejected("looking_detour")
                if _SPARE * length / VLN_CE.forward > self.rules.step_ceiling:
                    raise Rejected("looking_budget")
            found = self._walked(program, routes, leaf, planned[leaf][1])
            if isinstance(found, LookingPath):
                return found
            without.add(found)
        raise Rejected("looking_unseen")

    @cached_property
    def places(self) -> F64:
        """The places (p, 3) from which plans look: positions in all rooms at which one can stand, SPACING apart."""
        islands, obstacles = wide_islands(self.pathfinder, self._places), self.observer.obstacles
        found = [standing_points(self._scene, room, self.pathfinder, islands, obstacles) for room in self._scene.rooms]
        points = np.concatenate([np.empty((0, 3)), *found])
        cells = np.floor(points / SPACING)
        return points[np.sort(np.unique(cells, axis=0, return_index=True)[1])]

    @cached_property
    def _between(self) -> F64:
        return self._metres(self.places, self.places)

    def _metres(self, starts: F64, ends: F64) -> F64:
        table = np.asarray(self.pathfinder.distance_table(starts, ends), np.float64)
        return np.where(np.isfinite(table), table, np.inf)

    def seen(self, need: SightNeed, eyes: F64) -> Bools:
        """Return a mask (n, k): which samples of a piece of evidence a level camera at each of the eyes (n, 3) sees as
        it turns round; none of an object that it would not recognise.
        """
        target = self.observer.target(need)
        if target is None:
            return np.zeros((len(eyes), 1), bool)
        if need[0] == "floor":
            return self.view.seen(eyes, target, View(max(need[2], EDGE), pitch=self.rule.view.pitch))
        found = np.zeros((len(eyes), len(target.samples)), bool)
        near = in_view(eyes, target.samples, self.rule.view)
        able = np.flatnonzero(self.rule.holds(near, visible_extent(eyes, target.samples, near)))
        if len(able):
            seen = self.view.seen(eyes[able], target, self.rule.view)
            found[able] = seen & self.recognised(need, eyes[able], seen)[:, None]
        return found

    def seen_at(self, need: SightNeed, places: F64) -> Bools:
        """Return what `seen` does, from places (n, 3) on the floor; what was asked before of these routes is kept."""
        known = self._rows.setdefault(need, {})
        rows = row_by_row(known, places, lambda new: self.seen(need, eyes_at(new, self.eye_height)))
        target = self.observer.target(need)
        samples = 1 if target is None else len(target.samples)
        return np.array(rows, bool).reshape(len(places), samples)

    def recognised(self, need: SightNeed, eyes: F64, seen: Bools) -> Bools:
        """Return a mask (n,) of the eyes (n, 3) that recognise an object by the samples that each one sees (n, k)."""
        target = self.observer.target(need)
        assert target is not None, "an object is known"
        return np.asarray(self.rule.holds(seen, visible_extent(eyes, target.samples, seen)))

    def middle(self, object_id: str) -> F64:
        """Return the middle (3,) of an object, which a walk faces at its end."""
        return self._scene.object_of[object_id].center

    def _possible(self, program: Program, routes: Routes) -> bool:
        """Return whether each condition can be decided by places that are not near stops of the branch then taken,
        wherever one starts.
        """
        for branch in program.branches:
            sides = _below(program, branch.then), _below(program, branch.otherwise)
            ways = self.observer.needs(program.conditions[branch.condition])
            for taken, other in (sides, sides[::-1]):
                far = ~_near(self.places, routes, taken, other)
                if not any(all(self._is_shown(need, far) for need in way) for way in ways):
                    return False
        return True

    def _is_shown(self, need: SightNeed, by: Bools) -> bool:
        """Return whether the places in the mask `by` together show a piece of evidence."""
        seen = self._from_places(need)[by]
        return bool(seen.any() if need[0] == "object" else seen.any(axis=0).mean() >= self.rules.floor_seen)

    def views(
        self, ways: Ways, places: F64, headings: NDArray[Any] | None, known: Mapping[SightNeed, Bools] | None = None
    ) -> dict[SightNeed, Bools]:
        """Return, for each piece of evidence of the `ways`, what was seen of it up to each of n frames: whether an
        object was recognised (n, 1), which points of a floor were seen (n, k).

        headings : (n,) radians; None looks all round
        known : what was seen before
        """
        known, found = known or {}, {}
        eyes = eyes_at(places, self.eye_height)
        for need in {need for way in ways for need in way}:
            target, before = self.observer.target(need), known.get(need)
            if target is None or (before is not None and len(before) == 1 and before[0]):
                found[need] = np.full((len(places), 1), target is not None)
                continue
            ahead = self.seen_at(need, places)
            some = np.flatnonzero(ahead.any(axis=1))
            if headings is not None:
                ahead[some] &= in_view(eyes[some], target.samples, self.camera, headings[some])
            if need[0] == "object":
                held = np.zeros((len(places), 1), bool)
                held[some, 0] = self.recognised(need, eyes[some], ahead[some])
                ahead = held
            if before is not None:
                ahead[0] |= before
            found[need] = np.logical_or.accumulate(ahead, axis=0)
        return found

    def decides(self, ways: Ways, views: Mapping[SightNeed, Bools]) -> Bools:
        """Return a mask (n,) of the frames by which a condition is decided by one of its `ways`, see `views`."""
        least = self.rules.floor_seen
        enough = {
            need: seen[:, 0] if need[0] == "object" else seen.mean(axis=1) >= least for need, seen in views.items()
        }
        return np.asarray(np.any([np.all([enough[need] for need in way], axis=0) for way in ways], axis=0))

    def decided(self, program: Program, places: F64, headings: F64 | None) -> list[int | None]:
        """Return, for each condition on the gold route in order of evaluation, the first of n poses of a walk by which
        the evidence seen so far decides it; None if none does.

        places : (n, 3) of the feet, metres; headings : (n,) radians, None looks all round
        """
        self._rows.clear()
        found: list[int | None] = []
        for number in dict.fromkeys(program.route()[0]):
            ways = self.observer.needs(program.conditions[number])
            by = np.flatnonzero(self.decides(ways, self.views(ways, places, headings)))
            found.append(int(by[0]) if len(by) else None)
        return found

    def _planned(self, program: Program, routes: Routes, without: Set[int], gold: int) -> list[_Plan]:
        """Return the plan of each leaf: its length, infinite without one, and where it looks; not from the places in
        `without`, which show less than they seemed to. For the leaf `gold`, all orders of its conditions are tried.
        """
        ways = [self.observer.needs(condition) for condition in program.conditions]
        needs = {need for one in ways for way in one for need in way}
        eye = eyes_at(routes.start, self.eye_height)
        for need in needs:
            if (need, eye.tobytes()) not in self._sights:
                self._sights[need, eye.tobytes()] = self._sight(need, eye)
        from_start = {need: self._sights[need, eye.tobytes()] & (START not in without) for need in needs}
        used = np.zeros(len(self.places), bool)
        for need in needs:
            used |= self._from_places(need).reshape(len(self.places), -1).any(axis=1)
        away, on_legs, leg = self._from_start(routes.start)
        used &= np.isfinite(away)
        ends = self._lead_ends(program, routes)
        used[[*{place for its in ends for place in its.values()}]] = True
        at = np.flatnonzero(used)
        shows = ~np.isin(at, [*without])
        from_places = {need: (self._from_places(need)[at].T & shows).T for need in needs}
        sights = {need: np.concatenate([from_start[need], from_places[need]]) for need in needs}
        pairs = {need: self._pairs(need, at, sights[need]) for need in needs if need[0] == "floor"}
        metres = np.zeros((len(at) + 1, len(at) + 1))
        metres[1:, 1:] = self._between[np.ix_(at, at)]
        metres[0, 1:] = metres[1:, 0] = away[at]
        points = np.concatenate([routes.start[None], self.places[at]])
        on_legs, leg = on_legs[used[leg]], leg[used[leg]]
        at = np.concatenate([[START], at])
        cost = np.full(len(points), np.inf)
        cost[0] = 0.0

        @cache
        def early(sides: _Sides) -> Bools:
            """Return which places (2, n) are near a stop to which a decision leads, and to which the way from the start
            passes one.
            """
            return np.array([_near(points, routes, *sides), np.isin(at, leg[_near(on_legs, routes, *sides)])])

        def plan(number: int, order: Sequence[int]) -> _Plan:
            """Return the best plan to a leaf that decides the conditions on its route in an order."""
            leaf, plans = routes.leaves[number], _Plans(cost, [()] * len(points))
            for k, condition in enumerate(order):
                near: Bools = np.any([early(asked[number][one]) for one in order[k:]], axis=0)
                open_to = np.where(near[0], np.inf, metres)
                open_to[0, near[1]] = np.inf
                if condition in ends[number]:
                    plans = plans.moved(open_to, at == ends[number][condition])
                plans = self._decided(plans.only(~near[0]), condition, ways[condition], sights, pairs, open_to)
            total = plans.cost + self._onward(points, at, leaf, len(ends[number]), routes.objects[number][-1])
            best = int(total.argmin())
            return float(total[best]), tuple((condition, int(at[k])) for condition, k in plans.stops[best])

        asked = _asked(program)
        found = [plan(number, [*conditions]) for number, conditions in enumerate(asked)]
        # Evidence may lie on the way to that of a condition that is asked before.
        if not ends[gold] and found[gold][0] > routes.leaves[gold].route.length + _NEAR:
            found[gold] = min((plan(gold, order) for order in permutations(asked[gold])), key=itemgetter(0))
        return found

    def _lead_ends(self, program: Program, routes: Routes) -> list[dict[int, int]]:
        """Return for each leaf the places at which the leads on the way to it end, by the conditions that follow."""
        return [
            {
                program.branches[branch].condition: int(np.abs(self.places - stop).sum(axis=1).argmin())
                for branch, stop in zip(program.led_branches(leaf), found.route.stops, strict=False)
            }
            for leaf, found in enumerate(routes.leaves)
        ]

    @kept
    def _from_places(self, need: SightNeed) -> Bools:
        return self._sight(need, eyes_at(self.places, self.eye_height))

    def _sight(self, need: SightNeed, eyes: F64) -> Bools:
        """Return whether each eye recognises an object, (n,), or which points of a floor it sees, (n, k)."""
        seen = self.seen(need, eyes)
        return np.asarray(seen.any(axis=1)) if need[0] == "object" else seen

    def _from_start(self, start: F64) -> _Legs:
        """Return the ways from a start to all places."""
        key = start.tobytes()
        if key not in self._starts:
            lengths, counts, corners = self.pathfinder.path_corners(start, self.places)
            leg = np.repeat(np.arange(len(counts)), counts)
            begin = np.flatnonzero(leg[1:] == leg[:-1])
            ahead = np.diff(corners.astype(np.float64), axis=0)[begin]
            metres = np.linalg.norm(ahead, axis=1)
            walked = np.cumsum(metres) - metres
            before = walked[np.searchsorted(leg[begin], leg[begin])]  # of the legs before this one
            count = np.ceil(metres / EYE_SPACING).astype(np.int64)
            one = np.repeat(np.arange(len(begin)), count)
            share = (np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count)) / count[one]
            left = lengths[leg[begin[one]]] - (walked - before)[one] - share * metres[one]
            inner = left > SPACING
            points = corners[begin[one]] + share[:, None] * ahead[one]
            reach = np.where(np.isfinite(lengths), lengths, np.inf).astype(np.float64)
            self._starts[key] = _Legs(reach, points[inner], leg[begin[one]][inner])
        return self._starts[key]

    def _onward(self, points: F64, at: NDArray[np.intp], leaf: FoundLeaf, leads: int, goal: str) -> F64:
        """Return the metres from the places numbered `at` (n,), the start first, which are the `points` (n, 3),
        through a leaf's stops after its leads to its goal.
        """
        stops = leaf.route.stops[leads:]
        if len(stops) > 1:
            first = self._metres(points, stops[:1])[:, 0]
            legs = pairwise([points[0], *leaf.route.stops[: leads + 1]])
            passed = sum(self.pathfinder.geodesic_distance(*leg) for leg in legs) if leads else first[0]
            return np.asarray(first + (leaf.route.length - passed))
        if goal not in self._to_object:
            self._to_object[goal] = self._metres(self.places, leaf.goals).min(axis=1)
        return np.concatenate([[leaf.distance], self._to_object[goal][at[1:]]])

    def _decided(
        self,
        plans: _Plans,
        number: int,
        ways: Ways,
        sights: Mapping[SightNeed, Bools],
        pairs: Mapping[SightNeed, Bools],
        metres: F64,
    ) -> _Plans:
        """Return the best plans on which condition `number` is decided after these `plans`, by one of its `ways`.
        `pairs` (n, n) : of each floor, from which two places together enough of it is seen
        """
        found = _Plans(np.full(len(plans.cost), np.inf), plans.stops)
        for way in ways:
            if all(need[0] == "object" for need in way):
                sees = np.array([sights[need] for need in sorted(way)])
                if sees[:, 0].all():
                    return plans
                one = self._objects_seen(plans, number, sees, metres)
            else:
                (floor,) = way
                if sights[floor][0].mean() >= self.rules.floor_seen:
                    return plans
                one = self._floor_seen(plans, number, sights[floor], metres, pairs[floor])
            found = found.best_of(one)
        return found

    @classmethod
    def _objects_seen(cls, plans: _Plans, number: int, sees: Bools, metres: F64) -> _Plans:
        """Return the best plans on which all of k objects are recognised after these `plans`: of many objects, the
        first ones before the others. `sees` (k, n) says from which places each one is.
        """
        if len(sees) > _AT_ONCE:
            first = cls._objects_seen(plans, number, sees[:_AT_ONCE], metres)
            return cls._objects_seen(first, number, sees[_AT_ONCE:], metres)
        bits = (sees * (1 << np.arange(len(sees)))[:, None]).sum(axis=0)
        whole = (1 << len(sees)) - 1
        open_to = {int(b): plans.only(bits == b, number if b else None) for b in np.unique(bits)}
        # What is seen only grows, and a larger set is a larger number.
        for seen in range(whole):
            if seen in open_to and np.isfinite(open_to[seen].cost).any():
                reached = open_to[seen].onward(metres, number, (bits & ~seen) > 0)
                for more in np.unique(bits | seen):
                    if more != seen:
                        part = reached.only((bits | seen) == more)
                        open_to[more] = open_to[more].best_of(part) if more in open_to else part
        return open_to.get(whole) or plans.only(np.zeros(len(bits), bool))

    def _pairs(self, floor: SightNeed, at: NDArray[np.intp], sees: Bools) -> Bools:
        """Return from which two of the start and the places numbered `at` (n - 1,) enough of a floor is seen, (n, n).
        `sees` (n, k) says which of its points each of them sees.
        """
        least = self.rules.floor_seen * sees.shape[1]
        if floor not in self._enough:
            each = self._from_places(floor).astype(np.float32)
            one = each.sum(axis=1)
            self._enough[floor] = one[:, None] + one - each @ each.T >= least
        found = np.empty((len(sees), len(sees)), bool)
        found[1:, 1:] = self._enough[floor][np.ix_(at, at)]
        found[0] = found[:, 0] = (sees | sees[0]).sum(axis=1) >= least
        return found

    def _floor_seen(self, plans: _Plans, number: int, sees: Bools, metres: F64, enough: Bools) -> _Plans:
        """Return the best plans found on which enough of a floor is seen after these `plans`: from one or two places,
        after others that show the most new floor for the way, where two are too few. `sees` (n, k) says which of its
        points each place sees, and `enough` (n, n) from which two of them enough is seen.
        """
        known, least = np.zeros(sees.shape[1], bool), self.rules.floor_seen * sees.shape[1]
        within = np.isfinite(metres[0])
        for _ in range(_MOST_PLACES if (sees[within].any(axis=0).sum() >= least) else 0):
            more = (sees & ~known).sum(axis=1)
            first = plans.onward(metres, number, more > 0)
            found = plans.onward(metres, number, known.sum() + more >= least)
            if not known.any() and enough.any():
                found = found.best_of(first.onward(np.where(enough, metres, np.inf), number, more > 0))
            worth = more / (1.0 + first.cost)
            if np.isfinite(found.cost).any() or not worth.max() > 0.0:
                return found
            best = int(worth.argmax())
            plans, known = first.only(np.arange(len(more)) == best), known | sees[best]
        return plans.only(np.zeros(len(sees), bool))

    def _walked(self, program: Program, routes: Routes, number: int, stops: Sequence[_Stop]) -> LookingPath | int:
        """Return the walk of a leaf's plan, or the place of the plan that does not show what it seemed to.

        Raises
        ------
        Rejected : it passes a stop before a decision that leads there, or is too long
        """
        leaf = routes.leaves[number]
        asked = _asked(program)[number]
        walk = _Walk(self, routes, {k: self.observer.needs(program.conditions[k]) for k in asked})
        leads = [program.branches[branch].condition for branch in program.led_branches(number)]
        order = dict.fromkeys(asked if leads else [*(one for one, _ in stops), *asked])
        for k in order:
            if k in leads:
                walk.visit(leaf.route.stops[leads.index(k)])
            places = [place for one, place in stops if one == k]
            if not walk.decides(k, places):
                return places[-1] if places else START
        if walk.acts_early(asked):
            raise Rejected("looking_unseen")
        ends = leaf.route.stops[len(leads) :]
        if len(ends) == 1 and len(walk.corners) > 1:
            ends = leaf.goals[[int(self._metres(walk.place[None], leaf.goals).argmin())]]
        walk.finish(ends, routes.objects[number][-1])
        # The walk takes no other way than the route, which is as short as another at times.
        is_direct = len(walk.corners) == 1 + len(ends)
        path, length = (leaf.route.path, leaf.route.length) if is_direct else self._path(np.array(walk.corners))
        if length > self.rules.looking_detour.most(leaf.route.length):
            raise Rejected("looking_detour")
        if _SPARE * len(walk.actions) > self.rules.step_ceiling:
            raise Rejected("looking_budget")
        decided = tuple(walk.decided[k] for k in asked)
        return LookingPath(path, length, np.array(walk.actions, np.int8), decided, round_mm(walk.locations))

    def _path(self, corners: F64) -> tuple[F64, float]:
        """Return the shortest path (n, 3) through the corners of a walk, and its length in metres."""
        ways = self.pathfinder.find_paths(corners[:-1], corners[1:])
        inner = [np.asarray(way.points[1:], np.float64) for way in ways]
        return round_mm(np.concatenate([corners[:1], *inner])), float(sum(way.geodesic_distance for way in ways))


def _below(program: Program, target: int) -> frozenset[int]:
    """Return the leaves below a branch's target."""
    if target < 0:
        return frozenset((-1 - target,))
    branch = program.branches[target]
    return _below(program, branch.then) | _below(program, branch.otherwise)


def _near(points: F64, routes: Routes, taken: frozenset[int], other: frozenset[int]) -> Bools:
    """Return a mask (n,) of the points (n, 3) that are within the success distance of a stop that only the `taken`
    leaves have, and not the `other` ones: who is there has chosen between them.
    """
    shared = {name for leaf in other for name in routes.objects[leaf]}
    found = np.zeros(len(points), bool)
    for number in sorted(taken):
        leaf = routes.leaves[number]
        for name, stops in zip(routes.objects[number], [*leaf.route.stops[:-1, None], leaf.goals], strict=True):
            if name not in shared:
                away = np.hypot(*(points[:, None, [0, 2]] - stops[:, [0, 2]]).transpose(2, 0, 1))
                found |= (away <= routes.success_distance).any(axis=1)
    return found


def _asked(program: Program) -> list[dict[int, _Sides]]:
    """Return for each leaf the conditions on its route, in order of evaluation, each with the leaves of the branch that
    leads to the leaf, and those of the other branch.
    """
    found: list[dict[int, _Sides]] = [{} for _ in program.leaves]

    for branch in program.branches:  # a branch comes before those below it
        sides = _below(program, branch.then), _below(program, branch.otherwise)
        for taken, other in (sides, sides[::-1]):
            for leaf in taken:
                found[leaf][branch.condition] = taken, other
    return found


class _Walk:
    """A walk so far.

    Attributes
    ----------
    actions : those so far, without STOP
    corners : the start and the places at which the plan changed, (3,) each
    decided : the frame at which each condition is decided
    """

    def __init__(self, looking: LookingPaths, routes: Routes, ways: Mapping[int, Ways]) -> None:
        self._looking, self._routes, self._ways = looking, routes, ways
        _, y, _, w = yaw_quaternion(routes.yaw)
        # As readers of the published rotation compute it.
        self._first = 2.0 * math.atan2(y, w) % (2.0 * math.pi)
        self._known: dict[SightNeed, Bools] = {}
        self.actions: list[int] = []
        self.decided: dict[int, int] = {}
        self._replay()
        self.corners = [self.place]
        self._notice(0)
        for number in ways:  # what the plan needs not walk for
            if number not in self.decided:
                self._turns(number)

    @property
    def locations(self) -> F64:
        """The start and the position (f + 1, 3) after each forward step."""
        taken = np.array(self.actions[: len(self._positions) - 1])
        return np.asarray(self._positions[np.append(True, taken == FORWARD)], np.float64)

    def decides(self, number: int, places: Sequence[int]) -> bool:
        """Walk and turn until condition `number` is decided, at the latest from the `places` of the plan; return
        whether it is.
        """
        if number in self.decided or self._turns(number):
            return True
        for place in places:
            while place != START and self._goes(self._looking.places[place], number):
                if number in self.decided or self._turns(number):
                    return True
            self._turns(number, wholly=False)
            if number in self.decided:
                return True
        return False

    def visit(self, place: F64) -> None:
        """Walk to a place, which becomes a corner of the path.

        Raises
        ------
        Rejected : the follower does not reach it
        """
        leg = self._looking.towards_place.follow(self.place, self.heading, place)
        if not leg.arrived:
            raise Rejected("follower_stuck")
        frames = len(self.actions)
        self.actions += leg.actions[:-1].tolist()
        self._replay()
        self._notice(frames + 1)
        self._keep(np.concatenate([self._positions[frames:], place[None]]))

    def _goes(self, place: F64, number: int) -> bool:
        """Walk towards a place, until condition `number` is decided or a turn may decide it; return False if the agent
        is there already.
        """
        leg = self._looking.towards_place.follow(self.place, self.heading, place)
        ahead = leg.actions[:-1]
        if not leg.arrived or not len(ahead):
            return False
        walk = self._looking.to_goal.walk(self.place, self.heading, ahead)
        places = walk.positions.astype(np.float64)
        moved = np.flatnonzero(ahead == FORWARD) + 1
        able = moved[self._could_decide(number, places[moved])]
        known = np.flatnonzero(self._decides_by(number, self._views(number, places, walk.headings)))
        self._take(ahead[: min([len(ahead), *able[:1].tolist(), *known[:1].tolist()])])
        return True

    def _turns(self, number: int, *, wholly: bool = True) -> bool:
        """Turn by the shorter way until condition `number` is decided. If that can't be, do nothing and return False;
        or, if not `wholly`, turn until there is nothing new to see for it.
        """
        here = self.place[None]
        if wholly and not self._could_decide(number, here)[0]:
            return False
        turns = np.arange(VLN_CE.headings)
        found = []
        for action, sign in ((LEFT, 1), (RIGHT, -1)):
            views = self._views(number, np.repeat(here, len(turns), axis=0), self.heading + sign * _TURN * turns)
            enough = np.flatnonzero(self._decides_by(number, views))
            if len(enough):
                found.append((int(enough[0]), action))
            elif not wholly:
                same = [(view == view[-1]).all(axis=1) for view in views.values()]
                found.append((int(np.all(same, axis=0).argmax()), action))
        if found:
            count, action = min(found)
            self._take([action] * count)
        return bool(found)

    def _take(self, actions: Sequence[int] | NDArray[np.int8]) -> None:
        """Take actions, look at each frame, and keep the place at the end as one at which the plan changes."""
        frames = len(self.actions) + 1
        self.actions += map(int, actions)
        self._replay()
        self._notice(frames)
        self._keep(self._positions[frames - 1 :])

    def _keep(self, places: F64) -> None:
        """Keep the last of the places (n, 3) of a leg as a corner, and more of them where the shortest way there is
        another way.
        """
        way = np.asarray(self._looking.pathfinder.find_path(self.corners[-1], places[-1]).points, np.float64)
        on_ground = shapely.linestrings(way[[0, *range(len(way))], ::2])  # of two points at least
        away = shapely.distance(shapely.points(places[:, ::2]), on_ground)
        far = int(away.argmax())
        if away[far] > _ASTRAY and 0 < far < len(places) - 1:
            self._keep(places[: far + 1])
            self._keep(places[far:])
        elif (places[-1] != self.corners[-1]).any():
            self.corners.append(places[-1])

    def _replay(self) -> None:
        """Compute the poses by executing all actions from the start, as every reader of the walk does."""
        walk = self._looking.to_goal.walk(self._routes.start, self._first, self.actions)
        self._positions, self._headings = walk.positions.astype(np.float64), walk.headings
        self.place, self.heading = self._positions[-1], float(self._headings[-1])

    def _notice(self, begin: int) -> None:
        """Keep what is seen at the frames from `begin` on, and which conditions are decided by that."""
        if begin == len(self._positions):
            return
        places, headings = self._positions[begin:], self._headings[begin:]
        views: dict[SightNeed, Bools] = {}
        for number in self._ways.keys() - self.decided.keys():
            views |= self._views(number, places, headings)
        for number in self._ways.keys() - self.decided.keys():
            by = np.flatnonzero(self._decides_by(number, views))
            if len(by):
                self.decided[number] = begin + int(by[0])
        self._known |= {need: view[-1] for need, view in views.items()}

    def _views(self, number: int, places: F64, headings: NDArray[Any]) -> dict[SightNeed, Bools]:
        return self._looking.views(self._ways[number], places, headings, self._known)

    def _decides_by(self, number: int, views: Mapping[SightNeed, Bools]) -> Bools:
        return self._looking.decides(self._ways[number], views)

    def _could_decide(self, number: int, places: F64) -> Bools:
        """Return a mask (n,) of the places from which a full turn would decide condition `number`, or nearly so."""
        all_round = {}
        for need in {need for way in self._ways[number] for need in way}:
            seen = self._looking.seen_at(need, places)
            seen = np.asarray(seen.any(axis=1, keepdims=True)) if need[0] == "object" else seen
            all_round[need] = seen | self._known[need] if need in self._known else seen
        return self._decides_by(number, all_round)

    def acts_early(self, asked: Mapping[int, _Sides]) -> bool:
        """Return whether the walk came within the success distance of a stop that only the branch taken has before the
        condition was decided. `asked` has the leaves of both branches of each condition, that taken first.
        """
        return any(
            _near(self._positions[: self.decided[number] + 1], self._routes, *sides).any()
            for number, sides in asked.items()
        )

    def finish(self, stops: F64, goal: str) -> None:
        """Walk through the stops (m, 3) of a leaf, turn to face its goal, and stop.

        Raises
        ------
        Rejected : the follower does not reach them
        """
        at = len(self.actions)
        route = self._looking.to_goal.follow(self.place, self.heading, stops)
        self.actions += route.actions[:-1].tolist()
        self._replay()
        left = self._looking.pathfinder.geodesic_distance(self.place, stops[-1])
        if not route.arrived or not left <= _ARRIVED:
            raise Rejected("follower_stuck")
        after = at + np.append(0, np.flatnonzero(route.actions == FORWARD) + 1)
        for stop, there in zip(stops, after[route.arrivals].tolist(), strict=True):
            self._keep(np.concatenate([self._positions[at:there], stop[None]]))
            at = there
        turns = self._looking.to_goal.turns_to(self.place, self.heading, self._looking.middle(goal))
        self.actions += [*turns, STOP]
