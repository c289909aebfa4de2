"""Prove the layouts that are LeRobot datasets: that of InternVLA-N1 (v2.1) and LeRobot's own (v3.0)."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from condvln.formats.regular_file import read_regular
from condvln.verify.layout_files import Counts, Faults, Row, jsonl, linked, scenes_with_poses

__all__ = ["internvla_faults", "lerobot_faults"]

_PAIR: Final = {"125cm_0deg": (1.25, 0.0), "125cm_30deg": (1.25, 30.0)}
_DOWN: Final = "125cm_30deg"


def internvla_faults(folder: Path, record: Row, walks: Sequence[Row], counts: Counts) -> Faults:
    """Yield what is wrong with InternVLA-N1's folders: a LeRobot v2.1 dataset for each scene."""
    main = record["cameras"]["rgb"]
    images = {
        f"{'observation.images.depth' if name.startswith('depth') else 'observation.images.rgb'}.{setting}": name
        for name, camera in record["cameras"].items()
        for setting, (height, pitch) in _PAIR.items()
        if camera == {**main, "eye_height": height, "look_down": pitch}
    }
    names: list[str] = []
    for key, own, poses in scenes_with_poses(folder, walks):
        names.append(f"{key[0]}-{key[1].replace('/', '-')}")
        yield from _internvla_scene(folder, folder / "internvla-n1" / names[-1], own, poses, images, counts)
    if {path.name for path in (folder / "internvla-n1").iterdir()} != set(names):
        yield "", "the folders are not those of the scenes"


def _internvla_scene(
    folder: Path,
    target: Path,
    walks: Sequence[Row],
    poses: Sequence[Row],
    images: Mapping[str, str],
    counts: Counts,
) -> Faults:
    tasks: dict[str, int] = {}
    for walk in walks:
        tasks.setdefault(walk["instruction_text"], len(tasks))
    lines = [
        {
            "episode_index": number,
            "tasks": [walk["instruction_text"]],
            "length": walk["n_frames"],
            **{key: walk[key] for key in ("episode_id", "trajectory", "kind")},
        }
        for number, walk in enumerate(walks)
    ]
    if jsonl(target / "meta" / "episodes.jsonl") != lines:
        yield "", f"{target.name}: episodes.jsonl is not that of the walks"
    wanted = [{"task_index": index, "task": task} for task, index in tasks.items()]
    if jsonl(target / "meta" / "tasks.jsonl") != wanted:
        yield "", f"{target.name}: tasks.jsonl is not that of the walks"
    of_walk: dict[str, list[Row]] = {}
    for pose in poses:
        if pose["camera"] == f"depth.{_DOWN}":
            of_walk.setdefault(pose["trajectory"], []).append(pose)
    files: dict[str, dict[str, str]] = {}
    for number, walk in enumerate(walks):
        chunk = f"chunk-{number // 1000:03d}"
        path = target / "data" / chunk / f"episode_{number:06d}.parquet"
        counts["internvla-n1"] += walk["n_frames"]
        if not _is_internvla(pq.read_table(path), walk, of_walk[walk["frames_of"]], number, tasks):
            yield walk["trajectory"], f"{path.relative_to(target.parent)} is not that of the walk"
            if pq.read_metadata(path).num_rows != walk["n_frames"]:
                return
        for kind, camera in images.items():
            suffix = "png" if camera.startswith("depth") else "jpg"
            files.setdefault(f"videos/{chunk}/{kind}", {}).update(
                {
                    f"episode_{number:06d}_{k}.{suffix}": f"images/{walk['frames_of']}/{camera}/{k + 1:03d}.{suffix}"
                    for k in range(walk["n_frames"])
                }
            )
    for place, expected in files.items():
        yield from linked(folder, target / place, expected, "")


def _is_internvla(table: pa.Table, walk: Row, poses: Sequence[Row], number: int, tasks: Mapping[str, int]) -> bool:
    count = walk["n_frames"]
    if table.num_rows != count or len(poses) != count:
        return False
    found = table.to_pydict()
    matrices = np.array(found.pop(f"pose.{_DOWN}"), np.float64)
    expected = {
        "action": [-1, *walk["actions"][:-1]],
        f"goal.{_DOWN}": [pose["goal"] or [-1, -1] for pose in poses],
        f"relative_goal_frame_id.{_DOWN}": [-1 if pose["goal_frame"] is None else pose["goal_frame"] for pose in poses],
        "timestamp": [float(k) for k in range(count)],
        "frame_index": [*range(count)],
        "episode_index": [number] * count,
        "task_index": [tasks[walk["instruction_text"]]] * count,
    }
    wanted = np.array([_looking_down(pose) for pose in poses])
    return (
        found == expected and matrices.shape == wanted.shape and bool(np.allclose(matrices, wanted, atol=1e-9, rtol=0))
    )


def _looking_down(pose: Row) -> np.ndarray[Any, Any]:
    """Return the matrix (4, 4) that transforms points from the frame of a pose's camera (x right, y down, z ahead) to
    Habitat's frame.
    """
    turn, pitch = pose["heading"], math.radians(pose["look_down"])
    ahead = np.array([-math.sin(turn) * math.cos(pitch), -math.sin(pitch), -math.cos(turn) * math.cos(pitch)])
    right = np.array([math.cos(turn), 0.0, -math.sin(turn)])
    place = [pose["position"]["x"], pose["position"]["y"] + pose["eye_height"], pose["position"]["z"]]
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([right, np.cross(ahead, right), ahead, place])
    return matrix


_EPISODE_KEYS: Final = ("episode_id", "trajectory", "kind", "source", "scene_id")
_NUMBERS: Final = {
    "action": pa.int64(),
    "executed": pa.int64(),
    "repeats": pa.int64(),
    "leaf": pa.int64(),
    "looks_for": pa.int64(),
    "distance_to_goal": pa.float32(),
    "episode_id": pa.int64(),
    "next.done": pa.bool_(),
    "timestamp": pa.float32(),
    "frame_index": pa.int64(),
    "episode_index": pa.int64(),
    "index": pa.int64(),
    "task_index": pa.int64(),
}
"""Features of one number each, and their types."""


def lerobot_faults(folder: Path, record: Row, walks: Sequence[Row], counts: Counts) -> Faults:
    """Yield what is wrong with LeRobot's dataset: each row, image and statistic is computed again."""
    target = folder / "lerobot"
    cameras = sorted(record["cameras"])
    places: set[str] = set()
    groups = _row_groups(target / "data", places)
    episodes = iter(pq.read_table(target / "meta/episodes/chunk-000/file-000.parquet").to_pylist())
    moments: dict[str, _Moments] = {}
    tasks: dict[str, int] = {}
    first = number = 0
    for _, own, poses in scenes_with_poses(folder, walks):
        views: dict[tuple[str, str], list[Row]] = {}
        for pose in poses:
            views.setdefault((pose["trajectory"], pose["camera"]), []).append(pose)
        for walk in own:
            task = tasks.setdefault(walk["instruction_text"], len(tasks))
            chunk, file, table = next(groups, (0, 0, None))
            wanted = {
                "episode_index": number,
                "tasks": [walk["instruction_text"]],
                "length": walk["n_frames"],
                "dataset_from_index": first,
                "dataset_to_index": first + walk["n_frames"],
                "data/chunk_index": chunk,
                "data/file_index": file,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                **{name: walk[name] for name in _EPISODE_KEYS},
            }
            if next(episodes, None) != wanted:
                yield walk["trajectory"], "the row of meta/episodes is not the walk's"
            shown = {name: views[walk["frames_of"], name] for name in cameras}
            if table is None or not _is_lerobot(
                folder, table, walk, shown, record["cameras"], (number, first, task), moments
            ):
                yield walk["trajectory"], f"the frames of episode {number} are not those of the walk"
                return
            counts["lerobot"] += walk["n_frames"]
            first, number = first + walk["n_frames"], number + 1
    if next(groups, None) is not None or next(episodes, None) is not None:
        yield "", "there are more episodes than walks"
    if [*enumerate(tasks)] != [(row["task_index"], row["task"]) for row in _tasks(target)]:
        yield "", "tasks.parquet is not that of the walks"
    if _json(target / "meta/info.json") != _lerobot_info(record, number, first, len(tasks)):
        yield "", "info.json does not describe the dataset"
    stats = _json(target / "meta/stats.json")
    if stats.keys() != moments.keys() or not all(found.are(stats[name]) for name, found in moments.items()):
        yield "", "stats.json is not that of the frames"
    meta = {"meta/info.json", "meta/stats.json", "meta/tasks.parquet", "meta/episodes/chunk-000/file-000.parquet"}
    if {str(path.relative_to(target)) for path in target.rglob("*") if path.is_file()} != meta | places:
        yield "", "there are other files than those of the dataset"


def _row_groups(folder: Path, places: set[str]) -> Iterator[tuple[int, int, pa.Table]]:
    """Yield (chunk, file, rows) for each row group of a dataset, by file; add the files' paths to `places`."""
    for path in sorted(folder.glob("chunk-*/file-*.parquet")):
        places.add(f"data/{path.parent.name}/{path.name}")
        with pq.ParquetFile(path) as file:
            for group in range(file.num_row_groups):
                yield int(path.parent.name[6:]), int(path.stem[5:]), file.read_row_group(group)


def _is_lerobot(
    folder: Path,
    table: pa.Table,
    walk: Row,
    views: Mapping[str, Sequence[Row]],
    cameras: Mapping[str, Row],
    place: tuple[int, int, int],
    moments: dict[str, _Moments],
) -> bool:
    """Compare the frames of a walk with the hub, and add them to `moments`.

    cameras : the record's, by name
    place : number of the walk, number of its first frame among all frames, number of its task
    """
    count = walk["n_frames"]
    number, first, task = place
    # Before anything of the claimed length is built.
    if table.num_rows != count or any(len(view) != count for view in views.values()):
        return False
    poses = next(iter(views.values()))
    state = np.array([[*map(pose["position"].get, "xyz"), pose["heading"]] for pose in poses], np.float32)
    wanted: dict[str, list[Any]] = {
        "observation.state": state.tolist(),
        "action": walk["actions"],
        "executed": walk["executed"],
        "repeats": walk["repeats"],
        "leaf": [pose["leaf"] for pose in poses],
        "looks_for": [-1 if pose["looks_for"] is None else pose["looks_for"] for pose in poses],
        "distance_to_goal": np.array([pose["distance_to_goal"] for pose in poses], np.float32).tolist(),
        "episode_id": [walk["episode_id"]] * count,
        "next.done": [False] * (count - 1) + [True],
        "timestamp": [float(k) for k in range(count)],
        "frame_index": [*range(count)],
        "episode_index": [number] * count,
        "index": [*range(first, first + count)],
        "task_index": [task] * count,
    }
    image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    kinds = {f"observation.images.{name}": image for name in views}
    kinds |= {"observation.state": pa.list_(pa.float32(), 4), **_NUMBERS}
    if {field.name: field.type for field in table.schema} != kinds:
        return False
    for name, values in wanted.items():
        if table[name].to_pylist() != values:
            return False
        moments.setdefault(name, _Moments()).add(np.array(values, np.float64).reshape(count, -1))
    for name, view in views.items():
        column = f"observation.images.{name}"
        moments.setdefault(column, _Moments())
        for k, (found, pose) in enumerate(zip(table[column], view, strict=True)):
            data = found["bytes"].as_py()
            if found["path"].as_py() != pose["image"] or data != read_regular(folder / pose["image"]):
                return False
            if (first + k) % 50 == 0:
                moments[column].add(_values(data, cameras[name]))
    return True


def _values(data: bytes, camera: Row) -> NDArray[np.float64]:
    """Return the pixels of an image (n, channels): colours as shares of 255, depth as it is.

    Raises
    ------
    ValueError : the image has another size than the camera
    """
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        if image.size != (camera["width"], camera["height"]):
            raise ValueError("an image has another size than its camera")
        pixels = np.array(image, np.float64)
    return pixels.reshape(-1, 1) if pixels.ndim == 2 else pixels.reshape(-1, 3) / 255


class _Moments:
    """Number, bounds, mean and squared deviations of values (n, channels), merged by Chan's rule."""

    def __init__(self) -> None:
        self._count = 0
        self._low = self._high = self._mean = self._squares = np.zeros(1)

    def add(self, values: NDArray[np.float64]) -> None:
        count, mean = len(values), values.mean(axis=0)
        squares = np.square(values - mean).sum(axis=0)
        low, high = values.min(axis=0), values.max(axis=0)
        if not self._count:
            self._count, self._low, self._high, self._mean, self._squares = count, low, high, mean, squares
            return
        whole, apart = self._count + count, mean - self._mean
        self._squares = self._squares + squares + np.square(apart) * (self._count * count / whole)
        self._mean = self._mean + apart * (count / whole)
        self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)
        self._count = whole

    def are(self, stats: Row) -> bool:
        """Return whether these are the statistics of a feature in ``stats.json``."""
        spread = np.sqrt(self._squares / self._count)
        wanted = {"min": self._low, "max": self._high, "mean": self._mean, "std": spread}
        near = np.maximum(np.abs(self._low), np.abs(self._high)) * 1e-6 + 1e-9
        return stats["count"] == [self._count] and all(
            np.size(stats[name]) == values.size and bool((np.abs(np.ravel(stats[name]) - values) <= near).all())
            for name, values in wanted.items()
        )


def _tasks(target: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(target / "meta/tasks.parquet").to_pylist()
    return rows


def _json(path: Path) -> dict[str, Any]:
    found = orjson.loads(read_regular(path))
    if not isinstance(found, dict):
        raise ValueError(f"{path.name} holds no JSON object")
    return found


def _lerobot_info(record: Row, episodes: int, frames: int, tasks: int) -> dict[str, Any]:
    features: dict[str, Any] = {}
    for name, camera in record["cameras"].items():
        depth = name.startswith("depth")
        features[f"observation.images.{name}"] = {
            "dtype": "image",
            "shape": [camera["height"], camera["width"], 1 if depth else 3],
            "names": ["height", "width", "channels"],
        } | ({"info": {"is_depth_map": True, "depth_unit": "mm"}} if depth else {})
    names = ["x_metres", "y_metres", "z_metres", "heading_radians"]
    features["observation.state"] = {"dtype": "float32", "shape": [4], "names": names}
    for name, kind in _NUMBERS.items():
        dtype = {pa.float32(): "float32", pa.bool_(): "bool"}.get(kind, "int64")
        features[name] = {"dtype": dtype, "shape": [1], "names": None}
    return {
        "codebase_version": "v3.0",
        "robot_type": "condvln",
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": 1,
        "splits": {record["split"]: f"0:{episodes}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }
