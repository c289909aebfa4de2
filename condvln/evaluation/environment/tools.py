"""Episodes as tools for language agents: plain methods with typed docstrings, without dependencies.

A trainer creates an instance without arguments, calls ``reset(**row)``, and shows the model ``forward``, ``turn``,
``look`` and ``stop``. They return what the agent sees as text, without any ground truth of the episode.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isnan, radians
from typing import Any, ClassVar

import numpy as np

from condvln.evaluation.predictions import Prediction
from condvln.evaluation.scene_views import SceneViews
from condvln.evaluation.score import TOLD_AFTER_STOP, score
from condvln.evaluation.split import Export, open_export
from condvln.evaluation.task import Task
from condvln.evaluation.walker import SteppedEpisode
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, VLN_CE
from condvln.sensors import KnownMap, TextObservation, TextSensor
from condvln.sources.scene_source import Source
from schemas.config import NoiseConfig
from schemas.errors import UsageError

__all__ = ["EpisodeTools", "tools_for"]

_SIDES = ((0, "ahead"), (-90, "on your left"), (180, "behind you"), (90, "on your right"))


@dataclass(frozen=True, eq=False)
class _Split:
    """State shared by all tools of one split."""

    export: Export
    tasks: Mapping[str, Task]
    views: SceneViews
    noise: NoiseConfig | None
    seed: int


class EpisodeTools:
    """The tools of one episode at a time; `tools_for` makes the class for a split.

    Attributes
    ----------
    episode_ids : the split's ids, in the order of its manifest
    reward : 1.0 after a `stop` within the success distance of the gold leaf, else 0.0
    done : the episode is over, by `stop` or an exhausted step budget
    score : all measures after the episode, None if undefined; empty before
    prediction : the trajectory, in the form that `write_predictions` writes and `evaluate` scores
    """

    episode_ids: ClassVar[tuple[str, ...]] = ()
    _split: ClassVar[_Split]

    def __init__(self) -> None:
        self.reward = 0.0
        self.done = True
        self.score: dict[str, float | None] = {}
        self._episode: SteppedEpisode | None = None
        self._sensor: TextSensor | None = None
        self._known = KnownMap()
        self._turn = 0

    # Trainers read all attributes of a new instance before any episode.
    @property
    def prediction(self) -> Prediction:
        """The trajectory so far; it has no poses before the first episode."""
        if self._episode is None:
            return Prediction("", np.empty((0, 3)), False, True, None, None)
        return self._episode.prediction()

    @property
    def instruction(self) -> str:
        """The text to follow; empty before the first episode."""
        return "" if self._episode is None else self._episode.task.text

    @property
    def episode_id(self) -> str:
        """Id of the current episode; empty before the first."""
        return "" if self._episode is None else self._episode.task.episode_id

    @property
    def steps_left(self) -> int:
        """Number of steps left in the budget."""
        return 0 if self._episode is None else self._episode.limit - self._episode.steps

    def reset(self, episode_id: str | int | None = None, **row: Any) -> str:
        """Begin the episode `episode_id`, or the next one of the split if no id is given.

        Other values of a row of a dataset are not looked at.
        """
        own = self._split
        if episode_id is None:
            episode_id = self.episode_ids[self._turn % len(self.episode_ids)]
            self._turn += 1
        task = own.tasks.get(str(episode_id))
        if task is None:
            raise UsageError(
                f"the split has no episode {episode_id!r}", remedy="Use an episode id of the split's manifest"
            )
        view = own.views(str(task.axes["scene"]))
        self._sensor = TextSensor(view.scene, view.renderer, noise=own.noise)
        self._episode = SteppedEpisode(task, own.export.pathfinder(task), noise=own.noise, seed=own.seed)
        self._known, self.reward, self.done, self.score = KnownMap(), 0.0, False, {}
        return (
            f"{task.text}\n\nYou may take {self.steps_left} steps; one step is 0.25 m forward or a turn of 15°. "
            f"Say stop when you are there.\n\n{self._seen()}"
        )

    def forward(self, steps: int = 1) -> str:
        """
        Walk straight ahead. One step is 0.25 m.

        Args:
            steps: How many steps to take, from 1 to 40.

        Returns:
            What you see now, or that something is in the way.
        """
        if not 1 <= steps <= 40:
            raise ValueError(f"steps is {steps}; it must be from 1 to 40")
        walk = self._running()
        for taken in range(steps):
            walk.take(FORWARD)
            if walk.collided:
                self._close()
                return f"Something is in the way after {taken} steps.\n{self._seen()}"
            if walk.out_of_steps:
                break
        self._close()
        return self._seen()

    def turn(self, degrees: int) -> str:
        """
        Turn on the spot.

        Args:
            degrees: How far to turn: positive to the right, negative to the left, a multiple of 15 up to 180.

        Returns:
            What you see now.
        """
        unit = round(VLN_CE.turn)
        if degrees % unit or not 0 < abs(degrees) <= 180:
            raise ValueError(f"degrees is {degrees}; it must be a multiple of {unit}, from -180 to 180, and not 0")
        walk = self._running()
        for _ in range(abs(degrees) // unit):
            walk.take(RIGHT if degrees > 0 else LEFT)
            if walk.out_of_steps:
                break
        self._close()
        return self._seen()

    def look(self) -> str:
        """
        Look all around without moving. It takes no step.

        Returns:
            The things that you see on each side, and those that you have seen so far by room.
        """
        walk = self._running()
        lines = []
        for degrees, side in _SIDES:
            seen = self._observe(walk, degrees)
            things = "; ".join(str(thing) for thing in seen.things) or "nothing that has a name"
            lines.append(f"{side.capitalize()}: {things}.")
        return "\n".join([*lines, str(self._known)])

    def stop(self) -> str:
        """
        End the episode here. Use it once, where the instruction leads.

        Returns:
            That the episode is over.
        """
        self._running().take(STOP)
        self._close()
        return "The episode is over."

    def _observe(self, walk: SteppedEpisode, degrees: int = 0) -> TextObservation:
        assert self._sensor is not None
        heading = walk.heading - radians(degrees)
        names = (walk.task.episode_id, walk.steps, degrees)
        seen = self._sensor.observe(walk.position, heading, seed=self._split.seed, names=names)
        self._known.add(seen, walk.position, heading)
        return seen

    def _seen(self) -> str:
        walk = self._walk()
        over = "" if not self.done else "\nThe episode is over: no steps are left."
        return f"{self._observe(walk)}\nSteps left: {self.steps_left}.{over}"

    def _close(self) -> None:
        walk = self._walk()
        self.done = walk.stopped or walk.out_of_steps
        if self.done:
            measures = asdict(score(walk.task, walk.prediction(), self._split.export.pathfinder(walk.task)))
            told = {name: value for name, value in measures.items() if walk.stopped or name not in TOLD_AFTER_STOP}
            self.score = {name: None if isnan(value) else value for name, value in told.items()}
            self.reward = float(measures["success"])

    def _running(self) -> SteppedEpisode:
        walk = self._walk()
        if self.done:
            raise UsageError("the episode is over", remedy="Begin another one")
        return walk

    def _walk(self) -> SteppedEpisode:
        if self._episode is None:
            raise UsageError("no episode has begun", remedy="Call reset first")
        return self._episode


def tools_for(
    export: Export | str | os.PathLike[str],
    split: str,
    sources: Mapping[str, Source | str | os.PathLike[str]],
    *,
    roots: tuple[str | os.PathLike[str], ...] = (),
    noise: NoiseConfig | None = None,
    seed: int = 0,
) -> type[EpisodeTools]:
    """Return the class of tools for a split; its constructor takes no arguments, as trainers expect.

    Parameters
    ----------
    export, split : an export, or its folder, and one of its splits
    sources : the dataset of each family, or its folder
    roots : further folders with navmeshes that the export does not contain, if `export` is a folder
    noise, seed : simulated errors of detector and actuation; None for none

    Raises
    ------
    UsageError : the split is empty
    MissingFileError, FormatError : as for `open_export`
    """
    folders = tuple(source for source in sources.values() if isinstance(source, str | os.PathLike))
    opened = export if isinstance(export, Export) else open_export(export, (*roots, *folders))
    tasks = opened.tasks(split)
    if not tasks:
        raise UsageError(f"the split {split!r} has no episodes", remedy="Choose another split")
    by_name = {name: task for task in tasks for name in (task.episode_id, *task.aliases)}
    own = {
        "_split": _Split(opened, by_name, SceneViews(sources), noise, seed),
        "episode_ids": tuple(task.episode_id for task in tasks),
        "__doc__": EpisodeTools.__doc__,
    }
    return type("EpisodeTools", (EpisodeTools,), own)
