"""The unit index, the spool, the queue, the memory of hashes: the parts a run is made of."""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import pickle
import sqlite3
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st

import factory.index as index_module
import factory.scratch as scratch_module
from condvln.instructions.array_file import ArrayFile
from factory import FileHashes, LocalStore, Snapshot, hash_file, run
from factory.commits import Commits
from factory.flags import Flags
from factory.index import Index, IndexWriter, index_schema
from factory.packing import Members, buckets
from factory.pins import build_aggregate
from factory.planner import Planner
from factory.queue import TASK_UNITS, Queue, WorkSpool
from factory.receipt import Failure, Receipt, StageReceipt, TableReceipt
from factory.scratch import BatchedTable, Scratch, batches, let_go
from factory.spool import Spool
from factory.unit import Work
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


@given(
    st.lists(st.tuples(ids, st.integers(0, 200)), max_size=30, unique_by=lambda pair: pair[0]),
    st.lists(ids, max_size=5),
)
def test_an_index_gives_back_what_was_put_in(pairs: list[tuple[str, int]], others: list[str]) -> None:
    pipeline = toys.pipeline()
    writer = IndexWriter(pipeline)
    receipts = [receipt(unit_id, tail) for unit_id, tail in pairs]
    for item in receipts:
        writer.add(item)
    index = Index(writer.finish(None))
    assert index.table.column("unit_id").to_pylist() == sorted((r.unit_id for r in receipts), key=str.encode)
    rows = index.rows_of([r.unit_id for r in receipts])
    assert [index.receipt(int(row), pipeline) for row in rows] == receipts
    known = {r.unit_id for r in receipts}
    assert [row >= 0 for row in index.rows_of(others)] == [other in known for other in others]


@pytest.mark.parametrize("rows", [2, 7, 1000])
@given(
    st.lists(st.tuples(ids, st.integers(0, 200), st.sampled_from(["kept", "gone", "new"])), max_size=40),
)
def test_an_index_on_disk_is_the_one_in_memory(rows: int, drawn: list[tuple[str, int, str]]) -> None:
    pipeline = toys.pipeline()
    whole = {unit_id: (receipt(unit_id, tail), what) for unit_id, tail, what in drawn}
    with pytest.MonkeyPatch.context() as patch:
        for module in (index_module, scratch_module):
            patch.setattr(module, "BATCH_ROWS", rows)
        patch.setattr(index_module, "_BATCH", 3)
        patch.setattr(index_module, "_RUN_ROWS", 2 * rows)
        patch.setattr(index_module, "_STEP", max(rows // 3, 1))
        patch.setattr(index_module, "_FAN_IN", 2)
        patch.setattr(index_module, "_SINGLY", 2)
        patch.setattr(index_module, "_PIECE", max(rows // 4, 1))
        before = IndexWriter(pipeline)
        for item, what in whole.values():
            if what != "new":
                before.add(item)
        old = before.finish(None)
        kept = Flags(old.num_rows)
        for row, unit_id in enumerate(old.whole().column("unit_id").to_pylist()):
            kept[row] = whole[unit_id][1] == "kept"
        after = IndexWriter(pipeline)
        for item, what in whole.values():
            if what == "new":
                after.add(item)
        index = Index(after.finish(old, kept))
        expected = sorted((item for item, what in whole.values() if what != "gone"), key=lambda r: r.unit_id.encode())
        assert [*index.receipts(range(len(index)), pipeline)] == expected
        assert index.rows_of([item.unit_id for item in expected]).tolist() == [*range(len(expected))]
        assert (index.rows_of([item.unit_id for item, what in whole.values() if what == "gone"]) == -1).all()
        sizes = [batch.num_rows for batch in index.table.to_batches()]
        assert sizes == [rows] * (len(expected) // rows) + [len(expected) % rows] * (len(expected) % rows > 0)
        back = np.arange(len(index))[::-1]
        names = index.table.column_names
        assert index.take(back, names).to_pylist() == index.table.to_pylist()[::-1]
        assert [index.value(int(row), "unit_id") for row in back] == [r.unit_id for r in expected[::-1]]


def test_ids_that_are_not_there_are_told_from_their_neighbours() -> None:
    writer = IndexWriter(toys.pipeline())
    for tail in range(9):
        writer.add(receipt(f"a/{tail}", tail))
    index = Index(writer.finish(None))
    assert index.rows_of(["a/8", "b", "a/0", "a/4", ""]).tolist() == [8, -1, 0, 4, -1]


def test_an_index_of_row_groups_of_another_size_is_read(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    units = toys.units(40)
    run(toys.pipeline(), units, store)
    snapshot = Snapshot.open(store)
    whole = snapshot.index().table
    for module in (index_module, scratch_module):
        monkeypatch.setattr(module, "BATCH_ROWS", 4)
    monkeypatch.setattr(index_module, "_GROUP_ROWS", 6)
    assert snapshot.index().table.equals(whole)
    # Nothing changed, so nothing is published; a changed unit gives an index of row groups of the new size.
    assert not run(toys.pipeline(), units, store).published
    assert run(toys.pipeline(), units[1:], store).published
    later = Snapshot.open(store)
    with store.open(Index.path(later.index_hash)) as file:
        groups = pq.ParquetFile(file).metadata
        assert [groups.row_group(at).num_rows for at in range(groups.num_row_groups)] == [6] * 6 + [3]
    assert later.index().table.equals(whole.filter(pc.not_equal(whole.column("unit_id"), units[0].unit_id)))


def test_what_a_scratch_holds_lasts_as_long_as_its_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scratch_module, "BATCH_ROWS", 4)
    whole = pa.table({"n": range(30), "text": [str(n) for n in range(30)]})
    scratch = Scratch(whole.schema)
    for batch in whole.to_batches(max_chunksize=4):
        scratch.write(batch)
    found = scratch.table()
    del scratch
    let_go()
    assert found.whole().equals(whole)
    assert [start for start, _ in batches(found)] == [*range(0, 30, 4)]
    # A mapped table takes none of Arrow's memory.
    before = pa.total_allocated_bytes()
    assert sum(batch.num_rows for _, batch in batches(found, ["text"])) == 30
    assert pa.total_allocated_bytes() == before


@pytest.mark.parametrize("count", [1, 2, 16, 64])
def test_members_are_divided_by_the_hash_of_their_ids(count: int) -> None:
    names = [f"a/{n}" for n in range(300)]
    tables = [
        pa.table({"unit_id": part, "hash": [name.encode() for name in part], "bytes": [len(name) for name in part]})
        for part in (names[:100], names[100:101], names[101:])
    ]
    expected: dict[int, list[str]] = {}
    for name in names:
        expected.setdefault(zlib.crc32(name.encode()) % count, []).append(name)
    found = [*buckets(Members(lambda: tables), count)]
    assert [number for number, _ in found] == sorted(expected)
    for number, members in found:
        for seen in (members, members, pickle.loads(pickle.dumps(members))):
            assert [name for table in seen for name in table.column("unit_id").to_pylist()] == expected[number]
    assert len([*buckets(Members.of([]), count)]) == (count == 1)


def test_an_index_survives_a_stage_that_is_new(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(4), store)
    old = Snapshot.open(store).index()
    longer = replace(toys.pipeline(), stages=(toys.Count(), toys.Square(), toys.Word(name="sentence")), tables={})
    merged = IndexWriter(longer).finish(old.rows)
    assert merged.schema == index_schema(longer)
    assert merged.num_rows == 4
    assert [s.stage for s in Index(merged).receipt(0, longer).stages] == ["count", "square"]


def test_a_damaged_index_is_told_from_a_sound_one(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(4), store)
    snapshot = Snapshot.open(store)
    path = store.root / Index.path(snapshot.index_hash)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(CorruptShardError, match="differs"):
        snapshot.index()
    # A run does without: everything is committed, and the index is written anew.
    report = run(toys.pipeline(), toys.units(4), store)
    assert (report.counts["made"], report.counts["reused"], report.snapshot_id) == (0, 4, snapshot.snapshot_id)


def test_a_spool_gives_items_back_in_any_order() -> None:
    items = [f"item {n}" * (n % 50) for n in range(500)]
    with Spool(items) as spool:
        assert [*spool] == items
        assert [spool[at] for at in (499, 0, 250)] == [items[499], items[0], items[250]]
        spool.append("more")
        assert (spool[500], len(spool)) == ("more", 501)
        assert [*spool] == [*items, "more"]
        with pytest.raises(IndexError):
            spool[501]


# Costs are kept in single precision, so that two of them that differ by less are equal.
@given(st.lists(st.floats(2**-10, 10, width=32), min_size=1, max_size=300), st.integers(1, 8))
def test_tasks_hold_every_unit_once_and_the_biggest_first(costs: list[float], workers: int) -> None:
    work = [Work(toys.unit(f"a/{n}"), b"", cost, 10 * n) for n, cost in enumerate(costs)]
    with WorkSpool(work) as spool:
        tasks = [*Queue(spool, 3, workers)]
        backwards = [item.seconds for task in Queue(spool, 3, workers).smallest_first() for item in task.work]
    assert sorted(item.unit.unit_id for task in tasks for item in task.work) == sorted(w.unit.unit_id for w in work)
    order = [item.seconds for task in tasks for item in task.work]
    assert order == sorted(order, reverse=True)
    assert backwards == sorted(order)
    share = sum(costs) / workers
    for task in tasks:
        assert task.memory == max(item.memory for item in task.work)
        assert len(task.work) <= TASK_UNITS
        # Without its last unit a task is below its share, so none outweighs what balance allows by more than one unit.
        assert task.seconds - task.work[-1].seconds <= min(2.0, share / 4) + 1e-9


def test_memory_is_learned_from_what_was_published(store: LocalStore) -> None:
    units = toys.units(6)
    run(toys.pipeline(), units, store)
    index = Snapshot.open(store).index()
    planner = Planner(toys.pipeline(), Commits(store), index, {})
    known, new = [*planner.work([units[0], toys.unit("a/new")])]
    stages = index.receipt(int(index.rows_of([units[0].unit_id])[0]), toys.pipeline()).stages
    assert known.memory == int(1.25 * max(stage.peak_rss for stage in stages))
    assert new.memory == new.unit.memory


@pytest.mark.parametrize(
    ("units", "what"),
    [
        ([("b", "ok"), ("a", "ok")], "do not ascend"),
        ([("a", "ok"), ("c", "ok"), ("b", "ok")], "do not ascend"),
        ([("a", "ok"), ("a", "ok")], "do not ascend"),
        ([("a", "ok"), ("b", "partial")], "unknown status"),
    ],
)
@pytest.mark.parametrize("rows", [1, 2, 1000])
def test_a_foreign_index_that_cannot_be_merged_is_refused(
    store: LocalStore, monkeypatch: pytest.MonkeyPatch, units: list[tuple[str, str]], what: str, rows: int
) -> None:
    monkeypatch.setattr(index_module, "BATCH_ROWS", rows)
    tables = []
    for unit_id, status in units:
        writer = IndexWriter(toys.pipeline())
        writer.add(replace(receipt(unit_id, 1), status=status))  # type: ignore[arg-type]
        tables.append(writer.finish(None).whole())
    name = Index.write(store, BatchedTable.of(pa.concat_tables(tables)))
    with pytest.raises(CorruptShardError, match=what):
        Index.read(store, name)


def full_disk(*_: object, **__: object) -> BinaryIO:
    """A temporary file on a disk that is full."""
    return open("/dev/full", "w+b")


def spooled() -> None:
    with Spool(range(10)) as spool:
        for _ in range(4):
            spool.append("x" * 400_000)  # type: ignore[arg-type]
        list(spool)


def scratched() -> None:
    batch = pa.record_batch({"a": np.arange(2 * scratch_module.BATCH_ROWS)})
    scratch = Scratch(batch.schema)
    scratch.write(batch)
    scratch.table()


class Writing(toys.Total):
    """An aggregate that writes a temporary file."""

    def build(self, tables: Iterator[tuple[str, Mapping[str, pa.Table]]]) -> pa.Table:
        file = ArrayFile(1)
        file.append(np.arange(1 << 21))
        return pa.table({"total": [len([*file])]})


def aggregated() -> None:
    build_aggregate(Writing(), Commits(LocalStore(tempfile.gettempdir())), [])


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
@pytest.mark.parametrize("write", [spooled, scratched, aggregated], ids=["spool", "scratch", "aggregate"])
def test_a_full_temporary_disk_is_named(
    write: Callable[[], None], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.TemporaryFile", full_disk)
    with pytest.raises(StoreError, match="no space left for temporary files") as told:
        write()
    assert told.value.where == tempfile.gettempdir()
    assert "TMPDIR" in str(told.value)
    del told
    gc.collect()
    assert capsys.readouterr().err == "", "closing the files says nothing more"


def test_an_index_on_a_failing_disk_is_an_error_of_the_store(
    store: LocalStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = Index.write(store, IndexWriter(toys.pipeline()).finish(None))

    def failing(file: BinaryIO) -> str:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(index_module, "_hash_of", failing)
    with pytest.raises(StoreError, match="can't be read") as told:
        Index.read(store, name)
    assert name in str(told.value)


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
