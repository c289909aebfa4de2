"""The hub, whose images all layouts share: a folder in StreamVLN's layout, with all poses in ``poses.parquet``.

``annotations.json`` and ``images/<walk>/rgb/001.jpg`` are what StreamVLN's loader reads, and SNav's, whose turns are
larger; other layouts name or link the same images. Walks of other actions than these two have no ``annotations.json``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import orjson
import pyarrow as pa
import pyarrow.parquet as pq

from condvln.formats.streams import JsonArrayStream, atomic_path, atomic_stream
from condvln.navigation.follower import ActionSpace
from condvln.trajectories.cameras import Cameras
from condvln.trajectories.images import IMAGES, writing
from schemas.base import Row
from schemas.tables import TRAJECTORY_TABLES

__all__ = [
    "ANNOTATIONS",
    "AddScene",
    "Hub",
    "Layout",
    "SceneWalks",
    "annotation",
    "json_array",
    "write_hub",
    "write_tables",
]

ANNOTATIONS: Final = "annotations.json"


@dataclass(frozen=True, eq=False)
class Hub:
    """What the layouts of a folder of trajectories share.

    folder : the folder of the trajectories, with the images
    split : split of the episodes
    cameras : by name; the main one is ``rgb``
    space : what the walks' actions mean
    """

    folder: Path
    split: str
    cameras: Cameras
    space: ActionSpace


@dataclass(frozen=True, eq=False)
class SceneWalks:
    """All walks of one scene.

    tables : ``trajectories``, ``poses`` and ``left_out``
    """

    source: str
    scene_id: str
    tables: Mapping[str, pa.Table]

    def trajectories(self) -> list[dict[str, Any]]:
        """Return the rows of the walks, sorted by name."""
        found: list[dict[str, Any]] = self.tables["trajectories"].to_pylist()
        return found


AddScene: TypeAlias = Callable[[SceneWalks], None]
Layout: TypeAlias = Callable[[Hub], AbstractContextManager[AddScene]]
"""Opens a layout below the hub's folder. It takes one scene after the other, names or links the hub's images and
renders nothing; its folder replaces an older one when all scenes are done.
"""


@contextmanager
def json_array(path: Path) -> Iterator[JsonArrayStream]:
    """Write a JSON array to a file, an entry a time; the file appears when the array is complete."""
    with atomic_stream(path, closing=b"\n]\n") as stream:
        stream.write(b"[\n")
        yield JsonArrayStream(stream)


def annotation(row: Row) -> dict[str, Any]:
    """Return a walk's entry in StreamVLN's annotations. The entry's ``actions`` begin with −1 and leave out the final
    STOP, because the loader trains on ``actions[1:] + [0]``.
    """
    return {
        "id": row["episode_id"],
        "video": f"{IMAGES}/{row['frames_of']}",
        "instructions": [row["instruction_text"]],
        "actions": [-1, *row["actions"][:-1]],
        "trajectory": row["trajectory"],
        "kind": row["kind"],
        "repeats": row["repeats"],
    }


def write_hub(folder: Path, scenes: Iterable[SceneWalks]) -> Iterator[SceneWalks]:
    """Write ``annotations.json`` and one Parquet file per table for all scenes; yield each scene after its rows are
    written.

    The files replace older ones when all scenes are done.
    """
    with json_array(folder / ANNOTATIONS) as entries:
        for scene in write_tables(folder, scenes):
            for row in scene.trajectories():
                entries.entry(orjson.dumps(annotation(row)))
            yield scene


def write_tables(folder: Path, scenes: Iterable[SceneWalks]) -> Iterator[SceneWalks]:
    """Write one Parquet file per table for all scenes; yield each scene after its rows are written."""
    with ExitStack() as stack:
        tables = {name: stack.enter_context(_parquet(folder / f"{name}.parquet", name)) for name in TRAJECTORY_TABLES}
        for scene in scenes:
            for name, writer in tables.items():
                table = scene.tables[name]
                if not table.num_rows:
                    continue
                source = pa.array([scene.source] * table.num_rows, pa.string())
                with writing(folder / f"{name}.parquet"):
                    writer.write_table(table.append_column(_SOURCE, source), row_group_size=table.num_rows)
            yield scene


_SOURCE: Final = pa.field(
    "source", pa.string(), nullable=False, metadata={"description": "family of the scene, as in the export"}
)


@contextmanager
def _parquet(path: Path, name: str) -> Iterator[pq.ParquetWriter]:
    """Yield the writer of a Parquet file; the file appears at `path` only when it is complete.

    Raises
    ------
    StoreError : the file can't be written
    """
    schema = TRAJECTORY_TABLES[name].append(_SOURCE)
    with atomic_path(path) as part:
        writer = pq.ParquetWriter(part, schema, compression="zstd")
        try:
            yield writer
        finally:
            writer.close()
