"""The layout of LeRobot v3.0: one dataset for the whole folder, whose tables hold the images of all cameras.

The files are those that `lerobot` itself writes for features of type ``image``; the JPEG and PNG files are stored in
the tables byte for byte. Feature names, units and frames are listed in ``docs/training.md``.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from condvln.formats.streams import indented
from condvln.trajectories.cameras import Cameras, is_depth
from condvln.trajectories.hub import AddScene, Hub, SceneWalks
from condvln.trajectories.images import writing
from condvln.trajectories.layouts import new_folder
from schemas.base import Row

__all__ = ["lerobot"]

VERSION: Final = "v3.0"
FPS: Final = 1
"""Frames a second that the timestamps pretend: one action takes one second."""
CHUNK: Final = 1000
"""Most files of a folder."""
FILE_BYTES: Final = 100 * 2**20
"""Size of its images after which a file takes no further walk."""
SAMPLED: Final = 50
"""Of how many frames one is decoded for the statistics of images."""

STATE: Final = ("x_metres", "y_metres", "z_metres", "heading_radians")
_WALK_COLUMNS: Final = ("episode_id", "trajectory", "kind", "source", "scene_id")


@contextmanager
def lerobot(hub: Hub) -> Iterator[AddScene]:
    """Write a LeRobot v3.0 dataset to ``lerobot/``: an episode for each walk, a row for each frame.

    Raises
    ------
    StoreError : a file can't be written
    """
    with new_folder(hub.folder / "lerobot") as part:
        dataset = _Dataset(hub, part)
        try:
            yield dataset.add
        finally:
            dataset.close()
        dataset.finish(hub.split)


class _Dataset:
    """The tables of a dataset; one walk is in memory at a time."""

    def __init__(self, hub: Hub, target: Path) -> None:
        self._folder, self._target, self._cameras = hub.folder, target, sorted(hub.cameras)
        self._features = _features(hub.cameras)
        self._features["action"]["info"] = {"forward_metres": hub.space.forward, "turn_degrees": hub.space.turn}
        self._schema = pa.schema([_field(name, feature) for name, feature in self._features.items()])
        self._tasks: dict[str, int] = {}
        self._statistics = {name: _Statistics() for name in self._features}
        self._rows, self._walks, self._file, self._bytes = 0, 0, -1, FILE_BYTES
        self._data: pq.ParquetWriter | None = None
        with self._writing():
            path = _file(target, "meta/episodes", 0)
            self._episodes = pq.ParquetWriter(path, _EPISODES, compression="zstd")

    def _writing(self) -> AbstractContextManager[None]:
        return writing(self._folder / "lerobot")

    def add(self, scene: SceneWalks) -> None:
        poses: dict[tuple[str, str], list[dict[str, Any]]] = {}
        for row in scene.tables["poses"].to_pylist():
            poses.setdefault((row["trajectory"], row["camera"]), []).append(row)
        lines = [
            self._walk(row | {"source": scene.source}, [poses[row["frames_of"], name] for name in self._cameras])
            for row in scene.trajectories()
        ]
        if not lines:
            return
        with self._writing():
            self._episodes.write_table(pa.Table.from_pylist(lines, schema=_EPISODES))

    def _walk(self, walk: Row, views: Sequence[Sequence[Row]]) -> dict[str, Any]:
        """Write the rows of a walk. `views` has for each camera the poses of the walk, by frame. Return the walk's row
        of the table of episodes.
        """
        task = self._tasks.setdefault(walk["instruction_text"], len(self._tasks))
        first, number = self._rows, self._walks
        columns = _columns(walk, views[0]) | {
            "episode_index": np.full(walk["n_frames"], number),
            "index": np.arange(first, first + walk["n_frames"]),
            "task_index": np.full(walk["n_frames"], task),
        }
        for name, values in columns.items():
            self._statistics[name].add(np.asarray(values, np.float64).reshape(walk["n_frames"], -1).T)
        for name, view in zip(self._cameras, views, strict=True):
            files = [(self._folder / pose["image"]).read_bytes() for pose in view]
            for at in range(-first % SAMPLED, len(files), SAMPLED):
                self._statistics[_key(name)].add(_pixels(files[at]))
            columns[_key(name)] = [
                {"bytes": data, "path": pose["image"]} for data, pose in zip(files, view, strict=True)
            ]
        arrays = [_array(columns[field.name], field.type) for field in self._schema]
        size = sum(pose["bytes"] for view in views for pose in view)
        with self._writing():
            self._writer(size).write_table(pa.table(arrays, schema=self._schema), row_group_size=walk["n_frames"])
        self._rows, self._walks = first + walk["n_frames"], number + 1
        return {
            "episode_index": number,
            "tasks": [walk["instruction_text"]],
            "length": walk["n_frames"],
            "dataset_from_index": first,
            "dataset_to_index": self._rows,
            "data/chunk_index": self._file // CHUNK,
            "data/file_index": self._file % CHUNK,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            **{name: walk[name] for name in _WALK_COLUMNS},
        }

    def _writer(self, size: int) -> pq.ParquetWriter:
        """Return the writer of the file for a walk whose images have this size in bytes."""
        if self._data is None or self._bytes >= FILE_BYTES:
            if self._data is not None:
                self._data.close()
            self._file, self._bytes = self._file + 1, 0
            # Images are compressed already.
            packed = {
                name: "zstd" for name, feature in self._features.items() if feature["dtype"] not in ("image", "video")
            }
            self._data = pq.ParquetWriter(
                _file(self._target, "data", self._file), self._schema, compression=packed, use_dictionary=[*packed]
            )
        self._bytes += size
        return self._data

    def close(self) -> None:
        """Close the files."""
        with self._writing():
            self._episodes.close()
            if self._data is not None:
                self._data.close()

    def finish(self, split: str) -> None:
        """Write what is known only at the end: tasks, statistics, and the description of the dataset."""
        meta = self._target / "meta"
        with self._writing():
            pq.write_table(_task_table(self._tasks), meta / "tasks.parquet")
        stats = {
            name: found.document(image=feature["dtype"] == "image")
            for name, feature in self._features.items()
            if (found := self._statistics[name]).count
        }
        info = {
            "codebase_version": VERSION,
            "robot_type": "condvln",
            "total_episodes": self._walks,
            "total_frames": self._rows,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK,
            "data_files_size_in_mb": FILE_BYTES // 2**20,
            "video_files_size_in_mb": 200,
            "fps": FPS,
            "splits": {split: f"0:{self._walks}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": self._features,
        }
        with self._writing():
            for name, document in (("info", info), ("stats", stats)):
                (meta / f"{name}.json").write_bytes(indented(document))


def _features(cameras: Cameras) -> dict[str, dict[str, Any]]:
    """Return the features of a dataset in LeRobot's form: type, shape, and names along the shape."""
    found: dict[str, dict[str, Any]] = {}
    for name in sorted(cameras):
        shape = [cameras[name].height, cameras[name].width, 1 if is_depth(name) else 3]
        found[_key(name)] = {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]}
        if is_depth(name):
            found[_key(name)]["info"] = {"is_depth_map": True, "depth_unit": "mm"}
    found["observation.state"] = {"dtype": "float32", "shape": [len(STATE)], "names": [*STATE]}
    return found | {
        name: {"dtype": dtype, "shape": [1], "names": None}
        for name, dtype in {
            **dict.fromkeys(("action", "executed", "repeats", "leaf", "looks_for"), "int64"),
            "distance_to_goal": "float32",
            "episode_id": "int64",
            "next.done": "bool",
            "timestamp": "float32",
            **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64"),
        }.items()
    }


def _key(camera: str) -> str:
    return f"observation.images.{camera}"


_IMAGE: Final = pa.struct([pa.field("bytes", pa.binary()), pa.field("path", pa.string())])


def _field(name: str, feature: Row) -> pa.Field:
    if feature["dtype"] == "image":
        return pa.field(name, _IMAGE)
    kind = pa.type_for_alias(feature["dtype"])
    (width,) = feature["shape"]
    return pa.field(name, kind if width == 1 else pa.list_(kind, width))


_EPISODES: Final = pa.schema(
    [
        ("episode_index", pa.int64()),
        ("tasks", pa.list_(pa.string())),
        ("length", pa.int64()),
        ("dataset_from_index", pa.int64()),
        ("dataset_to_index", pa.int64()),
        ("data/chunk_index", pa.int64()),
        ("data/file_index", pa.int64()),
        ("meta/episodes/chunk_index", pa.int64()),
        ("meta/episodes/file_index", pa.int64()),
        *((name, pa.int64() if name == "episode_id" else pa.string()) for name in _WALK_COLUMNS),
    ]
)


def _columns(walk: Row, poses: Sequence[Row]) -> dict[str, Any]:
    """Return the columns of a walk's frames, without images and indices that depend on other walks."""
    count = walk["n_frames"]
    places = [[*(pose["position"][axis] for axis in "xyz"), pose["heading"]] for pose in poses]
    return {
        "observation.state": np.array(places, np.float32),
        "action": walk["actions"],
        "executed": walk["executed"],
        "repeats": walk["repeats"],
        "leaf": [pose["leaf"] for pose in poses],
        "looks_for": [-1 if pose["looks_for"] is None else pose["looks_for"] for pose in poses],
        "distance_to_goal": np.array([pose["distance_to_goal"] for pose in poses], np.float32),
        "episode_id": np.full(count, walk["episode_id"]),
        "next.done": np.arange(count) == count - 1,
        "timestamp": np.arange(count, dtype=np.float32) / np.float32(FPS),
        "frame_index": np.arange(count),
    }


def _array(values: Any, kind: pa.DataType) -> pa.Array:
    if pa.types.is_fixed_size_list(kind):
        return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1), kind.value_type), type=kind)
    return pa.array(values, kind)


def _file(target: Path, name: str, number: int) -> Path:
    path = target / name / f"chunk-{number // CHUNK:03d}" / f"file-{number % CHUNK:03d}.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _task_table(tasks: Mapping[str, int]) -> pa.Table:
    """Return the table of instructions. `lerobot` reads it with pandas, for which the metadata says that the texts are
    the index.
    """
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": dtype, "metadata": None}
        for name, kind, dtype in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    index = [{"name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object", "metadata": None}]
    pandas = {"index_columns": ["task"], "column_indexes": index, "columns": columns, "pandas_version": "2.0.0"}
    schema = pa.schema(
        [("task_index", pa.int64()), ("task", pa.string())], metadata={"pandas": orjson.dumps(pandas).decode()}
    )
    return pa.table([pa.array(tasks.values(), pa.int64()), pa.array(tasks.keys(), pa.string())], schema=schema)


def _pixels(data: bytes) -> NDArray[np.float64]:
    """Return the pixels of an image (channels, n): colours from 0 to 1, depth in millimetres."""
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        found = np.asarray(image)
    if found.ndim == 2:
        return found.reshape(1, -1).astype(np.float64)
    return found.reshape(-1, found.shape[2]).T / 255.0


class _Statistics:
    """Smallest and largest value, mean, standard deviation and number of the values of a feature, by channel.

    Sums are of differences to the first value, so that a large constant such as an episode's id keeps its digits.
    """

    def __init__(self) -> None:
        self.count = 0
        self._first = self._low = self._high = self._sums = self._squares = np.zeros(0)

    def add(self, values: NDArray[np.float64]) -> None:
        """Add values (channels, n)."""
        low, high = values.min(axis=1), values.max(axis=1)
        if not self.count:
            self._first, self._low, self._high = values[:, 0], low, high
            self._sums = self._squares = np.zeros(len(values))
        apart = values - self._first[:, None]
        self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)
        self._sums = self._sums + apart.sum(axis=1)
        self._squares = self._squares + np.square(apart).sum(axis=1)
        self.count += values.shape[1]

    def document(self, *, image: bool) -> dict[str, list[Any]]:
        """Return the statistics in LeRobot's form; those of images have the shape (channels, 1, 1)."""
        apart = self._sums / self.count
        spread = np.sqrt(np.maximum(self._squares / self.count - np.square(apart), 0.0))
        found = {"min": self._low, "max": self._high, "mean": self._first + apart, "std": spread}
        shape = (-1, 1, 1) if image else (-1,)
        return {name: values.reshape(shape).tolist() for name, values in found.items()} | {"count": [self.count]}
