"""Walks of an episode for training: the gold walk, and walks with a mistake and the way back.

Every walk is a sequence of VLN-CE's actions that is replayed once from the episode's start, so that its poses are those
of its actions bit for bit. At each frame the right action is known, also in a mistake.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, FollowedRoute, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.seeding import Draws, generator
from schemas.config import TrajectoryConfig, WalkKind
from schemas.evaluation import ManifestEpisode

__all__ = [
    "LeftOut",
    "Walked",
    "folder_name",
    "gold_walk",
    "heading_of",
    "leaf_stops",
    "recovery_walks",
    "repeats_of",
    "twin_of",
    "walked_along",
]

F64 = NDArray[np.float64]
Actions = NDArray[np.int8]

DATASET: Final = "condvln"
"""Second part of a walk's name, where R2R's or RxR's stands in StreamVLN's own data."""
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9.-]+")


@dataclass(frozen=True, eq=False)
class Walked:
    """One walk of an episode; n frames, each seen before its action.

    Attributes
    ----------
    name : the folder of its images
    number : number of the walk among those of its kind
    actions : (n,) the right action at each frame; the last one is STOP
    executed : (n,) the action that was taken at each frame
    positions : (n, 3) float32 of the agent's feet, metres
    headings : (n,) radians counter-clockwise from −z
    leaf : (n,) the leaf that the agent walks to, -1 before it has decided
    looks_for : (n,) index of the condition whose evidence it looks for; -1 if it looks for none
    """

    name: str
    kind: WalkKind
    number: int
    actions: Actions
    executed: Actions
    positions: NDArray[np.float32]
    headings: F64
    leaf: NDArray[np.int32]
    looks_for: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.actions)


@dataclass(frozen=True)
class LeftOut:
    """A walk that could not be made, and why."""

    kind: WalkKind
    number: int
    reason: str


@dataclass(frozen=True, eq=False)
class _Route:
    """The gold route of an episode: its stops (s, 3), the last of which is the goal, and the walk through all stops."""

    stops: F64
    walk: FollowedRoute

    def open_stops(self, step: int) -> F64:
        """Return the stops that are not reached before action `step`."""
        place = int((self.walk.actions[:step] == FORWARD).sum())
        later = self.walk.arrivals >= place
        later[-1] = True
        return self.stops[later]


def heading_of(rotation: Sequence[float]) -> float:
    """Return the heading in radians, counter-clockwise from −z, of a rotation [x, y, z, w] about +y."""
    return 2.0 * math.atan2(rotation[1], rotation[3]) % (2.0 * math.pi)


def folder_name(episode: ManifestEpisode, kind: WalkKind = "gold", number: int = 0) -> str:
    """Return the name of a walk: StreamVLN's ``<scan>_<dataset>_<episode id>``, with the kind if it is not gold."""
    scan = _UNSAFE.sub("-", episode.scene_id).strip("-.") or "scene"
    name = f"{scan}_{DATASET}_{int(episode.episode_id):06d}"
    return name if kind == "gold" else f"{name}_{kind}{number or ''}"


def leaf_stops(episode: ManifestEpisode, leaf: int) -> F64:
    """Return the stops (s, 3) of a leaf: its subgoals, followed by the goal point at which the leaf's path ends."""
    found = next(one for one in episode.leaves if one.leaf == leaf)
    goals = np.array(found.goals, np.float64)
    goal = goals[np.square(goals - np.array(found.reference_path[-1])).sum(axis=1).argmin()]
    return np.array([*(subgoal.position for subgoal in found.subgoals), goal], np.float64).reshape(-1, 3)


def gold_walk(episode: ManifestEpisode, pathfinder: Pathfinder, config: TrajectoryConfig) -> Walked | LeftOut:
    """Return the walk of an agent that knows the gold leaf."""
    found = _gold_route(episode, pathfinder)
    if isinstance(found, str):
        return LeftOut("gold", 0, found)
    actions = found.walk.actions
    leaf = np.full(len(actions), episode.gold_leaf, np.int32)
    return walked_along(episode, pathfinder, config, "gold", 0, actions, actions, leaf)


def recovery_walks(
    episode: ManifestEpisode, pathfinder: Pathfinder, config: TrajectoryConfig
) -> Iterator[Walked | LeftOut]:
    """Yield walks along the gold route, each with one mistake and the way back; a `LeftOut` for each that can't be
    made.

    A mistake sets out for another leaf, or takes actions at random. The right action at each frame of the mistake is
    the first one of the way on from there.
    """
    route = _gold_route(episode, pathfinder)
    for number in range(config.recoveries):
        if isinstance(route, str):
            yield LeftOut("recovery", number, route)
            continue
        draws = Draws(generator(config.seed, "recovery", episode.episode_id, number))
        yield _recovery(episode, pathfinder, config, route, draws, number)


def _recovery(
    episode: ManifestEpisode,
    pathfinder: Pathfinder,
    config: TrajectoryConfig,
    route: _Route,
    draws: Draws,
    number: int,
) -> Walked | LeftOut:
    follower = Follower(pathfinder)
    start, heading = np.array(episode.start_position), heading_of(episode.start_rotation)
    gold = route.walk.actions
    step = draws.index(len(gold))
    open_stops = route.open_stops(step)
    before = follower.walk(start, heading, gold[:step])
    place, facing = before.positions[-1], float(before.headings[-1])
    length = config.least_mistake + draws.index(config.most_mistake - config.least_mistake + 1)
    leaf = episode.gold_leaf
    others = [one.leaf for one in episode.leaves if one.leaf != episode.gold_leaf]
    if draws.uniform() < config.wrong_turns:
        leaf = draws.choice(sorted(others))
        wrong = follower.follow(place, facing, leaf_stops(episode, leaf)).actions[:-1]
        # What the ways have in common is not a mistake.
        gold_on = gold[step:]
        same = min(len(wrong), len(gold_on))
        apart = np.flatnonzero(wrong[:same] != gold_on[:same])
        shared = int(apart[0]) if len(apart) else same
        mistake = wrong[: shared + length]
    else:
        mistake = np.array([draws.choice((FORWARD, FORWARD, LEFT, RIGHT)) for _ in range(length)], np.int8)
    poses = follower.walk(place, facing, mistake)
    right = []
    for at in range(len(mistake)):
        ahead = follower.follow(poses.positions[at], float(poses.headings[at]), open_stops)
        if not ahead.arrived:
            return LeftOut("recovery", number, "no way back")
        right.append(ahead.actions[0])
    back = follower.follow(poses.positions[-1], float(poses.headings[-1]), open_stops)
    if not back.arrived:
        return LeftOut("recovery", number, "no way back")
    actions = np.concatenate([gold[:step], np.array(right, np.int8), back.actions])
    executed = np.concatenate([gold[:step], mistake, back.actions])
    if (actions == executed).all():
        return LeftOut("recovery", number, "the mistake is no detour")
    towards = np.full(len(actions), episode.gold_leaf, np.int32)
    towards[step : step + len(mistake)] = leaf
    return walked_along(episode, pathfinder, config, "recovery", number, actions, executed, towards)


def _gold_route(episode: ManifestEpisode, pathfinder: Pathfinder) -> _Route | str:
    stops = leaf_stops(episode, episode.gold_leaf)
    walk = Follower(pathfinder).follow(episode.start_position, heading_of(episode.start_rotation), stops)
    return _Route(stops, walk) if walk.arrived else f"the follower does not reach the goal: {walk.outcome}"


def walked_along(
    episode: ManifestEpisode,
    pathfinder: Pathfinder,
    config: TrajectoryConfig,
    kind: WalkKind,
    number: int,
    actions: Actions,
    executed: Actions,
    leaf: NDArray[np.int32],
    looks_for: NDArray[np.int32] | None = None,
) -> Walked | LeftOut:
    """Return the walk of the executed actions, replayed on the navmesh; a `LeftOut` if the number of actions is outside
    the configured limits, or the last pose outside the success distance of the gold leaf's goals.
    """
    if len(actions) < config.least_actions:
        return LeftOut(kind, number, "fewer actions than least_actions")
    if len(actions) > config.most_actions:
        return LeftOut(kind, number, "more actions than most_actions")
    walk = Follower(pathfinder).walk(episode.start_position, heading_of(episode.start_rotation), executed)
    goals = np.array(next(one for one in episode.leaves if one.leaf == episode.gold_leaf).goals)
    left = pathfinder.distance_table(walk.positions[-1:], goals).min()
    if not left <= episode.success_distance:
        return LeftOut(kind, number, "the walk ends outside the success distance")
    return Walked(
        folder_name(episode, kind, number),
        kind,
        number,
        np.asarray(actions, np.int8),
        np.asarray(executed, np.int8),
        walk.positions[: len(actions)],
        walk.headings[: len(actions)],
        leaf,
        np.full(len(actions), -1, np.int32) if looks_for is None else looks_for,
    )


def repeats_of(walked: Walked, config: TrajectoryConfig) -> NDArray[np.int32]:
    """Return how many samples each frame gives, (n,): the configured number for the frame's right action, 0 in a
    mistake.
    """
    by_action = np.full(4, config.turn_repeats, np.int32)
    by_action[STOP], by_action[FORWARD] = config.stop_repeats, config.forward_repeats
    return np.where(walked.actions == walked.executed, by_action[walked.actions], 0).astype(np.int32)


def twin_of(gold: Walked, episode: ManifestEpisode) -> Walked:
    """Return the walk of the episode's oracle-linear twin: a copy of the gold walk with another name and kind."""
    return replace(gold, name=folder_name(episode, "oracle"), kind="oracle")
