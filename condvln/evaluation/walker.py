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

from condvln.evaluation.predictions import Prediction
from condvln.evaluation.stepped_episode import SteppedEpisode, heading_of
from condvln.evaluation.task import Task
from condvln.navigation.follower import VLN_CE, ActionSpace
from condvln.navigation.pathfinder import Pathfinder

__all__ = ["Eyes", "Observation", "Policy", "SeenObject", "heading_of", "labels_in_view", "walk"]

Points = npt.NDArray[np.float64]

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
    position: Points
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


Eyes = Callable[[Task, Points, float], tuple[str, ...]]
"""Returns the labels in view from a position and heading."""


def labels_in_view(
    objects: Mapping[str, Sequence[SeenObject]],
    pathfinder_of: Callable[[Task], Pathfinder],
    *,
    sight: float = SIGHT,
    field_of_view: float = FIELD_OF_VIEW,
) -> Eyes:
    """Return a function that returns the labels of the objects in view: those within ``sight`` metres and within the
    horizontal ``field_of_view`` in degrees.

    There is no rendering, so occlusion is estimated: an object is hidden if its geodesic distance is much longer than
    its straight-line distance.

    Parameters
    ----------
    objects : by scene, as in the axis ``scene`` (``<source>/<scene id>``)
    """
    cosine = math.cos(math.radians(field_of_view / 2))

    def look(task: Task, position: Points, heading: float) -> tuple[str, ...]:
        seen = objects.get(str(task.axes["scene"]), ())
        if not seen:
            return ()
        centers = np.array([thing.center for thing in seen])
        away = centers - position
        flat = np.hypot(away[:, 0], away[:, 2])
        ahead = away[:, 0] * -math.sin(heading) + away[:, 2] * -math.cos(heading)
        near = (np.sqrt(np.square(away).sum(axis=1)) <= sight) & (ahead >= flat * cosine)
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
