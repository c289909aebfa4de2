"""The hub, whose images all layouts share: a folder in StreamVLN's layout, with all poses in ``poses.parquet``.

``annotations.json`` and ``images/<walk>/rgb/001.jpg`` are what StreamVLN's loader reads; other layouts name or link the
same images.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import orjson
import pyarrow as pa
import pyarrow.parquet as pq

from condvln.formats.streams import JsonArrayStream, atomic_stream
from condvln.trajectories.images import IMAGES, writing
from schemas.trajectory_tables import TRAJECTORY_TABLES

__all__ = ["ANNOTATIONS", "SceneWalks", "annotation", "write_hub", "write_tables"]

ANNOTATIONS: Final = "annotations.json"

Row = Mapping[str, Any]


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
    with atomic_stream(folder / ANNOTATIONS, closing=b"\n]\n") as stream:
        stream.write(b"[\n")
        entries = JsonArrayStream(stream)
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
                with writing(folder / f"{name}.parquet"):
                    writer.write_table(_with_source(table, scene.source), row_group_size=table.num_rows)
            yield scene


def _with_source(table: pa.Table, source: str) -> pa.Table:
    return table.append_column(_SOURCE, pa.array([source] * table.num_rows, pa.string()))


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
    part = path.with_name(f".{path.name}.part")
    try:
        with writing(path):
            writer = pq.ParquetWriter(part, schema, compression="zstd")
        try:
            yield writer
        finally:
            with writing(path):
                writer.close()
        with writing(path):
            os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
