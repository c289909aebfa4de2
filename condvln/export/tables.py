"""The tables that an export reads: from a published snapshot's folder, or in memory."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from operator import itemgetter
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from condvln.episodes.identity import HASH, ID, with_numbers
from condvln.export.rows import Row, rows_of
from schemas.errors import FormatError, MissingFileError, StoreError

__all__ = [
    "BATCH_ROWS",
    "FolderTables",
    "JoinedScene",
    "MemoryTables",
    "SnapshotTables",
    "instructions_by_scene",
    "joined_by_scene",
    "rows_by_scene",
]

_REMEDY: Final = "Run condvln rebuild CONFIG --verify, which rebuilds damaged files"

SCENE: Final = "scene_id"
_BUFFER: Final = 1 << 14
"""Bytes of a column that are read at a time."""
BATCH_ROWS: Final = 1024
"""Rows decoded at a time: enough to amortise Arrow's calls, few enough to keep memory low."""


class SnapshotTables(Protocol):
    """The tables of one snapshot, read source by source."""

    @property
    def id(self) -> str:
        """Id of the snapshot."""

    @property
    def sources(self) -> tuple[str, ...]:
        """Families with rows, sorted."""

    def batches(self, table: str, source: str, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the rows of one table of one source in ascending order of ``scene_id``; all columns unless `columns`
        is given.
        """


@dataclass(frozen=True)
class MemoryTables:
    """Tables in memory: ``tables[source][name]``."""

    id: str
    tables: Mapping[str, Mapping[str, pa.Table]]

    @property
    def sources(self) -> tuple[str, ...]:
        """Families with rows, sorted."""
        return tuple(sorted(self.tables))

    def batches(self, table: str, source: str, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the rows of one table of one source, as :meth:`SnapshotTables.batches` requires."""
        found = self.tables[source][table]
        for batch in found.select(_stored(columns, found.schema.names)).to_batches(max_chunksize=BATCH_ROWS):
            yield with_numbers(batch, columns)


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
        """Yield the rows of one table of one source, as :meth:`SnapshotTables.batches` requires.

        Raises
        ------
        MissingFileError : the table has no file for this source
        FormatError : a part is not a Parquet file
        """
        folder = self.folder / table / f"source={source}"
        parts = [_opened(path) for path in sorted(folder.glob("part-*.parquet"))]
        if not parts:
            raise MissingFileError("no file of this table exists", where=folder, remedy=_REMEDY)
        wanted = _stored(columns, parts[0].schema_arrow.names)
        try:
            for batch in _batches_of(parts[0], wanted) if len(parts) == 1 else _merged(parts, wanted):
                yield with_numbers(batch, columns)
        except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
            raise FormatError(f"a part-*.parquet file is damaged ({error})", where=folder, remedy=_REMEDY) from error


def _stored(columns: Sequence[str] | None, there: Sequence[str]) -> list[str]:
    """Return the names of the columns to read. In snapshots of former releases, which have no ``episode_hash``, the
    column ``episode_id`` is the hash and is read instead.
    """
    wanted = there if columns is None else columns
    return list(dict.fromkeys(ID if name == HASH and HASH not in there else name for name in wanted))


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
    read = [*columns, *({SCENE} - {*columns})]
    for _, batch in heapq.merge(*(_pieces(_batches_of(part, read)) for part in parts), key=itemgetter(0)):
        yield batch.select([*columns])


def _pieces(batches: Iterator[pa.RecordBatch]) -> Iterator[tuple[str, pa.RecordBatch]]:
    """Cut batches where another scene begins; yield (id of the scene, its rows)."""
    for batch in batches:
        scenes = batch.column(SCENE)
        codes = scenes.dictionary_encode().indices.to_numpy()
        cuts = [0, *(np.flatnonzero(np.diff(codes)) + 1).tolist(), len(codes)]
        for begin, end in pairwise(cuts):
            yield scenes[begin].as_py(), batch.slice(begin, end - begin)


def rows_by_scene(
    batches: Iterator[pa.RecordBatch], where: str, *, encoded: bool = False
) -> Iterator[tuple[str, list[Row]]]:
    """Yield the id of each scene, with all rows of the scene, as :func:`~condvln.export.rows.rows_of` returns them.

    Raises
    ------
    StoreError : the scenes are not in ascending order
    """
    last = ""
    for scene, rows in groupby(
        (row for batch in batches for row in rows_of(batch, encoded=encoded)), key=itemgetter("scene_id")
    ):
        if scene < last:
            raise StoreError(
                f"scene {scene!r} comes after {last!r}, so the rows are not sorted", where=where, remedy=_REMEDY
            )
        last = scene
        yield scene, list(rows)


JoinedScene = tuple[str, list[Row], dict[str, Row]]
"""The id of a scene, its episodes, and its instructions by id."""


def instructions_by_scene(tables: SnapshotTables, source: str) -> Iterator[tuple[str, list[Row]]]:
    """Yield the id of each scene, with all rows of its instructions."""
    return rows_by_scene(tables.batches("instructions", source), f"instructions of {source}")


def joined_by_scene(
    tables: SnapshotTables,
    source: str,
    columns: Sequence[str] | None = None,
    told: Iterable[tuple[str, list[Row]]] | None = None,
) -> Iterator[JoinedScene]:
    """Yield for each scene its id, its episodes, whose lists of points are encoded, and its instructions by id. Only
    one scene at a time is in memory.

    told : what :func:`instructions_by_scene` yields, if it is known

    Raises
    ------
    StoreError : an episode's instruction is not in the snapshot
    """
    told = iter(instructions_by_scene(tables, source) if told is None else told)
    scene_told, instructions = "", {}
    for scene, episodes in rows_by_scene(
        tables.batches("episodes", source, columns), f"episodes of {source}", encoded=True
    ):
        while scene_told < scene:
            scene_told, rows = next(told, ("\U0010ffff", []))
            instructions = {row["instruction_id"]: row for row in rows}
        known = instructions if scene_told == scene else {}
        missing = [row["instruction_id"] for row in episodes if row["instruction_id"] not in known]
        if missing:
            raise StoreError(
                f"scene {scene!r} has an episode whose instruction {missing[0]!r} is missing",
                where=f"instructions of {source}",
                remedy=_REMEDY,
            )
        yield scene, episodes, known
