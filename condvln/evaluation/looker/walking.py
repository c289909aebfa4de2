"""Run the looker agent on episodes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from condvln.arrays import F64
from condvln.evaluation.looker.eyes import Eyes
from condvln.evaluation.looker.looker import Looker
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.scene_views import View
from condvln.evaluation.task import Task
from condvln.evaluation.walker import SteppedEpisode, heading_of
from condvln.navigation.pathfinder import Pathfinder
from condvln.sensors import noisy_pose
from schemas.config import LookerConfig

__all__ = ["LookerWalk", "LookingAgent"]


@dataclass(frozen=True, eq=False, slots=True)
class LookerWalk:
    """A walk of the looker agent: its prediction, its leaf, its answers by condition, and the conditions that it
    answered without sufficient evidence. The leaf is the chosen one, or the agent's guess if it never chose one.
    """

    prediction: Prediction
    leaf: int
    verdicts: dict[int, bool]
    forced: frozenset[int]


class LookingAgent:
    """The agent ``looker`` of ``condvln walk``: cameras, its own map, and the grammar's parser.

    Parameters
    ----------
    views : the opened scenes of the episodes
    """

    def __init__(self, views: Callable[[str], View], config: LookerConfig | None = None) -> None:
        self._config = config or LookerConfig()
        self._eyes = lru_cache(maxsize=2)(self._open)
        self._views = views

    def __call__(self, task: Task, pathfinder: Pathfinder, seed: int) -> Prediction:
        return self.walk(task, pathfinder, seed).prediction

    def walk(self, task: Task, pathfinder: Pathfinder, seed: int = 0) -> LookerWalk:
        """Walk one episode. The agent gets the text, the budget, its steps from the start and what it sees.

        Raises
        ------
        FormatError : the text can't be read
        InputError : the scene can't be read
        """
        noise = self._config.noise
        name = task.episode_hash or task.episode_id
        eyes = self._eyes(str(task.axes["scene"]))
        eyes.begin(seed, name)
        episode = SteppedEpisode(task, pathfinder, noise=noise, seed=seed)
        looker = Looker(task.text, episode.limit, self._config, seed, name)
        first = heading_of(task.start_rotation)
        if self._config.map == "given":
            _reveal(looker, eyes, pathfinder, task.start, first)
        while not episode.stopped and not episode.out_of_steps:
            position, heading = np.asarray(episode.position, np.float64), episode.heading
            believed, facing = noisy_pose(position, heading, noise, seed, (name, episode.steps))
            place, own = _from_start(believed, facing, task.start, first)
            episode.take(looker.act(place, own, lambda p=position, h=heading: eyes(p, h), episode.collided))  # type: ignore[misc]
        # It looks all round, so that no heading says what it saw.
        walked = replace(episode.prediction(), headings=None)
        return LookerWalk(walked, looker.picked, dict(looker.verdicts), frozenset(looker.forced))

    def _open(self, scene: str) -> Eyes:
        view = self._views(scene)
        return Eyes(view.scene, view.renderer, self._config)


def _from_start(position: F64, heading: float, start: F64, first: float) -> tuple[F64, float]:
    """Convert a pose to the frame of the start pose: the position `start` becomes the origin, and the heading `first`
    becomes the direction −z.
    """
    east, up, south = position - start
    c, s = math.cos(first), math.sin(first)
    return np.array([c * east - s * south, up, s * east + c * south]), (heading - first) % (2 * math.pi)


def _reveal(looker: Looker, eyes: Eyes, pathfinder: Pathfinder, start: F64, first: float) -> None:
    """Add the walkable floor around the start to the map of an agent that is given the floor in advance."""
    reach = np.arange(-15.0, 15.0, 0.1) + 0.05
    x, z = (axis.ravel() for axis in np.meshgrid(reach, reach, indexing="ij"))
    c, s = math.cos(first), math.sin(first)
    points = np.stack([start[0] + c * x + s * z, np.full(len(x), start[1]), start[2] - s * x + c * z], axis=1)
    snapped = pathfinder.snap_points(points)
    open_floor = np.hypot(*(snapped - points)[:, [0, 2]].T) <= 0.05
    open_floor &= np.abs(snapped[:, 1] - start[1]) <= 0.5
    looker.map.reveal(np.stack([x, z], axis=1)[open_floor], eyes.rooms(points[open_floor], float(start[1])))
