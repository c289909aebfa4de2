"""Walks of an episode for training: the looking walk, the direct walk, and walks with a mistake and the way back; and
their rows in the tables ``trajectories``, ``steps`` and ``left_out``.

Every walk is a sequence of an agent's actions that is replayed once from the episode's start, so that its poses are
those of its actions bit for bit. At each frame the right action is known, also in a mistake.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, ActionSpace, FollowedRoute, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene.rotations import heading_of
from condvln.seeding import Draws, generator
from schemas.config import TrajectoryConfig, WalkKind
from schemas.episode import EpisodeLeaf
from schemas.evaluation import ManifestEpisode
from schemas.tables import LEFT_OUT, STEPS, TRAJECTORIES

__all__ = [
    "LeftOut",
    "WalkRows",
    "Walked",
    "direct_walk",
    "folder_name",
    "looking_walk",
    "point_of",
    "recovery_walks",
    "repeats_of",
    "twin_of",
    "vector",
]

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


def folder_name(episode: ManifestEpisode, kind: WalkKind = "looking", number: int = 0) -> str:
    """Return the name of a walk: StreamVLN's ``<scan>_<dataset>_<episode id>``, with the kind if it is not looking."""
    scan = _UNSAFE.sub("-", episode.scene_id).strip("-.") or "scene"
    name = f"{scan}_{DATASET}_{int(episode.episode_id):06d}"
    return name if kind == "looking" else f"{name}_{kind}{number or ''}"


def _gold(episode: ManifestEpisode) -> EpisodeLeaf:
    return next(one for one in episode.leaves if one.leaf == episode.gold_leaf)


def _stops(leaf: EpisodeLeaf) -> F64:
    """Return the stops (s, 3) of a leaf: its subgoals, followed by the goal point at which the leaf's path ends."""
    goals = np.array(leaf.goals, np.float64)
    goal = goals[np.square(goals - np.array(leaf.reference_path[-1])).sum(axis=1).argmin()]
    return np.array([*(subgoal.position for subgoal in leaf.subgoals), goal], np.float64).reshape(-1, 3)


def _follower(pathfinder: Pathfinder, config: TrajectoryConfig) -> Follower:
    """Return the follower whose actions have the configured sizes."""
    return Follower(pathfinder, ActionSpace(forward=config.forward, turn=config.turn))


def looking_walk(episode: ManifestEpisode, pathfinder: Pathfinder, config: TrajectoryConfig) -> Walked | LeftOut:
    """Return the walk that sees the evidence of each condition of the gold route before it acts on it: it looks for the
    first condition that is not decided, and has no leaf before the last decision.
    """
    if episode.looking_actions is None or episode.looking_decided is None:
        return LeftOut("looking", 0, "the episode has no looking path")
    actions = np.array(episode.looking_actions, np.int8)
    looks_for = np.full(len(actions), -1, np.int32)
    asked = dict.fromkeys(episode.program.route()[0])
    for number, frame in reversed([*zip(asked, episode.looking_decided, strict=True)]):
        looks_for[:frame] = number
    leaf = np.where(looks_for < 0, episode.gold_leaf, -1).astype(np.int32)
    return _walked_along(episode, pathfinder, config, "looking", 0, actions, actions, leaf, looks_for)


def direct_walk(
    episode: ManifestEpisode, pathfinder: Pathfinder, config: TrajectoryConfig, goal: F64
) -> Walked | LeftOut:
    """Return the walk of an agent that knows the gold leaf; it ends facing `goal` (3,), the middle of the gold leaf's
    object.
    """
    found = _direct_route(episode, pathfinder, config)
    if isinstance(found, str):
        return LeftOut("direct", 0, found)
    actions = _facing(episode, pathfinder, config, found.walk.actions, goal)
    leaf = np.full(len(actions), episode.gold_leaf, np.int32)
    return _walked_along(episode, pathfinder, config, "direct", 0, actions, actions, leaf)


def _facing(
    episode: ManifestEpisode, pathfinder: Pathfinder, config: TrajectoryConfig, executed: Actions, goal: F64
) -> Actions:
    """Return the actions with turns before STOP, so that the walk ends facing `goal` (3,)."""
    follower = _follower(pathfinder, config)
    end = follower.walk(episode.start_position, heading_of(episode.start_rotation), executed)
    turns = follower.turns_to(end.positions[-1], float(end.headings[-1]), goal)
    return np.concatenate([executed[:-1], turns, executed[-1:]]).astype(np.int8)


def recovery_walks(
    episode: ManifestEpisode, pathfinder: Pathfinder, config: TrajectoryConfig, goal: F64
) -> Iterator[Walked | LeftOut]:
    """Yield direct walks, each with one mistake and the way back; a `LeftOut` for each that can't be made. They end
    facing `goal` (3,).

    A mistake sets out for another leaf, or takes actions at random. The right action at each frame of the mistake is
    the first one of the way on from there.
    """
    route = _direct_route(episode, pathfinder, config)
    for number in range(config.recoveries):
        if isinstance(route, str):
            yield LeftOut("recovery", number, route)
            continue
        draws = Draws(generator(config.seed, "recovery", episode.episode_id, number))
        yield _recovery(episode, pathfinder, config, route, draws, number, goal)


def _recovery(
    episode: ManifestEpisode,
    pathfinder: Pathfinder,
    config: TrajectoryConfig,
    route: _Route,
    draws: Draws,
    number: int,
    goal: F64,
) -> Walked | LeftOut:
    follower = _follower(pathfinder, config)
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
        wrong = follower.follow(place, facing, _stops(next(one for one in episode.leaves if one.leaf == leaf))).actions[
            :-1
        ]
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
    way_back = _facing(episode, pathfinder, config, executed, goal)[step + len(mistake) :]
    actions, executed = (np.concatenate([one[: step + len(mistake)], way_back]) for one in (actions, executed))
    if (actions == executed).all():
        return LeftOut("recovery", number, "the mistake is no detour")
    towards = np.full(len(actions), episode.gold_leaf, np.int32)
    towards[step : step + len(mistake)] = leaf
    return _walked_along(episode, pathfinder, config, "recovery", number, actions, executed, towards)


def _direct_route(episode: ManifestEpisode, pathfinder: Pathfinder, config: TrajectoryConfig) -> _Route | str:
    stops = _stops(_gold(episode))
    walk = _follower(pathfinder, config).follow(episode.start_position, heading_of(episode.start_rotation), stops)
    return _Route(stops, walk) if walk.arrived else f"the follower does not reach the goal: {walk.outcome}"


def _walked_along(
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
    walk = _follower(pathfinder, config).walk(episode.start_position, heading_of(episode.start_rotation), executed)
    goals = np.array(_gold(episode).goals)
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


def twin_of(direct: Walked, episode: ManifestEpisode) -> Walked:
    """Return the walk of the episode's oracle-linear twin: a copy of the direct walk with another name and kind."""
    return replace(direct, name=folder_name(episode, "oracle"), kind="oracle")


def vector(values: Iterable[float]) -> dict[str, float]:
    """Return a point (3,) as the tables store it: ``{x, y, z}``."""
    return dict(zip("xyz", map(float, values), strict=True))


def point_of(row: Mapping[str, float]) -> NDArray[np.float64]:
    """Return the point (3,) that the tables store as ``{x, y, z}``."""
    return np.array([row[axis] for axis in "xyz"], np.float64)


class WalkRows:
    """Collects the walks of one scene as rows."""

    def __init__(self, scene_id: str) -> None:
        self._scene_id = scene_id
        self._trajectories: list[dict[str, Any]] = []
        self._left_out: list[dict[str, Any]] = []
        self._steps: list[pa.Table] = []

    def add(
        self,
        episode: ManifestEpisode,
        walked: Walked,
        pathfinder: Pathfinder,
        text: str,
        repeats: NDArray[np.integer],
        frames_of: str | None = None,
    ) -> None:
        """Add a walk.

        repeats : (n,) how often each frame occurs in balanced layouts
        frames_of : the walk whose images this one has; its own by default
        """
        goals = np.array(_gold(episode).goals)
        row = {"scene_id": self._scene_id, "trajectory": walked.name, "episode_id": int(episode.episode_id)}
        row["kind"] = walked.kind
        self._trajectories.append(
            row
            | {
                "instruction_text": text,
                "frames_of": frames_of or walked.name,
                "n_frames": len(walked),
                "actions": walked.actions.tolist(),
                "executed": walked.executed.tolist(),
                "repeats": repeats.tolist(),
                "goals": [vector(goal) for goal in goals],
                "success_distance": float(episode.success_distance),
                "max_steps": episode.max_steps,
                "start_position": vector(walked.positions[0]),
                "start_rotation": dict(zip("xyzw", map(float, episode.start_rotation), strict=True)),
                "navmesh": episode.navmesh,
                "navmesh_sha256": episode.navmesh_sha256,
            }
        )
        if frames_of is not None:
            return
        distances = pathfinder.distance_table(walked.positions, goals).min(axis=1).astype(np.float64)
        count = len(walked)
        places = walked.positions.astype(np.float64)
        half = walked.headings / 2
        zeros = np.zeros(count)
        columns: dict[str, Any] = {name: [value] * count for name, value in row.items()}
        columns |= {
            "frame": np.arange(count, dtype=np.int32),
            "action": walked.actions,
            "executed": walked.executed,
            "position": pa.StructArray.from_arrays([*map(pa.array, places.T)], fields=[*STEPS.field("position").type]),
            "rotation": pa.StructArray.from_arrays(
                [pa.array(part) for part in (zeros, np.sin(half), zeros, np.cos(half))],
                fields=[*STEPS.field("rotation").type],
            ),
            "heading": walked.headings,
            "leaf": walked.leaf,
            "looks_for": pa.array(walked.looks_for, mask=walked.looks_for < 0),
            "distance_to_goal": distances,
        }
        self._steps.append(pa.table(columns, schema=STEPS))

    def leave_out(self, episode: ManifestEpisode, found: LeftOut) -> None:
        """Add a walk that could not be made."""
        self._left_out.append({"scene_id": self._scene_id, "episode_id": int(episode.episode_id), **vars(found)})

    def tables(self) -> dict[str, pa.Table]:
        """Return the tables by name."""
        return {
            "trajectories": pa.Table.from_pylist(self._trajectories, schema=TRAJECTORIES),
            "steps": pa.concat_tables(self._steps) if self._steps else STEPS.empty_table(),
            "left_out": pa.Table.from_pylist(self._left_out, schema=LEFT_OUT),
        }
