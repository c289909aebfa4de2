"""Exploration walks: look at the evidence of each condition before the decision, then walk to the gold leaf.

A person who reads "check whether the lamp is near the bed" goes where the bed can be seen. The evidence of a condition
is what `condvln.episodes.observability` says: a witness and its anchor, the things that the words could mean, or the
floor of a room. It counts as seen when the agent faces enough of it, within the range of sight.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.episodes.observability import Observer, SightNeed
from condvln.episodes.view import SceneView
from condvln.navigation.follower import LEFT, RIGHT, VLN_CE, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import SightTarget, View, eyes_at, in_view
from condvln.scene import Scene
from condvln.trajectories.walks import LeftOut, Walked, heading_of, leaf_stops, walked_along
from schemas.config import EpisodeConfig, PlacesConfig, TrajectoryConfig
from schemas.evaluation import ManifestEpisode

__all__ = ["Explorer"]

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

UNDECIDED: Final = -1
"""Leaf of a frame before the decision."""
_SPACING: Final = 0.25
"""Metres between two places on a path from which evidence is looked for."""
_RINGS: Final = (0.75, 1.25, 2.0, 3.0)
"""Distances in metres from a thing at which a place to see it from is looked for."""
_ANGLES: Final = 16
"""Number of such places on each ring."""
_PLACES: Final = 48
"""Number of places of a floor from which it is looked at."""
_VISITS: Final = 8
"""Largest number of places that are visited for one piece of evidence."""


class Explorer:
    """Makes the exploration walks of one scene.

    Parameters
    ----------
    view : lines of sight of the scene
    places, rules : range and height of the eyes; which share of the evidence must be seen
    """

    def __init__(
        self,
        scene: Scene,
        view: SceneView,
        config: TrajectoryConfig,
        places: PlacesConfig | None = None,
        rules: EpisodeConfig | None = None,
    ) -> None:
        self._scene, self._view, self._config = scene, view, config
        self._places, self._rules = places or PlacesConfig(), rules or EpisodeConfig()

    def walk(self, episode: ManifestEpisode, pathfinder: Pathfinder) -> Walked | LeftOut:
        """Return the exploration walk of an episode; a `LeftOut` if evidence can't be seen from anywhere, or if the
        walk takes more actions than the episode allows.
        """
        observer = Observer(self._scene, self._view, pathfinder, self._places, self._rules)
        search = _Search(episode, pathfinder, observer, self._view, self._places, self._rules, self._config.look_angle)
        conditions = [*dict.fromkeys(episode.program.route()[0])]
        for number in conditions:
            if not search.decide(number):
                return LeftOut("exploration", 0, f"the evidence of condition {number} is not seen")
        looked = len(search.actions)
        route = Follower(pathfinder).follow(search.place, search.heading, leaf_stops(episode, episode.gold_leaf))
        if not route.arrived:
            return LeftOut("exploration", 0, f"the follower does not reach the goal: {route.outcome}")
        actions = np.concatenate([np.array(search.actions, np.int8), route.actions])
        if len(actions) > episode.max_steps:
            return LeftOut("exploration", 0, "more actions than the episode allows")
        leaf = np.full(len(actions), episode.gold_leaf, np.int32)
        leaf[:looked] = UNDECIDED
        looks_for = np.full(len(actions), -1, np.int32)
        looks_for[:looked] = search.looks_for
        return walked_along(
            episode, pathfinder, self._config, "exploration", 0, actions, actions, leaf, looks_for=looks_for
        )


class _Search:
    """The walk so far, and what was seen on it.

    Attributes
    ----------
    actions, looks_for : the actions so far, and the condition that each one is for
    place, heading : the present pose: (3,) metres, radians
    """

    def __init__(
        self,
        episode: ManifestEpisode,
        pathfinder: Pathfinder,
        observer: Observer,
        view: SceneView,
        places: PlacesConfig,
        rules: EpisodeConfig,
        look_angle: float,
    ) -> None:
        self._program, self._observer, self._view = episode.program, observer, view
        self._follower, self._pathfinder = Follower(pathfinder), pathfinder
        self._start, self._first = np.array(episode.start_position, np.float64), heading_of(episode.start_rotation)
        self._eye_height, self._rules, self._most = places.eye_height, rules, episode.max_steps
        self._ahead = View(range=places.sight_range, horizontal_fov=look_angle)
        self._seen: dict[SightNeed, tuple[int, Bools]] = {}
        self.actions: list[int] = []
        self.looks_for: list[int] = []
        self._replay()

    def decide(self, number: int) -> bool:
        """Walk and turn until the evidence of a condition is seen, and return True. If the evidence can't be seen,
        return False and leave the walk as it was.
        """
        ways = self._observer.needs(self._program.conditions[number])
        before = len(self.actions)
        for way in ways:
            if all(self._look_for(need, number) for need in sorted(way)):
                return True
            # This evidence can't be seen: the walk goes on as if it had not been tried.
            del self.actions[before:], self.looks_for[before:]
            self._seen.clear()
            self._replay()
        return False

    def _look_for(self, need: SightNeed, number: int) -> bool:
        target = self._observer.target(need)
        if target is None:
            return False
        for _ in range(_VISITS):
            if self._known(need, target):
                return True
            here = self._visible(need, target, self.place[None])[0] & ~self._so_far(need, target)
            if here.any():
                self._face(need, target, here, number)
                if self._known(need, target):
                    return True
            goal = self._place_to_see(need, target)
            if goal is None or len(self.actions) > self._most:
                return False
            route = self._follower.follow(self.place, self.heading, goal)
            if not route.arrived or len(route.actions) < 2:
                return False
            self._take(route.actions[:-1].tolist(), number)
        return self._known(need, target)

    def _face(self, need: SightNeed, target: SightTarget, wanted: Bools, number: int) -> None:
        """Turn by the shorter way to the middle of the `wanted` samples, then on in the same direction until all these
        samples, or enough of the target, have been in view.
        """
        middle = target.samples[wanted].mean(axis=0) - self.place
        off = (math.atan2(-middle[0], -middle[2]) - self.heading + math.pi) % (2 * math.pi) - math.pi
        turn = LEFT if off > 0 else RIGHT
        step = math.radians(VLN_CE.turn)
        self._take([turn] * round(abs(off) / step), number)
        left = VLN_CE.headings - round(abs(off) / step)
        while left > 0 and (wanted & ~self._so_far(need, target)).any() and not self._known(need, target):
            self._take([turn], number)
            left -= 1

    def _place_to_see(self, need: SightNeed, target: SightTarget) -> F64 | None:
        """Return the place to which the agent walks to see a target; None if no place helps. For a thing it is the
        first place on the way from which enough of the thing is visible, else the nearest such place around the thing.
        For a floor it is the place that shows most of the unseen floor in relation to the length of the way.
        """
        least = self._least(need)
        if need[0] == "floor":
            found, costs = self._reachable(self._candidates(need, target))
            new = self._share(need, target, found, ~self._so_far(need, target))
            worth = new / (1.0 + costs)
            return found[int(np.argmax(worth))] if len(worth) and worth.max() > 0 else None
        every = np.ones(len(target.samples), bool)
        path = self._path(target.samples.mean(axis=0))
        enough = self._share(need, target, path, every) >= least
        if enough.any():
            return np.asarray(path[int(np.argmax(enough))])
        found, costs = self._reachable(self._candidates(need, target))
        costs = np.where(self._share(need, target, found, every) >= least, costs, np.inf)
        return found[int(np.argmin(costs))] if np.isfinite(costs).any() else None

    def _candidates(self, need: SightNeed, target: SightTarget) -> F64:
        if need[0] == "floor":
            return target.samples[:: max(1, len(target.samples) // _PLACES)]
        angles = np.arange(_ANGLES) * (2 * math.pi / _ANGLES)
        around = np.stack([np.cos(angles), np.zeros(_ANGLES), np.sin(angles)], axis=1)
        middle = target.samples.mean(axis=0)
        middle[1] = self.place[1]
        return np.concatenate([middle + radius * around for radius in _RINGS])

    def _reachable(self, points: F64) -> tuple[F64, F64]:
        """Snap `points` to the navmesh. Return the snapped points to which the agent can walk, and the metres to each.
        Points where the agent already stands are left out.
        """
        snapped = np.asarray(self._pathfinder.snap_points(points), np.float64)
        snapped = snapped[np.isfinite(snapped).all(axis=1)]
        if not len(snapped):
            return snapped, np.zeros(0)
        metres = np.asarray(self._pathfinder.distance_table(self.place[None], snapped)[0], np.float64)
        # A place on which the agent stands already shows nothing new.
        open_to = np.isfinite(metres) & (metres > _SPACING)
        return snapped[open_to], metres[open_to]

    def _path(self, goal: F64) -> F64:
        """Return places (n, 3) on the shortest path to the point of the navmesh nearest to `goal`."""
        end = np.asarray(self._pathfinder.snap_point(goal), np.float64)
        if not np.isfinite(end).all():
            return np.zeros((0, 3))
        corners = np.asarray(self._pathfinder.find_path(self.place, end).points, np.float64).reshape(-1, 3)
        if len(corners) < 2:
            return np.zeros((0, 3))
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
        at = np.arange(2 * _SPACING, length[-1], _SPACING)
        return np.column_stack([np.interp(at, length, corners[:, axis]) for axis in range(3)]).reshape(-1, 3)

    def _share(self, need: SightNeed, target: SightTarget, places: F64, wanted: Bools) -> F64:
        """Return for each place (n,) the share of the samples of a target that are both `wanted` and visible from the
        place.
        """
        if not len(places):
            return np.zeros(0)
        return np.asarray((self._visible(need, target, places) & wanted).mean(axis=1))

    def _visible(self, need: SightNeed, target: SightTarget, places: F64) -> Bools:
        return self._view.seen(eyes_at(places, self._eye_height), target, self._observer.around[need[0]])

    def _known(self, need: SightNeed, target: SightTarget) -> bool:
        return bool(self._so_far(need, target).mean() >= self._least(need))

    def _least(self, need: SightNeed) -> float:
        return self._rules.floor_seen if need[0] == "floor" else self._rules.object_seen

    def _so_far(self, need: SightNeed, target: SightTarget) -> Bools:
        """Return the mask (k,) of samples that were in view at any frame so far."""
        done, mask = self._seen.get(need, (0, np.zeros(len(target.samples), bool)))
        if done < len(self._places):
            places, headings = self._places[done:], self._headings[done:]
            facing = in_view(eyes_at(places, self._eye_height), target.samples, self._ahead, headings)
            some = facing.any(axis=1)
            if some.any():
                mask = mask | (facing[some] & self._visible(need, target, places[some])).any(axis=0)
            self._seen[need] = len(self._places), mask
        return mask

    def _take(self, actions: list[int], number: int) -> None:
        self.actions += actions
        self.looks_for += [number] * len(actions)
        self._replay()

    def _replay(self) -> None:
        """Compute the poses by executing all actions from the start, as every reader of the walk does."""
        walk = self._follower.walk(self._start, self._first, self.actions)
        self._places, self._headings = walk.positions.astype(np.float64), walk.headings
        self.place, self.heading = self._places[-1], float(self._headings[-1])
