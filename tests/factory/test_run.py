"""The job as a whole, inline: what is published, what is redone, what is set aside."""

from __future__ import annotations

import multiprocessing
import random
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import toys

from benchmarks.factory_overhead import measure_scale
from factory.planner import Plan
from factory.receipt import Receipt
from factory.report import Progress
from factory.rows import parquet_bytes
from factory.run import plan, run
from factory.snapshot import Snapshot
from factory.store import LocalStore
from schemas.errors import CorruptShardError, UsageError


def test_the_published_rows_are_those_the_stages_compute(store: LocalStore) -> None:
    units = toys.units(12)
    report = run(toys.pipeline(), units, store)
    assert (report.exit_code, report.published) == (0, True)
    table = Snapshot.open(store).table("squares")
    total = sum(unit.inputs[0].size for unit in units)
    expected = sorted(
        (unit.unit_id, n, float(n * n + total % 2), unit.partition)
        for unit in units
        for n in range(unit.inputs[0].size)
    )
    found = [(row["unit"], row["n"], row["square"], row["source"]) for row in table.to_pylist()]
    assert sorted(found) == expected
    for path in [store.root / path for path in Snapshot.open(store).paths("squares")]:
        assert pq.read_schema(path).remove_metadata() == toys.SQUARES
        rows = [(row["unit"], row["n"]) for row in pq.ParquetFile(path).read().to_pylist()]
        assert rows == sorted(rows)


def test_any_order_and_any_history_give_one_id_and_equal_bytes(tmp_path: Path) -> None:
    units = toys.units(20)
    first = LocalStore(tmp_path / "1", durable=False)
    whole = run(toys.pipeline(), units, first)

    shuffled = units.copy()
    random.Random(1).shuffle(shuffled)
    second = LocalStore(tmp_path / "2", durable=False)
    assert run(toys.pipeline(), shuffled, second).snapshot_id == whole.snapshot_id
    assert toys.files(second, whole.snapshot_id) == toys.files(first, whole.snapshot_id)  # type: ignore[arg-type]

    # By way of another corpus: other units first, then a change of some, then back. The aggregate counts all numbers,
    # so it is renewed on the way back.
    third = LocalStore(tmp_path / "3", durable=False)
    other = [toys.unit(u.unit_id, 3, partition=u.partition, content="x") for u in units[:15]]
    assert run(toys.pipeline(), other, third).snapshot_id != whole.snapshot_id
    assert run(toys.pipeline(), units, third, renew=("total",)).snapshot_id == whole.snapshot_id
    assert toys.files(third, whole.snapshot_id) == toys.files(first, whole.snapshot_id)  # type: ignore[arg-type]


def test_many_parts_hold_the_same_rows(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "s", durable=False)
    report = run(toys.pipeline(), toys.units(40), store, part_bytes=200)
    snapshot = Snapshot.open(store)
    parts = snapshot.manifest.tables["squares"].partitions["a"].parts
    assert len(parts) > 2
    assert (
        report.snapshot_id
        == run(toys.pipeline(), toys.units(40), LocalStore(tmp_path / "t", durable=False)).snapshot_id
    )
    assert snapshot.table("squares").num_rows == sum(unit.inputs[0].size for unit in toys.units(40))
    # One changed unit rewrites one part of a table; the others are the same files.
    changed = toys.units(40)
    changed[3] = toys.unit(changed[3].unit_id, 2, partition="b")
    before = {part.content: part for part in snapshot.manifest.tables["squares"].partitions["b"].parts}
    run(toys.pipeline(), changed, store, part_bytes=200)
    after = {part.content: part for part in Snapshot.open(store).manifest.tables["squares"].partitions["b"].parts}
    assert len(set(after) - set(before)) <= 1
    inodes = {
        (store.root / "snapshots" / report.snapshot_id / before[c].path).stat().st_ino  # type: ignore[operator]
        for c in set(after) & set(before)
    }
    now = Snapshot.open(store).snapshot_id
    assert inodes == {(store.root / "snapshots" / now / after[c].path).stat().st_ino for c in set(after) & set(before)}


def test_nothing_to_do_publishes_nothing(store: LocalStore, tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.mkdir()
    units = toys.units(8, log=str(log))
    first = run(toys.pipeline(), units, store)
    before = toys.counts(log)
    ref = (store.root / "refs/main.json").read_bytes()
    second = run(toys.pipeline(), units, store)
    assert (second.snapshot_id, second.published, second.exit_code) == (first.snapshot_id, False, 0)
    assert second.counts["fresh"] == 8
    assert toys.counts(log) == before
    assert (store.root / "refs/main.json").read_bytes() == ref


def test_changing_one_unit_of_many_redoes_one(store: LocalStore, tmp_path: Path) -> None:
    units = toys.units(50)
    run(toys.pipeline(), units, store)
    log = tmp_path / "log"
    log.mkdir()
    changed = [*toys.units(50, log=str(log))]
    changed[10] = toys.unit(changed[10].unit_id, 6, partition="a", content="new", log=str(log))
    found = plan(toys.pipeline(), changed, store)
    assert found.counts == {"FRESH": 49, "STALE": 1}
    assert found.reasons == {"data": 1}
    report = run(toys.pipeline(), changed, store)
    assert report.counts["made"] == 1
    assert set(toys.counts(log)) == {
        f"{changed[10].unit_id.replace('/', '_')}.{s}" for s in ("count", "square", "word")
    }


def stages_of(found: Plan) -> Counter[tuple[str, str]]:
    """How many units have each stage in each state."""
    return Counter(stage for entry in found.entries for stage in entry.stages)


def test_a_wording_change_redoes_words_only(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(9), store)
    reworded = toys.pipeline(word=toys.Word(phrase="altogether"))
    found = plan(reworded, toys.units(9), store)
    assert found.reasons == {"parameters": 8}
    stages = stages_of(found)
    assert stages["word", "STALE"] == stages["square", "FRESH"] == 8
    assert run(reworded, toys.units(9), store).stages == {"word": 8}


def test_an_equal_output_spares_what_is_behind_it(store: LocalStore) -> None:
    """Early cut-off: the first stage runs again under a new version, gives the same rows, and that is the end of it."""
    first = run(toys.pipeline(), toys.units(9), store)
    bumped = toys.pipeline(count=toys.Count(version=2))
    found = plan(bumped, toys.units(9), store)
    assert found.reasons == {"code": 9}
    stages = stages_of(found)
    assert stages["count", "STALE"] == stages["square", "POSSIBLE"] == stages["word", "POSSIBLE"] == 9
    report = run(bumped, toys.units(9), store)
    assert report.stages == {"count": 9}
    assert report.snapshot_id == first.snapshot_id
    assert plan(bumped, toys.units(9), store).empty


def test_only_the_bits_that_are_read_of_an_aggregate_make_stale(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(9), store)
    # Two numbers more: the total changes, its parity (all that is read of it) does not.
    units = [*toys.units(9), toys.unit("a/new", 2)]
    report = run(toys.pipeline(), units, store, renew=("total",))
    assert report.stages == {"count": 1, "square": 1, "word": 1}
    # One number more flips the parity, and with it the one dependency.
    units = [*units, toys.unit("a/newer", 1)]
    pinned = run(toys.pipeline(), units, store)
    assert pinned.stages == {"count": 1, "square": 1, "word": 1}, "a pinned aggregate makes nothing stale"
    renewed = run(toys.pipeline(), units, store, renew=("total",))
    assert renewed.stages["count"] == 0
    assert renewed.stages["square"] == 10


@pytest.mark.parametrize("how", ["renewed", "another version"])
def test_units_behind_an_aggregate_that_is_built_again_may_be_stale(store: LocalStore, how: str) -> None:
    """It may turn out as it was: nothing of them is missing, and no certain cost is named."""
    run(toys.pipeline(), toys.units(9), store)
    total = toys.Total(version=1 + (how == "another version"))
    found = plan(toys.pipeline(total=total), toys.units(9), store, renew=("total",) if how == "renewed" else ())
    assert found.renewed == ("total",)
    assert (found.counts, found.reasons) == ({"STALE": 8, "FRESH": 1}, {"dependency": 8}), "one was skipped before"
    assert stages_of(found) == {("count", "FRESH"): 9, ("square", "POSSIBLE"): 8, ("word", "POSSIBLE"): 8}
    assert found.seconds == 0.0 < found.possible_seconds


class Order(toys.Total):
    """An aggregate that notes the ids of its units as they come."""

    def build(self, tables: Iterator[tuple[str, Mapping[str, pa.Table]]]) -> pa.Table:
        self.came = [unit_id for unit_id, _ in tables]
        return pa.table({"total": [len(self.came)]})


def test_units_come_to_an_aggregate_in_the_order_of_their_ids(store: LocalStore) -> None:
    """Not as they were done, the cheapest first: sums of floats depend on it."""
    order, done = Order(), []

    class Done(Progress):
        def unit(self, receipt: Receipt) -> None:
            done.append(receipt.unit_id)

    assert run(toys.pipeline(total=order), toys.units(12), store, progress=Done()).published
    first = done[:12]
    assert first != sorted(first)
    skipped = {"b/u00007"}
    assert order.came == sorted({*first} - skipped)


def test_an_aggregate_with_other_parameters_is_built_again(store: LocalStore) -> None:
    units = toys.units(12)
    first = run(toys.pipeline(), units, store)
    odd = toys.pipeline(total=toys.Total(more=1))
    assert plan(odd, units, store).renewed == ("total",)
    changed = run(odd, units, store)
    assert changed.stages["square"] == 11, "all but the skipped one read its parity"
    assert changed.snapshot_id != first.snapshot_id
    assert plan(odd, units, store).renewed == ()
    assert run(toys.pipeline(), units, store).snapshot_id == first.snapshot_id


def test_added_and_removed_and_moved_units(store: LocalStore) -> None:
    units = toys.units(10)
    whole = run(toys.pipeline(), units, store)
    found = plan(toys.pipeline(), units[1:], store)
    assert found.removed == (units[0].unit_id,)
    fewer = run(toys.pipeline(), units[1:], store)
    assert (fewer.counts["removed"], fewer.counts["made"]) == (1, 0)
    assert units[0].unit_id not in Snapshot.open(store).table("states")["unit"].to_pylist()
    back = run(toys.pipeline(), units, store)
    assert (back.snapshot_id, back.counts["made"], back.counts["reused"]) == (whole.snapshot_id, 0, 1)
    moved = [toys.unit(units[2].unit_id, units[2].inputs[0].size, partition="c"), *units[:2], *units[3:]]
    assert plan(toys.pipeline(), moved, store).reasons == {"partition": 1}
    report = run(toys.pipeline(), moved, store)
    assert report.counts["made"] == 0
    assert Snapshot.open(store).table("numbers", partition="c").num_rows == units[2].inputs[0].size


def test_files_of_a_unit_are_kept(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(5), store)
    snapshot = Snapshot.open(store)
    assert snapshot.unit_files("a/u00004", toys.pipeline()) == {"blob.bin": bytes(5)}
    for path in (store.root / "units/square").rglob("unit.json"):
        path.unlink()
    with pytest.raises(CorruptShardError, match="missing or damaged"):
        snapshot.unit_files("a/u00004", toys.pipeline())


def test_a_table_that_only_a_unit_keeps_is_read_by_its_hash(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(5), store)
    snapshot = Snapshot.open(store)
    kept = snapshot.unit_table("a/u00004", toys.pipeline(), "scratch")
    assert kept.column_names == ["sum"]
    for entry in store.list("units/square"):
        if entry.path.endswith("scratch.parquet"):
            store.write(entry.path, parquet_bytes(pa.table({"sum": [-1.0]})))
    with pytest.raises(CorruptShardError, match="differ"):
        snapshot.unit_table("a/u00004", toys.pipeline(), "scratch")


def test_two_units_with_one_id_are_refused(store: LocalStore) -> None:
    with pytest.raises(UsageError, match="the same id"):
        run(toys.pipeline(), [toys.unit("a/x"), toys.unit("a/x", 3)], store)
    run(toys.pipeline(), [toys.unit("a/x"), toys.unit("a/y")], store)
    for twice in ("a/x", "a/z"):
        with pytest.raises(UsageError, match="the same id"):
            plan(toys.pipeline(), [toys.unit("a/x"), toys.unit("a/y"), toys.unit(twice), toys.unit("a/z")], store)


@pytest.mark.soak
def test_the_driver_of_twelve_thousand_units_takes_less_than_a_gibibyte() -> None:
    """As many as the largest dataset has; in a process of its own, whose peak is the driver's."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(measure_scale, (12_000,)).peak < 2**30
