"""The layout of InternVLA-N1: one LeRobot v2.1 folder for each scene, with pixel goals.

Its loader reads the tables and the image files itself. LeRobot's own reader opens a folder, too, for what
``meta/info.json`` describes: everything but the images, which it would want in tables or videos.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from condvln.sensors.camera import camera_pose
from condvln.trajectories.cameras import MAIN, N1_SETTINGS, setting
from condvln.trajectories.hub import AddScene, Hub, SceneWalks
from condvln.trajectories.layouts import link, new_folder
from condvln.trajectories.walks import point_of
from schemas.config import CameraConfig

__all__ = ["camera_to_world", "internvla_n1"]

VERSION: Final = "v2.1"
CHUNK: Final = 1000
"""Episodes of a folder."""
_RGB: Final = "observation.images.rgb"
_DEPTH: Final = "observation.images.depth"


@contextmanager
def internvla_n1(hub: Hub) -> Iterator[AddScene]:
    """Write one LeRobot v2.1 folder for each scene below ``internvla-n1/``; the images in these folders are links to
    the hub's images.

    The level camera is the hub's main one if its height is the same.
    """
    main = hub.cameras[MAIN]
    level, down = (main.model_copy(update={"eye_height": height, "look_down": pitch}) for height, pitch in N1_SETTINGS)
    folders = {
        name: f"{_DEPTH if name.startswith('depth') else _RGB}.{setting(camera)}"
        for name, camera in hub.cameras.items()
        if camera in (level, down)
    }
    with new_folder(hub.folder / "internvla-n1") as part:

        def add(scene: SceneWalks) -> None:
            if scene.tables["trajectories"].num_rows:
                target = part / f"{scene.source}-{scene.scene_id.replace('/', '-')}"
                _write_scene(hub, target, scene, folders, down)

        yield add


def _write_scene(hub: Hub, target: Path, scene: SceneWalks, folders: Mapping[str, str], down: CameraConfig) -> None:
    """Write the folder of one scene.

    folders : of the images, by the name of the camera
    down : the camera whose poses and pixel goals the tables hold
    """
    poses: dict[str, list[dict[str, Any]]] = {}
    for row in scene.tables["poses"].to_pylist():
        poses.setdefault(row["trajectory"], []).append(row)
    meta = target / "meta"
    meta.mkdir(parents=True)
    lines: list[dict[str, Any]] = []
    stats: list[dict[str, Any]] = []
    features: dict[str, Any] = {}
    frames = 0
    tasks: dict[str, int] = {}
    for number, row in enumerate(scene.trajectories()):
        text = row["instruction_text"]
        task = tasks.setdefault(text, len(tasks))
        own = poses[row["frames_of"]]
        columns = _write_walk(target, number, row, own, down, task, frames)
        frames += row["n_frames"]
        features = features or {name: _feature(values) for name, values in columns.items()}
        stats.append({"episode_index": number, "stats": {name: _stats(one) for name, one in columns.items()}})
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
        for pose in own:
            if pose["camera"] in folders:
                image = hub.folder / pose["image"]
                place = target / "videos" / f"chunk-{number // CHUNK:03d}" / folders[pose["camera"]]
                place.mkdir(parents=True, exist_ok=True)
                link(image, place / f"episode_{number:06d}_{pose['frame']}{image.suffix}")
    _jsonl(meta / "episodes.jsonl", lines)
    _jsonl(meta / "tasks.jsonl", [{"task_index": index, "task": task} for task, index in tasks.items()])
    _jsonl(meta / "episodes_stats.jsonl", stats)
    features["action"]["info"] = {"forward_metres": hub.space.forward, "turn_degrees": hub.space.turn}
    info = {
        "codebase_version": VERSION,
        "robot_type": "condvln",
        "total_episodes": len(lines),
        "total_frames": frames,
        "total_tasks": len(tasks),
        "total_videos": 0,
        "total_chunks": (len(lines) - 1) // CHUNK + 1,
        "chunks_size": CHUNK,
        "fps": 1,
        "splits": {hub.split: f"0:{len(lines)}"},
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": None,
        "features": features,
    }
    (meta / "info.json").write_bytes(orjson.dumps(info, option=orjson.OPT_INDENT_2) + b"\n")


def _write_walk(
    target: Path,
    number: int,
    row: Mapping[str, Any],
    poses: list[dict[str, Any]],
    down: CameraConfig,
    task: int,
    first: int,
) -> dict[str, NDArray[Any]]:
    """Write the table of a walk; return its columns.

    task, first : number of the walk's task, and of its first frame among those of the scene
    """
    name = setting(down)
    seen = sorted((pose for pose in poses if pose["camera"] == f"depth.{name}"), key=lambda pose: pose["frame"])
    count = row["n_frames"]
    places = [camera_to_world(down, point_of(pose["position"]), pose["heading"]) for pose in seen]
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
            "index": pa.array(np.arange(first, first + count, dtype=np.int64)),
            "task_index": pa.array([task] * count, pa.int64()),
        }
    )
    path = target / "data" / f"chunk-{number // CHUNK:03d}" / f"episode_{number:06d}.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)
    return {
        name: np.array(column.to_pylist(), np.float32 if name == "timestamp" else None)
        for name, column in zip(table.column_names, table.columns, strict=True)
    }


def camera_to_world(camera: CameraConfig, place: NDArray[np.float64], heading: float) -> NDArray[np.float64]:
    """Return the matrix (4, 4) from camera coordinates (x right, y down, z ahead) to Habitat's frame, metres."""
    eye, axes = camera_pose(camera, place, heading)
    matrix = np.eye(4)
    matrix[:3, :3] = axes * np.array([1.0, -1.0, -1.0])
    matrix[:3, 3] = eye
    return matrix


def _feature(values: NDArray[Any]) -> dict[str, Any]:
    """Return the description of a feature, in LeRobot's form, from its values (n, …)."""
    return {"dtype": values.dtype.name, "shape": [*values.shape[1:]] or [1], "names": None}


def _stats(values: NDArray[Any]) -> dict[str, list[Any]]:
    """Return the statistics of a walk's values (n, …), in LeRobot's form."""
    numbers = values.astype(np.float64).reshape(len(values), *(values.shape[1:] or (1,)))
    found = {"min": numbers.min(0), "max": numbers.max(0), "mean": numbers.mean(0), "std": numbers.std(0)}
    return {name: one.tolist() for name, one in found.items()} | {"count": [len(values)]}


def _jsonl(path: Path, rows: list[dict[str, Any]]) -> None:
    path.write_bytes(b"".join(orjson.dumps(row) + b"\n" for row in rows))
