"""The layout of InternVLA-N1: one LeRobot v2.1 folder for each scene, with pixel goals."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as pq

from condvln.trajectories.cameras import MAIN, N1_SETTINGS, Cameras, setting
from condvln.trajectories.hub import SceneWalks
from condvln.trajectories.layouts import AddScene, link, new_folder
from condvln.trajectories.pixel_goals import camera_to_world
from condvln.trajectories.tables import point_of
from schemas.config import CameraConfig

__all__ = ["internvla_n1"]

CHUNK: Final = 1000
"""Episodes of a folder."""
_RGB: Final = "observation.images.rgb"
_DEPTH: Final = "observation.images.depth"


@contextmanager
def internvla_n1(folder: Path, split: str, cameras: Cameras) -> Iterator[AddScene]:
    """Write one LeRobot v2.1 folder for each scene below ``internvla-n1/``; the images in these folders are links to
    the hub's images.

    The level camera is the hub's main one if its height is the same.
    """
    main = cameras[MAIN]
    level, down = (main.model_copy(update={"eye_height": height, "look_down": pitch}) for height, pitch in N1_SETTINGS)
    names = {name: camera for name, camera in cameras.items() if camera in (level, down)}
    with new_folder(folder / "internvla-n1") as part:

        def add(scene: SceneWalks) -> None:
            _Scene(folder, part / f"{scene.source}-{scene.scene_id.replace('/', '-')}", names, down).write(scene)

        yield add


class _Scene:
    """Writes the folder of one scene."""

    def __init__(self, folder: Path, target: Path, cameras: Cameras, down: CameraConfig) -> None:
        self._folder, self._target, self._cameras, self._down = folder, target, cameras, down

    def write(self, scene: SceneWalks) -> None:
        if not scene.tables["trajectories"].num_rows:
            return
        poses: dict[str, list[dict[str, Any]]] = {}
        for row in scene.tables["poses"].to_pylist():
            poses.setdefault(row["trajectory"], []).append(row)
        (self._target / "meta").mkdir(parents=True)
        lines: list[dict[str, Any]] = []
        tasks: dict[str, int] = {}
        for number, row in enumerate(scene.trajectories()):
            text = row["instruction_text"]
            tasks.setdefault(text, len(tasks))
            own = poses[row["frames_of"]]
            self._data(number, row, own, tasks[text])
            self._images(number, own)
            lines.append(
                {
                    "episode_index": number,
                    "tasks": [text],
                    "length": row["n_frames"],
                    "episode_id": row["episode_id"],
                    "trajectory": row["trajectory"],
                    "kind": row["kind"],
                }
            )
        _jsonl(self._target / "meta" / "episodes.jsonl", lines)
        _jsonl(
            self._target / "meta" / "tasks.jsonl",
            [{"task_index": index, "task": task} for task, index in tasks.items()],
        )

    def _data(self, number: int, row: dict[str, Any], poses: list[dict[str, Any]], task: int) -> None:
        name = setting(self._down)
        seen = sorted((pose for pose in poses if pose["camera"] == f"depth.{name}"), key=lambda pose: pose["frame"])
        count = row["n_frames"]
        places = [camera_to_world(self._down, point_of(pose["position"]), pose["heading"]) for pose in seen]
        goals = [pose["goal"] or [-1, -1] for pose in seen]
        frames = [-1 if pose["goal_frame"] is None else pose["goal_frame"] for pose in seen]
        table = pa.table(
            {
                "action": pa.array([-1, *row["actions"][:-1]], pa.int64()),
                f"pose.{name}": pa.array([place.tolist() for place in places], pa.list_(pa.list_(pa.float64()))),
                f"goal.{name}": pa.array(goals, pa.list_(pa.int64())),
                f"relative_goal_frame_id.{name}": pa.array(frames, pa.int64()),
                "timestamp": pa.array(np.arange(count, dtype=np.float32)),
                "frame_index": pa.array(np.arange(count, dtype=np.int64)),
                "episode_index": pa.array([number] * count, pa.int64()),
                "task_index": pa.array([task] * count, pa.int64()),
            }
        )
        path = self._target / "data" / f"chunk-{number // CHUNK:03d}" / f"episode_{number:06d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table, path)

    def _images(self, number: int, poses: list[dict[str, Any]]) -> None:
        chunk = self._target / "videos" / f"chunk-{number // CHUNK:03d}"
        for pose in poses:
            name = str(pose["camera"])
            if name not in self._cameras:
                continue
            kind = _DEPTH if name.startswith("depth") else _RGB
            image = self._folder / str(pose["image"])
            target = chunk / f"{kind}.{setting(self._cameras[name])}" / f"episode_{number:06d}_{pose['frame']}"
            target.parent.mkdir(parents=True, exist_ok=True)
            link(image, target.with_name(target.name + image.suffix))


def _jsonl(path: Path, rows: list[dict[str, Any]]) -> None:
    path.write_bytes(b"".join(orjson.dumps(row) + b"\n" for row in rows))
