"""A gymnasium environment over a split of an export: VLN-CE's actions and step budget, cameras, text and poses."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from condvln.evaluation.goal_distances import Nearness
from condvln.evaluation.measures import path_length
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.scene_views import SCENES_KEPT, SceneViews
from condvln.evaluation.score import TOLD_AFTER_STOP, ScoreRules, score
from condvln.evaluation.split import Export, open_export
from condvln.evaluation.task import Task
from condvln.evaluation.walker import SteppedEpisode
from condvln.scene.rotations import heading_of
from condvln.sensors import PRESETS, TextSensor, cameras_of, noisy_pose
from condvln.sources.scene_source import Source
from schemas.config import CameraConfig, NoiseConfig
from schemas.errors import UsageError

__all__ = ["NavigationEnv"]

LONGEST_TEXT: Final = 8192
"""Largest length in characters of a text observation; longer ones are cut."""
CHARACTERS: Final = frozenset(map(chr, range(32, 127))) | {"\n", "°"}

Observation = dict[str, Any]


class NavigationEnv(gymnasium.Env[Observation, np.int64]):
    """A gymnasium environment over the episodes of one split, in sequence.

    Actions are VLN-CE's: 0 STOP, 1 forward 0.25 m, 2 left 15°, 3 right 15°. STOP ends an episode (terminated), and so
    does an exhausted step budget (truncated). The reward is 1 for a STOP within the success distance of the gold leaf,
    else 0.

    An observation has ``instruction``; ``gps`` (2,), metres ahead and to the right of the start, and ``compass`` (1,),
    radians counter-clockwise from the first heading, as habitat-lab's; ``text`` if requested; and each camera's image
    (depth as (h, w, 1)). It contains no ground truth.

    ``info`` has the episode, its scene and VLN-CE's measures so far; at the end ``score``, all measures of
    :func:`condvln.evaluation.score.score` with None where one is undefined, those of leaves after STOP only.

    Parameters
    ----------
    export, split : an export, or its folder, and one of its splits
    cameras : a preset's name, or cameras by name (which begins with the modality); None for no cameras
    text : whether to give the text sensor's observation
    sources : the dataset of each family, or its folder; needed for cameras and text
    roots : folders of the datasets whose navmeshes the export does not hold, if `export` is a folder
    noise : simulated errors of detector, pose estimate and actuation; None for none
    shuffle : whether a `reset` with a seed also draws the order of the episodes; else it is the manifest's
    scenes_kept : number of scenes that are kept open

    Raises
    ------
    UsageError : an unknown preset, an empty split
    MissingFileError, FormatError : as `open_export`
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012  gymnasium's own form

    def __init__(
        self,
        export: Export | str | os.PathLike[str],
        split: str,
        *,
        cameras: str | Mapping[str, CameraConfig] | None = "vlnce",
        text: bool = False,
        sources: Mapping[str, Source | str | os.PathLike[str]] | None = None,
        roots: tuple[str | os.PathLike[str], ...] = (),
        noise: NoiseConfig | None = None,
        rules: ScoreRules | None = None,
        shuffle: bool = False,
        scenes_kept: int = SCENES_KEPT,
        render_mode: Literal["rgb_array"] | None = None,
    ) -> None:
        self.export = export if isinstance(export, Export) else open_export(export, roots)
        self.render_mode = render_mode
        self._tasks = self.export.tasks(split)
        if not self._tasks:
            raise UsageError(f"the split {split!r} has no episodes", remedy="Choose another split")
        self._number = {name: k for k, task in enumerate(self._tasks) for name in (task.episode_id, *task.aliases)}
        self._cameras = dict(cameras_of(cameras) if isinstance(cameras, str) else cameras or {})
        self._text, self._noise, self._rules, self._shuffle = text, noise, rules or ScoreRules(), shuffle
        self._views = SceneViews(sources or {}, scenes_kept)
        self._sensors: tuple[str, TextSensor] | None = None
        self._order = np.arange(len(self._tasks))
        self._next = 0
        self._seed = 0
        self._episode: SteppedEpisode | None = None
        self._nearness: Nearness | None = None
        self.action_space = spaces.Discrete(4)
        self.observation_space = spaces.Dict(self._spaces())

    @property
    def episode_ids(self) -> tuple[str, ...]:
        """Ids of the split's episodes, in the order of its manifest."""
        return tuple(task.episode_id for task in self._tasks)

    @property
    def prediction(self) -> Prediction:
        """The current episode's trajectory so far, in the form that `write_predictions` writes and `evaluate`
        scores.
        """
        return self._walk().prediction()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the episode named by ``options["episode_id"]``, or else the next one.

        A seed restarts the order of episodes; equal seeds give equal episodes and equal noise.

        Raises
        ------
        UsageError : there is no such episode, or an option is unknown
        """
        super().reset(seed=seed)
        if seed is not None:
            self._seed, self._next = seed, 0
            self._order = self.np_random.permutation(len(self._tasks)) if self._shuffle else np.arange(len(self._tasks))
        unknown = set(options or {}) - {"episode_id"}
        if unknown:
            raise UsageError(f"unknown option {sorted(unknown)[0]!r}", remedy="The only option is episode_id")
        asked = (options or {}).get("episode_id")
        if asked is None:
            task = self._tasks[int(self._order[self._next % len(self._order)])]
            self._next += 1
        elif str(asked) in self._number:
            task = self._tasks[self._number[str(asked)]]
        else:
            raise UsageError(
                f"the split has no episode {asked!r}", remedy="Choose one of the environment's episode_ids"
            )
        pathfinder = self.export.pathfinder(task)
        self._nearness = Nearness(pathfinder)
        self._episode = SteppedEpisode(task, pathfinder, noise=self._noise, seed=self._seed)
        return self._observation(), self._info()

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take one action.

        Raises
        ------
        UsageError : the action is unknown, or the episode is over
        """
        episode = self._walk()
        episode.take(int(action))
        terminated, truncated = episode.stopped, episode.out_of_steps and not episode.stopped
        info = self._info()
        reward = 0.0
        if terminated or truncated:
            assert self._nearness is not None
            measures = asdict(score(episode.task, episode.prediction(), self._nearness, self._rules))
            told = {k: v for k, v in measures.items() if terminated or k not in TOLD_AFTER_STOP}
            info["score"] = {k: None if math.isnan(v) else v for k, v in told.items()}
            reward = float(measures["success"])
        return self._observation(), reward, terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """Return the agent's view as an image (480, 640, 3); None unless the render mode is rgb_array."""
        if self.render_mode is None:
            return None
        episode = self._walk()
        camera = PRESETS["streamvln"]["rgb"]
        return self._views(str(episode.task.axes["scene"])).renderer.look(camera, episode.position, episode.heading).rgb

    def _walk(self) -> SteppedEpisode:
        if self._episode is None:
            raise UsageError("no episode has begun", remedy="Call reset first")
        return self._episode

    def _spaces(self) -> dict[str, spaces.Space[Any]]:
        texts = [task.text for task in self._tasks]
        letters = "".join(sorted(CHARACTERS | set("".join(texts))))
        found: dict[str, spaces.Space[Any]] = {
            "instruction": spaces.Text(max(map(len, texts)), min_length=0, charset=letters),
            "gps": spaces.Box(-np.inf, np.inf, (2,), np.float32),
            "compass": spaces.Box(-np.pi, np.pi, (1,), np.float32),
        }
        if self._text:
            found["text"] = spaces.Text(LONGEST_TEXT, min_length=0, charset=letters)
        for name, camera in self._cameras.items():
            found[name] = _image_space(name, camera)
        return found

    def _observation(self) -> Observation:
        episode = self._walk()
        task = episode.task
        names = (task.episode_id, episode.steps)
        position, heading = episode.position, episode.heading
        if self._noise is not None:
            position, heading = noisy_pose(position, heading, self._noise, self._seed, names)
        seen: Observation = {"instruction": task.text} | _pose(task, position, heading)
        scene = str(task.axes["scene"])
        if self._text:
            told = str(
                self._text_sensor(scene).observe(episode.position, episode.heading, seed=self._seed, names=names)
            )
            seen["text"] = "".join(c if c in self._letters else "?" for c in told[:LONGEST_TEXT])
        if self._cameras:
            images = self._views(scene).renderer.observe(self._cameras, episode.position, episode.heading)
            seen |= {name: image[..., None] if name.startswith("depth") else image for name, image in images.items()}
        return seen

    @property
    def _letters(self) -> frozenset[str]:
        space = self.observation_space["text"]  # type: ignore[index]
        return frozenset(space.characters)

    def _text_sensor(self, scene: str) -> TextSensor:
        if self._sensors is None or self._sensors[0] != scene:
            view = self._views(scene)
            self._sensors = scene, TextSensor(view.scene, view.renderer, noise=self._noise)
        return self._sensors[1]

    def _info(self) -> dict[str, Any]:
        episode, nearness = self._walk(), self._nearness
        assert nearness is not None
        walked = episode.prediction()
        return {
            "episode_id": episode.task.episode_id,
            "scene": str(episode.task.axes["scene"]),
            "step": episode.steps,
            "max_steps": episode.limit,
            "distance_to_goal": nearness.distance(walked.positions[-1], episode.task.gold.goals),
            "path_length": path_length(walked.positions),
            "collided": episode.collided,
            "collisions": episode.collisions,
        }


def _image_space(name: str, camera: CameraConfig) -> spaces.Box:
    shape = camera.height, camera.width
    if name.startswith("rgb"):
        return spaces.Box(0, 255, (*shape, 3), np.uint8)
    if name.startswith("depth"):
        high = 1.0 if camera.normalized else camera.max_depth or np.inf
        return spaces.Box(0.0, high, (*shape, 1), np.float32)
    return spaces.Box(0, np.iinfo(np.int32).max, shape, np.int32)


def _pose(task: Task, position: NDArray[np.float64], heading: float) -> Observation:
    """Return ``gps`` and ``compass`` in the frame of the start pose."""
    first = heading_of(task.start_rotation)
    east, south = (position - task.start)[[0, 2]]
    ahead = -math.sin(first) * east - math.cos(first) * south
    right = math.cos(first) * east - math.sin(first) * south
    turned = (heading - first + math.pi) % (2 * math.pi) - math.pi
    return {"gps": np.array([ahead, right], np.float32), "compass": np.array([turned], np.float32)}
