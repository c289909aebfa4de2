"""The job as a whole, inline: what is published, what is redone, what is set aside."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import toys

from factory import LocalStore, Snapshot, plan, run
from factory.commits import Commits
from factory.receipt import Receipt
from factory.report import Silence
from factory.rows import parquet_bytes
from schemas.errors import CorruptShardError, MissingFileError, StoreError, UsageError


def files(store: LocalStore, snapshot_id: str) -> dict[str, bytes]:
    """Every Parquet file of a snapshot."""
    folder = store.root / "snapshots" / snapshot_id
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.parquet"))}


def counts(folder: Path) -> dict[str, int]:
    """How often each stage ran for each unit."""
    return {path.name: len(path.read_text().splitlines()) for path in folder.iterdir()}


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
    for path in Snapshot.open(store).local_paths("squares"):
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
    assert files(second, whole.snapshot_id) == files(first, whole.snapshot_id)  # type: ignore[arg-type]

    # By way of another corpus: other units first, then a change of some, then back. The aggregate counts all numbers,
    # so it is renewed on the way back.
    third = LocalStore(tmp_path / "3", durable=False)
    other = [toys.unit(u.unit_id, 3, partition=u.partition, content="x") for u in units[:15]]
    assert run(toys.pipeline(), other, third).snapshot_id != whole.snapshot_id
    assert run(toys.pipeline(), units, third, renew=("total",)).snapshot_id == whole.snapshot_id
    assert files(third, whole.snapshot_id) == files(first, whole.snapshot_id)  # type: ignore[arg-type]


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
    before = counts(log)
    ref = (store.root / "refs/main.json").read_bytes()
    second = run(toys.pipeline(), units, store)
    assert (second.snapshot_id, second.published, second.exit_code) == (first.snapshot_id, False, 0)
    assert second.counts["fresh"] == 8
    assert counts(log) == before
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
    assert set(counts(log)) == {f"{changed[10].unit_id.replace('/', '_')}.{s}" for s in ("count", "square", "word")}


def test_a_wording_change_redoes_words_only(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(9), store)
    reworded = toys.pipeline(word=toys.Word(phrase="altogether"))
    found = plan(reworded, toys.units(9), store)
    assert found.reasons == {"parameters": 8}
    assert found.stages["word STALE"] == 8
    assert found.stages["square FRESH"] == 8
    assert run(reworded, toys.units(9), store).stages == {"word": 8}


def test_an_equal_output_spares_what_is_behind_it(store: LocalStore) -> None:
    """Early cut-off: the first stage runs again under a new version, gives the same rows, and that is the end of it."""
    first = run(toys.pipeline(), toys.units(9), store)
    bumped = toys.pipeline(count=toys.Count(version=2))
    found = plan(bumped, toys.units(9), store)
    assert found.reasons == {"code": 9}
    assert found.stages["count STALE"] == 9
    assert found.stages["square POSSIBLE"] == found.stages["word POSSIBLE"] == 9
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


def test_a_renamed_unit_is_known_by_its_bytes(store: LocalStore) -> None:
    units = toys.units(6)
    run(toys.pipeline(), units, store)
    old = units[3]
    file = replace(old.inputs[0], path="elsewhere/new.json")
    renamed = [*units[:3], replace(old, unit_id="b/renamed", inputs=(file,)), *units[4:]]
    found = plan(toys.pipeline(), renamed, store)
    assert (found.renamed, found.removed) == (((old.unit_id, "b/renamed"),), (old.unit_id,))
    report = run(toys.pipeline(), renamed, store)
    assert (report.counts["made"], report.counts["removed"]) == (1, 1)
    numbers = Snapshot.open(store).table("numbers")["unit"].to_pylist()
    assert (numbers.count("b/renamed"), numbers.count(old.unit_id)) == (old.inputs[0].size, 0)


def test_an_unchanged_corpus_is_planned_from_a_handful_of_files(
    store: LocalStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many units there are: never one small read for each."""
    read: list[str] = []
    for name in ("read", "exists"):
        real = getattr(LocalStore, name)
        monkeypatch.setattr(LocalStore, name, lambda self, path, real=real: (read.append(path), real(self, path))[1])
    seen = []
    for count in (6, 60):
        ref = f"corpus-{count}"
        run(toys.pipeline(), toys.units(count), store, ref)
        read.clear()
        assert plan(toys.pipeline(), toys.units(count), store, ref).empty
        assert not run(toys.pipeline(), toys.units(count), store, ref).published
        seen.append([path.split("/")[0] for path in read])
    assert seen[0] == seen[1]
    assert len(seen[1]) <= 12
    assert "units" not in seen[1]


@pytest.mark.soak
def test_changing_one_unit_of_a_thousand_redoes_one(store: LocalStore) -> None:
    units = toys.units(1000)
    run(toys.pipeline(), units, store)
    units[500] = toys.unit(units[500].unit_id, 3, partition="a", content="new")
    report = run(toys.pipeline(), units, store)
    assert (report.counts["made"], report.counts["fresh"]) == (1, 999)
    assert report.stages == {"count": 1, "square": 1, "word": 1}
    reworded = run(toys.pipeline(word=toys.Word(phrase="in all")), units, store)
    assert set(reworded.stages) == {"word"}


def test_skipped_is_not_quarantined(store: LocalStore) -> None:
    units = [*toys.units(6), toys.unit("a/none", 0)]
    report = run(toys.pipeline(), units, store)
    assert (report.exit_code, report.counts["skipped"], report.counts["quarantined"]) == (0, 1, 0)
    states = {row["unit"]: row for row in Snapshot.open(store).table("states").to_pylist()}
    assert states["a/none"] == {"unit": "a/none", "status": "skipped", "reason": "empty", "source": "a"}
    again = run(toys.pipeline(), units, store)
    assert (again.counts["fresh"], again.counts["skipped"]) == (7, 1)


@pytest.mark.parametrize(
    ("trouble", "cause", "exception", "attempts"),
    [
        ("format", "input", "FormatError", 1),
        ("error", "error", "ZeroDivisionError", 1),
        ("exit", "error", "SystemExit", 1),
        ("memory", "memory", "MemoryCeilingError", 1),
    ],
)
def test_a_failing_unit_is_set_aside_and_the_others_go_on(
    store: LocalStore, tmp_path: Path, trouble: str, cause: str, exception: str, attempts: int
) -> None:
    log = tmp_path / "log"
    log.mkdir()
    units = [*toys.units(5), toys.unit("a/bad", 4, trouble=trouble, log=str(log))]
    report = run(toys.pipeline(), units, store)
    assert report.exit_code == 3
    assert [(name, f.stage, f.cause, f.exception) for name, f in report.failures] == [
        ("a/bad", "count", cause, exception)
    ]
    assert counts(log) == {"a_bad.count": attempts}
    record = Commits(store).quarantine_record("count", report.failures[0][1].key.hex())
    assert record is not None
    assert (record.unit_id, record.cause, record.attempts) == ("a/bad", cause, attempts)
    assert "in misbehave" in record.traceback
    assert record.peak_rss > 0
    # The others are published as if it were not there.
    assert set(Snapshot.open(store).table("states")["unit"].to_pylist()) == {u.unit_id for u in units[:5]}
    # It is not tried again until its key changes or someone asks.
    assert run(toys.pipeline(), units, store).exit_code == 3
    assert counts(log) == {"a_bad.count": attempts}
    assert plan(toys.pipeline(), units, store).counts["QUARANTINED"] == 1
    run(toys.pipeline(), units, store, retry_quarantined=True)
    assert counts(log) == {"a_bad.count": 2 * attempts}
    # The payload is not keyed, so a cured cause outside the key needs the asking, and then the record goes.
    corrected = [*units[:5], toys.unit("a/bad", 4)]
    report = run(toys.pipeline(), corrected, store, retry_quarantined=True)
    assert (report.exit_code, report.counts["made"]) == (0, 1)
    assert [*Commits(store).quarantined()] == []


def test_a_mended_input_repairs_just_that_unit(store: LocalStore) -> None:
    bad = [*toys.units(5), toys.unit("a/bad", 4, trouble="format")]
    run(toys.pipeline(), bad, store)
    corrected = [*toys.units(5), toys.unit("a/bad", 4, content="corrected")]
    report = run(toys.pipeline(), corrected, store)
    assert (report.exit_code, report.counts["made"], report.counts["fresh"]) == (0, 1, 5)
    assert [*Commits(store).quarantined()] == []


def test_a_unit_that_could_not_be_listed_is_quarantined(store: LocalStore) -> None:
    broken = replace(toys.unit("a/broken"), fault=MissingFileError("the stage is not there", where="stage.glb"))
    report = run(toys.pipeline(), [*toys.units(3), broken], store)
    assert report.exit_code == 3
    assert [(name, f.stage, f.exception) for name, f in report.failures] == [
        ("a/broken", "listing", "MissingFileError")
    ]
    again = run(toys.pipeline(), [*toys.units(3), broken], store)
    assert (again.exit_code, again.counts["fresh"], again.published) == (3, 4, False)
    assert run(toys.pipeline(), [*toys.units(3), toys.unit("a/broken")], store).exit_code == 0


def test_only_transient_faults_are_tried_again(store: LocalStore, tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.mkdir()
    unit = toys.unit("a/busy", 4, trouble=f"transient-once:{tmp_path / 'flag'}", log=str(log))
    assert run(toys.pipeline(), [unit, *toys.units(2)], store).exit_code == 0
    assert counts(log)["a_busy.count"] == 2


def test_too_many_failures_stop_the_run_and_publish_nothing(store: LocalStore) -> None:
    units = [toys.unit(f"a/u{n}", 3, trouble="error" if n % 2 else "") for n in range(20)]
    report = run(toys.pipeline(), units, store, budget=3)
    assert (report.exit_code, report.snapshot_id, report.counts["quarantined"]) == (4, None, 4)
    assert not (store.root / "refs").exists()
    assert run(toys.pipeline(), units, store, budget=0.4).exit_code == 4
    assert run(toys.pipeline(), units, store, budget=0.5).exit_code == 3


def test_a_hanging_unit_meets_its_deadline(store: LocalStore) -> None:
    units = [*toys.units(3), toys.unit("a/hang", trouble="hang")]
    report = run(toys.pipeline(), units, store, deadline=2.0)
    assert [(name, f.cause) for name, f in report.failures] == [("a/hang", "deadline")]


def test_a_deadline_that_strikes_in_compiled_code_is_one(store: LocalStore) -> None:
    report = run(toys.pipeline(), [*toys.units(3), toys.unit("a/hang", trouble="compiled-hang")], store, deadline=1.0)
    assert [(name, f.cause, f.exception) for name, f in report.failures] == [("a/hang", "deadline", "DeadlineError")]


@pytest.mark.parametrize("trouble", ["compiled-stop", "swallowed-stop"])
def test_a_stop_is_no_fault_of_the_unit_it_strikes(store: LocalStore, trouble: str) -> None:
    """Wherever SIGTERM arrives, the run ends, and a sound unit does not end in quarantine."""
    units = [toys.unit("a/struck", 4, trouble=trouble, cost=0.1), *toys.units(6)]
    with pytest.raises(KeyboardInterrupt):
        run(toys.pipeline(), units, store)
    assert [*Commits(store).quarantined()] == []
    assert not (store.root / "refs").exists()
    assert run(toys.pipeline(), [toys.unit("a/struck", 4), *toys.units(6)], store).exit_code == 0


def test_no_space_ends_the_run_and_keeps_what_is_committed(store: LocalStore, tmp_path: Path) -> None:
    units = toys.units(6)
    with pytest.raises(StoreError, match="space"):
        run(toys.pipeline(), [toys.unit("a/full", trouble="full", cost=9.0), *units], store)
    assert [*Commits(store).quarantined()] == []
    report = run(toys.pipeline(), [toys.unit("a/full"), *units], store)
    assert report.exit_code == 0
    assert report.stages["count"] == 1


def test_damaged_commits_are_found_and_made_again(store: LocalStore) -> None:
    units = toys.units(6)
    whole = run(toys.pipeline(), units, store)
    # Cut one file of each stage; then something else changes, so that they are read.
    for stage, table in (("count", "numbers"), ("square", "scratch")):
        path = next((store.root / "units" / stage).rglob(f"{table}.parquet"))
        path.write_bytes(path.read_bytes()[:-40])
    (next((store.root / "units" / "word").rglob("unit.json"))).write_text("{")
    for ref in ("other",):
        report = run(toys.pipeline(), units, store, ref)
        assert report.snapshot_id == whole.snapshot_id
    # If the whole snapshot is gone too, it is packed again from the repaired commits.
    path = next((store.root / "units" / "square").rglob("squares.parquet"))
    path.write_bytes(path.read_bytes()[::-1])
    (store.root / "snapshots" / whole.snapshot_id / "manifest.json").unlink()  # type: ignore[operator]
    before = files(store, whole.snapshot_id)  # type: ignore[arg-type]
    again = run(toys.pipeline(), units, store)
    assert again.snapshot_id == whole.snapshot_id
    assert files(store, whole.snapshot_id) == before  # type: ignore[arg-type]
    assert again.stages == {"square": 1}


def test_a_flipped_bit_that_still_decodes_is_found_and_made_again(store: LocalStore) -> None:
    """The file is sound Parquet with other rows: only the rows' own hash can tell."""
    units = toys.units(6)
    run(toys.pipeline(), units, store)
    for stage, table in (("count", "numbers"), ("square", "scratch")):
        for path in (store.root / "units" / stage).rglob(f"{table}.parquet"):
            rows = pq.ParquetFile(path).read()
            pq.write_table(rows.set_column(rows.num_columns - 1, rows.column_names[-1], [[7.0] * len(rows)]), path)
    # Both later stages read what is committed, under new parameters; the aggregate reads it too.
    changed = toys.pipeline(square=toys.Square(power=3.0), word=toys.Word(phrase="now"))
    report = run(changed, units, store, renew=("total",))
    whole = LocalStore(store.root.parent / "whole", durable=False)
    assert report.snapshot_id == run(changed, units, whole).snapshot_id
    assert report.stages["count"] == 6


def test_files_of_a_unit_are_kept(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(5), store)
    assert Snapshot.open(store).unit_files("a/u00004", toys.pipeline()) == {"blob.bin": bytes(5)}


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
    with pytest.raises(UsageError, match="one id"):
        run(toys.pipeline(), [toys.unit("a/x"), toys.unit("a/x", 3)], store)


def test_one_worker_takes_the_smallest_units_first(store: LocalStore, tmp_path: Path) -> None:
    """So that a unit which takes very long keeps no other from being committed."""
    units = [toys.unit("a/big", cost=9.0), toys.unit("a/small", cost=0.1), toys.unit("a/middle", cost=1.0)]
    done: list[str] = []

    class Order(Silence):
        def unit(self, receipt: Receipt) -> None:
            done.append(receipt.unit_id)

    run(toys.pipeline(), units, store, progress=Order())
    assert done[-3:] == ["a/small", "a/middle", "a/big"]
