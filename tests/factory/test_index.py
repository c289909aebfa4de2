"""The unit index, the queue, the memory of hashes: the parts a run is made of."""

from __future__ import annotations

import contextlib
import os
import sqlite3
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st

from condvln.instructions.balance import ArrayFile
from factory.commits import Commits
from factory.executor import TASK_UNITS, tasks
from factory.files import FileHashes, hash_file
from factory.index import Index, IndexWriter, index_schema
from factory.pins import build_aggregate
from factory.planner import Planner
from factory.receipt import Failure, Receipt, StageReceipt, TableReceipt
from factory.run import run
from factory.snapshot import Snapshot
from factory.stage import Work
from factory.store import LocalStore
from schemas.errors import CorruptShardError, MissingFileError, StoreError

ids = st.text(st.characters(codec="utf-8"), min_size=1, max_size=6)


def receipt(unit_id: str, tail: int) -> Receipt:
    stages = tuple(
        StageReceipt(
            stage=stage.name,
            key=bytes([tail]) * 16,
            code=b"c" * 16,
            inputs=b"i" * 16,
            parameters=b"p" * 16,
            dependencies=b"d" * 16,
            seconds=0.5,
            peak_rss=10,
            made=False,
            skipped=False,
            tables=tuple(TableReceipt(name, b"h" * 16, 3, 30) for name in stage.tables),
            cpu_seconds=0.25,
            estimate=0.125,
        )
        for stage in toys.pipeline().stages[: tail % 4]
    )
    failure = Failure("word", b"k" * 16, "error", "ValueError", "no", known=True) if tail % 5 == 0 else None
    return Receipt(unit_id, "ab"[tail % 2], "quarantined" if failure else "ok", "", bytes([tail]) * 16, stages, failure)


@given(st.lists(st.tuples(ids, st.integers(0, 200), st.sampled_from(["kept", "gone", "new"])), max_size=40))
def test_rows_of_an_older_index_are_carried_over(drawn: list[tuple[str, int, str]]) -> None:
    pipeline = toys.pipeline()
    whole = {unit_id: (receipt(unit_id, tail), what) for unit_id, tail, what in drawn}
    before, after = IndexWriter(pipeline), IndexWriter(pipeline)
    for item, what in whole.values():
        (after if what == "new" else before).add(item)
    old = before.finish().table
    kept = [whole[unit_id][1] == "kept" for unit_id in old.column("unit_id").to_pylist()]
    index = after.finish(old.filter(pa.array(kept, pa.bool_())))
    expected = sorted((item for item, what in whole.values() if what != "gone"), key=lambda r: r.unit_id.encode())
    assert [*index.receipts(pipeline)] == expected
    assert [*index.receipts(pipeline, range(len(expected))[::-1])] == expected[::-1]
    assert [index.row_of(item.unit_id) for item in expected] == [*range(len(expected))]
    assert {index.row_of(item.unit_id) for item, what in whole.values() if what == "gone"} <= {-1}
    assert [index.value(row, "unit_id") for row in range(len(index))] == [item.unit_id for item in expected]


def test_an_index_survives_a_stage_that_is_new(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(4), store)
    old = Snapshot.open(store).index
    longer = replace(toys.pipeline(), stages=(toys.Count(), toys.Square(), toys.Word(name="sentence")), tables={})
    merged = IndexWriter(longer).finish(old.table)
    assert merged.table.schema == index_schema(longer)
    assert len(merged) == 4
    assert [s.stage for s in merged.receipt(0, longer).stages] == ["count", "square"]


def test_a_damaged_index_is_told_from_a_sound_one(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(4), store)
    snapshot = Snapshot.open(store)
    path = store.root / Index.path(snapshot.index_hash)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(CorruptShardError, match="differs"):
        assert snapshot.index
    # A run does without: everything is committed, and the index is written anew.
    report = run(toys.pipeline(), toys.units(4), store)
    assert (report.counts["made"], report.counts["reused"], report.snapshot_id) == (0, 4, snapshot.snapshot_id)


@given(st.lists(st.sampled_from([0.0, 0.5, 3.0]) | st.floats(0, 10), max_size=300), st.integers(1, 8))
def test_tasks_hold_every_unit_once_and_the_biggest_first(costs: list[float], workers: int) -> None:
    work = [Work(toys.unit(f"a/{n}"), b"", cost, 10 * n) for n, cost in enumerate(costs)]
    found = [*tasks(work, 3, workers)]
    # Equal costs keep the order they came in; one worker takes the smallest first.
    order = sorted(work, key=lambda item: item.seconds if workers == 1 else -item.seconds)
    assert [item for task in found for item in task.work] == order
    share = sum(costs) / workers
    for task in found:
        assert task.memory == max(item.memory for item in task.work)
        assert len(task.work) <= TASK_UNITS
        # Without its last unit a task is below its share, so none outweighs what balance allows by more than one unit.
        assert sum(item.seconds for item in task.work[:-1]) <= min(2.0, share / 4) + 1e-9


def test_memory_is_learned_from_what_was_published(store: LocalStore) -> None:
    units = toys.units(6)
    run(toys.pipeline(), units, store)
    index = Snapshot.open(store).index
    planner = Planner(toys.pipeline(), Commits(store), index, {})
    known, new = [*planner.work([units[0], toys.unit("a/new")])]
    stages = index.receipt(index.row_of(units[0].unit_id), toys.pipeline()).stages
    assert known.memory == int(1.25 * max(stage.peak_rss for stage in stages))
    assert new.memory == new.unit.memory


class Writing(toys.Total):
    """An aggregate that writes a temporary file."""

    def build(self, tables: Iterator[tuple[str, Mapping[str, pa.Table]]]) -> pa.Table:
        file = ArrayFile(1)
        file.append(np.arange(1 << 21))
        return pa.table({"total": [len([*file])]})


def full_disk(*_: object, **__: object) -> BinaryIO:
    """A temporary file on a disk that is full."""
    return open("/dev/full", "w+b")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_a_full_temporary_disk_is_named(monkeypatch: pytest.MonkeyPatch, store: LocalStore) -> None:
    monkeypatch.setattr("tempfile.TemporaryFile", full_disk)
    with pytest.raises(StoreError, match="no space left for temporary files") as told:
        build_aggregate(Writing(), Commits(store), [])
    assert told.value.where == tempfile.gettempdir()
    assert "TMPDIR" in str(told.value)


def test_hashes_are_remembered_until_a_file_changes(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    path = tmp_path / "data" / "x.bin"
    path.write_bytes(b"one")
    old = time.time() - 100
    os.utime(path, (old, old))
    memory = FileHashes(tmp_path / "hashes.sqlite")
    first = memory.file(tmp_path / "data", "x.bin")
    assert (first.path, first.size, first.sha256) == ("x.bin", 3, hash_file(path))
    memory.save()
    # The same stat is believed without reading: to prove it, the content is changed behind its back.
    path.write_bytes(b"two")
    os.utime(path, (old, old))
    assert FileHashes(tmp_path / "hashes.sqlite").file(tmp_path / "data", "x.bin") == first
    # Unless it is not to be trusted; what is found then is what is known from now on.
    suspicious = FileHashes(tmp_path / "hashes.sqlite", trust=False)
    assert suspicious.file(tmp_path / "data", "x.bin").sha256 == hash_file(path)
    suspicious.save()
    assert FileHashes(tmp_path / "hashes.sqlite").file(tmp_path / "data", "x.bin").sha256 == hash_file(path)
    os.utime(path, (old + 1, old + 1))
    assert FileHashes(tmp_path / "hashes.sqlite").file(tmp_path / "data", "x.bin").sha256 == hash_file(path)


def test_a_memory_that_another_process_writes_to_is_left_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x").write_bytes(b"one")
    os.utime(tmp_path / "x", (1, 1))
    place = tmp_path / "hashes.sqlite"
    memory = FileHashes(place)
    memory.file(tmp_path, "x")
    memory.save()
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda path, timeout: connect(path, timeout=0))
    with contextlib.closing(connect(place, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        assert FileHashes(place).file(tmp_path, "x").sha256 == hash_file(tmp_path / "x")
        other.execute("UPDATE hashes SET size = size")
        other.execute("COMMIT")
        assert other.execute("SELECT count(*) FROM hashes").fetchall() == [(1,)]
    assert place.exists()


def test_fresh_files_and_damaged_memories_are_not_trusted(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"one")
    memory = FileHashes(tmp_path / "hashes.sqlite")
    stat = path.stat()
    memory.file(tmp_path, "x")
    memory.save()
    path.write_bytes(b"two")
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert memory.file(tmp_path, "x").sha256 == hash_file(path), "written within the clock's tick"
    (tmp_path / "hashes.sqlite").write_bytes(b"not a database, but long enough to look at" * 100)
    assert FileHashes(tmp_path / "hashes.sqlite").file(tmp_path, "x").sha256 == hash_file(path)
    with pytest.raises(MissingFileError, match="gone"):
        memory.file(tmp_path, "gone")
