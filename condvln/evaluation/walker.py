"""A kinematic simulator on the navmesh: VLN-CE's four actions, Habitat's sliding steps, no rendering.

Poses are those of :class:`~condvln.navigation.follower.Follower`, which also replays ground truth. An agent gets its
pose, the instruction and (if objects are given) the labels in view; ground truth stays with the evaluator.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from condvln.arrays import F64
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.task import Task
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, VLN_CE, ActionSpace, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene.rotations import heading_of
from condvln.sensors import noisy_move
from schemas.config import NoiseConfig
from schemas.errors import UsageError

__all__ = ["Eyes", "Observation", "Policy", "SeenObject", "SteppedEpisode", "heading_of", "labels_in_view", "walk"]


SIGHT: Final = 5.0
"""Viewing distance in metres of the agent (VLN-CE's fog of war)."""
FIELD_OF_VIEW: Final = 90.0
"""Horizontal field of view in degrees (VLN-CE's camera)."""

# The geodesic to an object around a corner is much longer than the straight line; this ratio allows for furniture.
_DETOUR: Final = 1.2
_DETOUR_METRES: Final = 0.5


@dataclass(frozen=True, eq=False)
class Observation:
    """What a policy sees before each action.

    Attributes
    ----------
    position : (3,) metres, Habitat frame; heading : radians counter-clockwise from −z
    labels : canonical labels of the objects in view, sorted; empty without `eyes`
    collided : the last forward step collided
    """

    episode_id: str
    instruction: str
    position: F64
    heading: float
    step: int
    max_steps: int
    labels: tuple[str, ...]
    collided: bool


class Policy(Protocol):
    """An agent. Within an episode it may keep state; ``begin`` starts a new episode."""

    def begin(self, observation: Observation) -> None:
        """Begin a new episode; the observation is that of the start."""

    def act(self, observation: Observation) -> int:
        """Return the next action: STOP 0, FORWARD 1, LEFT 2 or RIGHT 3."""


@dataclass(frozen=True)
class SeenObject:
    """A visible object: its canonical label and its centre (3,) in metres."""

    label: str
    center: tuple[float, float, float]


Eyes = Callable[[Task, F64, float], tuple[str, ...]]
"""Returns the labels in view from a position and heading."""


def labels_in_view(objects: Mapping[str, Sequence[SeenObject]], pathfinder_of: Callable[[Task], Pathfinder]) -> Eyes:
    """Return a function that returns the labels of the objects in view: those within `SIGHT` metres and within the
    horizontal `FIELD_OF_VIEW` in degrees.

    There is no rendering, so occlusion is estimated: an object is hidden if its geodesic distance is much longer than
    its straight-line distance.

    Parameters
    ----------
    objects : by scene, as in the axis ``scene`` (``<source>/<scene id>``)
    """
    cosine = math.cos(math.radians(FIELD_OF_VIEW / 2))

    def look(task: Task, position: F64, heading: float) -> tuple[str, ...]:
        seen = objects.get(str(task.axes["scene"]), ())
        if not seen:
            return ()
        centers = np.array([thing.center for thing in seen])
        away = centers - position
        flat = np.hypot(away[:, 0], away[:, 2])
        ahead = away[:, 0] * -math.sin(heading) + away[:, 2] * -math.cos(heading)
        near = (np.sqrt(np.square(away).sum(axis=1)) <= SIGHT) & (ahead >= flat * cosine)
        candidates = np.flatnonzero(near)
        if not len(candidates):
            return ()
        walks = np.asarray(pathfinder_of(task).geodesic_distances(position[None], centers[candidates]))
        open_view = walks <= flat[candidates] * _DETOUR + _DETOUR_METRES
        return tuple(sorted({seen[index].label for index in candidates[open_view]}))

    return look


def walk(
    task: Task,
    policy: Policy,
    pathfinder: Pathfinder,
    *,
    eyes: Eyes | None = None,
    space: ActionSpace = VLN_CE,
    sliding: bool = True,
    max_steps: int | None = None,
) -> Prediction:
    """Let a policy walk one episode, until STOP or the end of its step budget.

    Raises
    ------
    UsageError : the policy returns an unknown action
    """
    episode = SteppedEpisode(task, pathfinder, space=space, sliding=sliding, max_steps=max_steps)
    while not episode.stopped and not episode.out_of_steps:
        place, heading = episode.position, episode.heading
        observation = Observation(
            task.episode_id,
            task.text,
            place,
            heading,
            episode.steps,
            episode.limit,
            eyes(task, place, heading) if eyes is not None else (),
            episode.collided,
        )
        if not episode.steps:
            policy.begin(observation)
        episode.take(policy.act(observation))
    return episode.prediction()


_BLOCKED: Final = 1e-3


class SteppedEpisode:
    """A walk through an episode, until STOP or the end of its step budget.

    Parameters
    ----------
    max_steps : the episode's own budget if None
    noise, seed : simulated actuation errors; without noise the steps equal Habitat's

    Attributes
    ----------
    task : the episode
    steps : actions taken so far
    stopped : STOP was taken
    """

    def __init__(
        self,
        task: Task,
        pathfinder: Pathfinder,
        *,
        space: ActionSpace = VLN_CE,
        sliding: bool = True,
        max_steps: int | None = None,
        noise: NoiseConfig | None = None,
        seed: int = 0,
    ) -> None:
        self.task = task
        self.limit = task.max_steps if max_steps is None else max_steps
        self.steps = 0
        self.stopped = False
        self._space = space
        self._pathfinder, self._sliding, self._seed = pathfinder, sliding, seed
        self._noise = noise if noise is not None and (noise.step or noise.turn) else None
        self._agent = Follower(pathfinder, space, sliding=sliding).stepped(task.start, heading_of(task.start_rotation))
        self._positions: list[npt.NDArray[np.float32]] = [self._agent.position]
        self._headings: list[float] = [self._agent.heading]
        self._collisions: list[bool] = [False]

    @property
    def position(self) -> F64:
        """The agent's position (3,) in metres, in Habitat's frame."""
        return self._positions[-1].astype(np.float64)

    @property
    def heading(self) -> float:
        """The agent's heading in radians, counter-clockwise from −z."""
        return self._headings[-1]

    @property
    def collided(self) -> bool:
        """Whether the last forward step collided."""
        return self._collisions[-1]

    @property
    def collisions(self) -> int:
        """Number of forward steps that collided so far."""
        return sum(self._collisions)

    @property
    def out_of_steps(self) -> bool:
        """Whether the step budget is used up."""
        return self.steps >= self.limit

    def take(self, action: int) -> None:
        """Take one action: STOP 0, FORWARD 1, LEFT 2 or RIGHT 3.

        Raises
        ------
        UsageError : the action is unknown, or the episode is over
        """
        if action not in (STOP, FORWARD, LEFT, RIGHT):
            raise UsageError(
                f"{action!r} is not an action", place=f"episode {self.task.episode_id}", remedy="Answer 0, 1, 2 or 3"
            )
        if self.stopped or self.out_of_steps:
            raise UsageError(
                "the episode is over", place=f"episode {self.task.episode_id}", remedy="Start another episode"
            )
        before = self._positions[-1]
        if self._noise is None:
            self._agent.take(action)
            after, heading = self._agent.position, self._agent.heading
        else:
            after, heading = self._stagger(action, self._noise)
        self.stopped = action == STOP
        self.steps += 1
        moved = float(np.linalg.norm(after - before))
        self._positions.append(after)
        self._headings.append(heading)
        self._collisions.append(action == FORWARD and moved < self._space.forward - _BLOCKED)

    def prediction(self) -> Prediction:
        """The trajectory so far, in the form that is scored and written."""
        return Prediction(
            self.task.episode_id,
            np.array(self._positions, dtype=np.float64),
            self.stopped,
            True,
            np.array(self._collisions),
            np.array(self._headings),
        )

    def _stagger(self, action: int, noise: NoiseConfig) -> tuple[npt.NDArray[np.float32], float]:
        """Return the agent's position and heading after an action, with simulated actuation noise."""
        names = (self.task.episode_id, self.steps)
        forward, turn = noisy_move(self._space.forward, math.radians(self._space.turn), noise, self._seed, names)
        place, heading = self._positions[-1], self._headings[-1]
        if action == FORWARD:
            ahead = place + np.array([-math.sin(heading), 0.0, -math.cos(heading)]) * forward
            step = self._pathfinder.try_step if self._sliding else self._pathfinder.try_step_no_sliding
            place = np.asarray(step(place, ahead), np.float32)
        elif action in (LEFT, RIGHT):
            heading = (heading + (turn if action == LEFT else -turn)) % (2 * math.pi)
        return place, heading
