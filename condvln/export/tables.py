"""The tables that an export reads, from a published snapshot's folder, and their rows as plain Python values.

``RecordBatch.to_pylist`` makes a dictionary of every point, and episodes have a hundred points each: here points are
lists ``[x, y, z]``, made a column at a time.
"""

from __future__ import annotations

import hashlib
import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from condvln.sources.gibson import GibsonSource, verified_twin
from schemas.base import Json as Row
from schemas.errors import FormatError, MissingFileError, StoreError
from schemas.tables import EXPORT_TABLES

__all__ = [
    "BATCH_ROWS",
    "SPLITS_TABLE",
    "FolderTables",
    "JoinedScene",
    "NavmeshBytes",
    "Row",
    "SceneTable",
    "joined_by_scene",
    "rows_by_scene",
    "rows_of",
    "splits_table",
]

_REMEDY: Final = "Run condvln generate CONFIG --verify, which rebuilds damaged files"


_POINTS: Final = (["x", "z"], ["x", "y", "z"], ["x", "y", "z", "w"])
_BUFFER: Final = 1 << 14
"""Bytes of a column that are read at a time."""
BATCH_ROWS: Final = 1024
"""Rows decoded at a time: enough to amortise Arrow's calls, few enough to keep memory low."""


SPLITS_TABLE: Final = "splits.parquet"
"""Path below the export's folder of the table that has the split of each episode."""


def splits_table(chosen: Sequence[tuple[int, str]]) -> bytes:
    """Return the Parquet file of `chosen`, pairs of an episode's id and its split, by id."""
    columns = zip(*sorted(chosen), strict=True) if chosen else ((), ())
    sink = pa.BufferOutputStream()
    pq.write_table(
        pa.table([[*column] for column in columns], schema=EXPORT_TABLES["splits"]), sink, compression="zstd"
    )
    data: bytes = sink.getvalue().to_pybytes()
    return data


@dataclass(frozen=True)
class FolderTables:
    """The tables in the folder ``snapshots/<id>`` of a store: ``<table>/source=<family>/part-*.parquet``."""

    folder: Path

    @property
    def id(self) -> str:
        """Id of the snapshot: the folder's name."""
        return self.folder.name

    @property
    def sources(self) -> tuple[str, ...]:
        """Families with rows, sorted."""
        prefix = "source="
        return tuple(sorted(p.name[len(prefix) :] for p in (self.folder / "episodes").glob(f"{prefix}*") if p.is_dir()))

    def batches(self, table: str, source: str, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the rows of one table of one source in ascending order of ``scene_id``; all columns unless `columns` is
        given.

        Raises
        ------
        MissingFileError : the table has no file for this source
        FormatError : a part is not a Parquet file
        """
        folder = self.folder / table / f"source={source}"
        parts = [_opened(path) for path in sorted(folder.glob("part-*.parquet"))]
        if not parts:
            raise MissingFileError("no file of this table exists", where=folder, remedy=_REMEDY)
        wanted = parts[0].schema_arrow.names if columns is None else columns
        try:
            yield from _batches_of(parts[0], wanted) if len(parts) == 1 else _merged(parts, wanted)
        except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
            raise FormatError(f"a part-*.parquet file is damaged ({error})", where=folder, remedy=_REMEDY) from error


def _opened(path: Path) -> pq.ParquetFile:
    try:
        # Without the buffer, a file's columns would be read as wholes, and all files of a table are open together.
        return pq.ParquetFile(path, buffer_size=_BUFFER, pre_buffer=False)
    except (pa.ArrowInvalid, OSError) as error:
        raise FormatError(f"not a Parquet file ({error})", where=path, remedy=_REMEDY) from error


def _batches_of(file: pq.ParquetFile, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
    # Single-threaded: Arrow's thread pool has aborted processes on busy machines when work was left at exit.
    batches: Iterator[pa.RecordBatch] = file.iter_batches(BATCH_ROWS, columns=[*columns], use_threads=False)
    return batches


def _merged(parts: Sequence[pq.ParquetFile], columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
    """Yield the rows of files, each of which is sorted by ``scene_id``, in that order; a scene is in one file only, and
    any scene may be in any file.
    """
    read = [*columns, *({"scene_id"} - {*columns})]
    for _, batch in heapq.merge(*(_pieces(_batches_of(part, read)) for part in parts), key=itemgetter(0)):
        yield batch.select([*columns])


def _pieces(batches: Iterator[pa.RecordBatch]) -> Iterator[tuple[str, pa.RecordBatch]]:
    """Cut batches where another scene begins; yield (id of the scene, its rows)."""
    for batch in batches:
        scenes = batch.column("scene_id")
        codes = scenes.dictionary_encode().indices.to_numpy()
        cuts = [0, *(np.flatnonzero(np.diff(codes)) + 1).tolist(), len(codes)]
        for begin, end in pairwise(cuts):
            yield scenes[begin].as_py(), batch.slice(begin, end - begin)


def rows_of(batch: pa.RecordBatch | pa.Table) -> list[Row]:
    """Return the rows of ``batch``; structs of x, z or x, y, z (w) become lists, other structs dictionaries, nulls
    None.
    """
    if isinstance(batch, pa.Table):
        return [row for part in batch.to_batches() for row in rows_of(part)]
    return _records(batch.schema.names, [_values(column) for column in batch.columns])


def _records(names: list[str], columns: list[list[Any]]) -> list[Row]:
    return [dict(zip(names, values, strict=True)) for values in zip(*columns, strict=True)]


def _values(array: pa.Array) -> list[Any]:
    kind = array.type
    if len(array) == 0:
        return []
    values: list[Any]
    if pa.types.is_struct(kind):
        names, fields = [field.name for field in kind], array.flatten()
        if names in _POINTS:
            values = np.stack([field.to_numpy(zero_copy_only=False) for field in fields], axis=1).tolist()
        else:
            values = _records(names, [_values(field) for field in fields])
    elif pa.types.is_list(kind) or pa.types.is_large_list(kind):
        offsets = array.offsets.to_numpy()
        # A slice shares the values of the whole array; only the slice's own are decoded.
        inner = _values(array.values.slice(offsets[0], offsets[-1] - offsets[0]))
        values = [inner[a:b] for a, b in pairwise((offsets - offsets[0]).tolist())]
    else:
        values = array.to_pylist()
    if array.null_count == 0:
        return values
    return [value if valid else None for value, valid in zip(values, array.is_valid().to_pylist(), strict=True)]


def rows_by_scene(batches: Iterator[pa.RecordBatch], where: str) -> Iterator[tuple[str, list[Row]]]:
    """Yield the id of each scene, with all rows of the scene, as :func:`rows_of` returns them.

    Raises
    ------
    StoreError : the scenes are not in ascending order
    """
    last = ""
    for scene, rows in groupby((row for batch in batches for row in rows_of(batch)), key=itemgetter("scene_id")):
        if scene < last:
            raise StoreError(
                f"scene {scene!r} comes after {last!r}, so the rows are not sorted", where=where, remedy=_REMEDY
            )
        last = scene
        yield scene, list(rows)


JoinedScene = tuple[str, list[Row], dict[str, Row]]
"""The id of a scene, its episodes, and its instructions by id."""


def joined_by_scene(tables: FolderTables, source: str, columns: Sequence[str] | None = None) -> Iterator[JoinedScene]:
    """Yield for each scene its id, its episodes (all columns unless `columns` is given) and its instructions by id.
    Only one scene at a time is in memory.

    Raises
    ------
    StoreError : an episode's instruction is not in the snapshot
    """
    every = rows_by_scene(tables.batches("instructions", source), f"instructions of {source}")
    scene_of, instructions = "", {}
    for scene, episodes in rows_by_scene(tables.batches("episodes", source, columns), f"episodes of {source}"):
        while scene_of < scene:
            scene_of, rows = next(every, ("\U0010ffff", []))
            instructions = {row["instruction_id"]: row for row in rows}
        known = instructions if scene_of == scene else {}
        missing = [row["instruction_id"] for row in episodes if row["instruction_id"] not in known]
        if missing:
            raise StoreError(
                f"scene {scene!r} has an episode whose instruction {missing[0]!r} is missing",
                where=f"instructions of {source}",
                remedy=_REMEDY,
            )
        yield scene, episodes, known


NavmeshBytes = Callable[[str, Row], bytes | None]
"""Returns the navmesh built for a scene, from its source and its row of the scenes table; None if it is missing."""


class SceneTable:
    """All scenes of a snapshot.

    Parameters
    ----------
    navmeshes : returns built navmeshes, which are then written to the export; without it only their names are recorded
    """

    def __init__(self, tables: FolderTables, navmeshes: NavmeshBytes | None) -> None:
        self._navmeshes = navmeshes
        self._rows = {
            source: {row["scene_id"]: row for batch in tables.batches("scenes", source) for row in rows_of(batch)}
            for source in tables.sources
        }

    def barred(self, source: str) -> dict[str, str]:
        """Return the reason why a scene's episodes can't be published, by scene; scenes without such a reason are left
        out.
        """
        reasons = {}
        for scene, row in self._rows[source].items():
            if row["navmesh_path"] is None:
                reasons[scene] = "its scene has no navmesh"
            elif self._is_shipped(row) and self.navmesh(source, scene) is None:
                reasons[scene] = "the navmesh built for its scene is missing or changed"
            elif source == GibsonSource.family and verified_twin(scene) in self._rows[source]:
                # The two kinds of annotation are split separately, so one building could otherwise be in two splits.
                reasons[scene] = "its building is there by its verified annotation"
        return reasons

    def navmesh(self, source: str, scene: str) -> bytes | None:
        """Return the built navmesh of a scene; None if none was built or if its hash is not the recorded one."""
        row = self._rows[source][scene]
        data = self._navmeshes(source, row) if self._navmeshes is not None else None
        if data is None or hashlib.sha256(data).hexdigest() != row["navmesh_sha256"]:
            return None
        return data

    def navmesh_path(self, source: str, scene: str) -> tuple[str, bool]:
        """Return the path of a scene's navmesh as manifests state it, and whether the navmesh is a file of the
        export.
        """
        row = self._rows[source][scene]
        return str(row["navmesh_path"]), self._is_shipped(row)

    def _is_shipped(self, row: Row) -> bool:
        return self._navmeshes is not None and bool(row["navmesh_built"])
