"""Reference agents without simulator or learning: an upper bound, a lower bound, and guessers.

All walk on the navmesh with VLN-CE's actions, except ``perfect``, which moves along the reference path itself. Their
expected scores are in docs/metrics.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from condvln.evaluation.predictions import Prediction
from condvln.evaluation.task import Task
from condvln.evaluation.walker import heading_of
from condvln.navigation.follower import VLN_CE, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.points import densify
from condvln.seeding import generator
from schemas.config.constants import PATH_SPACING
from schemas.errors import UsageError

__all__ = ["AGENTS", "Agent", "agent_named", "predict_all", "walk_to_leaf"]


class Agent(Protocol):
    """A reference agent: a function of (task, pathfinder, seed) that returns the agent's prediction for this task. The
    prediction does not depend on other episodes.
    """

    def __call__(self, task: Task, pathfinder: Pathfinder, seed: int) -> Prediction: ...


def walk_to_leaf(task: Task, pathfinder: Pathfinder, leaf: int) -> Prediction:
    """Walk through the leaf's subgoals to the goal at the end of its path and stop there, within the step budget."""
    target = task.leaves[leaf]
    heading, stops = heading_of(task.start_rotation), np.vstack([target.subgoals, target.end])
    return _taken(task, pathfinder, Follower(pathfinder, VLN_CE).follow(task.start, heading, stops).actions)


def _taken(task: Task, pathfinder: Pathfinder, actions: npt.ArrayLike) -> Prediction:
    """Take actions from the start, within the step budget."""
    actions = np.asarray(actions, np.int8)[: task.max_steps]
    poses = Follower(pathfinder, VLN_CE).walk(task.start, heading_of(task.start_rotation), actions)
    stopped = len(actions) > 0 and actions[-1] == 0
    positions = poses.positions.astype(np.float64)
    return Prediction(task.episode_id, positions, bool(stopped), True, None, poses.headings)


def perfect(task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
    """Follow the gold leaf's reference path in steps of 0.25 m, without regard to headings."""
    points = densify(task.gold.path, PATH_SPACING)
    return Prediction(task.episode_id, points, True, False)


def looking(task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
    """Walk along the looking path, which sees the evidence of each condition before it acts on it; where an episode has
    none, walk as ``oracle`` does.
    """
    if task.looking is None:
        return oracle(task, pathfinder, seed)
    return _taken(task, pathfinder, task.looking.actions)


def oracle(task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
    """Walk to the gold leaf, knowing every condition's truth and the map."""
    return walk_to_leaf(task, pathfinder, task.gold_leaf)


def wrong_branch(task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
    """Walk to a random wrong leaf."""
    others = [leaf for leaf in range(len(task.leaves)) if leaf != task.gold_leaf]
    return walk_to_leaf(task, pathfinder, others[_draw(seed, "wrong-branch", task, len(others))])


def random_leaf(task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
    """Walk to a leaf drawn uniformly."""
    return walk_to_leaf(task, pathfinder, _draw(seed, "random-leaf", task, len(task.leaves)))


def always_then(task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
    """Walk to the leaf that is reached if every condition is true."""
    return walk_to_leaf(task, pathfinder, task.program.gold_leaf([True] * len(task.program.conditions)))


def always_else(task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
    """Walk to the leaf that is reached if every condition is false."""
    return walk_to_leaf(task, pathfinder, task.program.gold_leaf([False] * len(task.program.conditions)))


def nearest(task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
    """Walk to the leaf whose goal is nearest to the start."""
    return walk_to_leaf(task, pathfinder, int(np.argmin([leaf.geodesic_distance for leaf in task.leaves])))


def coin_flip(task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
    """Answer every condition on the way at random, so that shallow leaves are likelier than deep ones."""
    truths = (
        generator(seed, "coin-flip", task.episode_hash or task.episode_id)
        .integers(0, 2, len(task.program.conditions))
        .astype(bool)
    )
    return walk_to_leaf(task, pathfinder, task.program.gold_leaf(truths.tolist()))


def stop_at_start(task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
    """Stop at the start without moving."""
    points = np.vstack([task.start, task.start])
    return Prediction(
        task.episode_id, points, True, True, np.zeros(2, bool), np.full(2, heading_of(task.start_rotation))
    )


AGENTS: Final[Mapping[str, Agent]] = {
    "perfect": perfect,
    "looking": looking,
    "oracle": oracle,
    "wrong-branch": wrong_branch,
    "random-leaf": random_leaf,
    "coin-flip": coin_flip,
    "always-then": always_then,
    "always-else": always_else,
    "nearest": nearest,
    "stop-at-start": stop_at_start,
}
"""The reference agents by the name that ``condvln walk --agent`` takes."""


def agent_named(name: str) -> Agent:
    """Return the reference agent that is called ``name``.

    Raises
    ------
    UsageError : there is no agent of this name
    """
    if name not in AGENTS:
        raise UsageError(
            f"no agent {name!r}", remedy=f"Choose one of {', '.join(AGENTS)}, looker, or your own module:Class"
        )
    return AGENTS[name]


def predict_all(
    agent: Agent, tasks: Iterable[Task], pathfinder_of: Callable[[Task], Pathfinder], *, seed: int = 0
) -> Iterator[Prediction]:
    """Yield the agent's prediction for each task, one at a time."""
    for task in tasks:
        yield agent(task, pathfinder_of(task), seed)


def _draw(seed: int, purpose: str, task: Task, count: int) -> int:
    return int(generator(seed, purpose, task.episode_hash or task.episode_id).integers(count))
