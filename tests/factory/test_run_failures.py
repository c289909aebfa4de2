"""What fails in a run, inline: skipped and quarantined units, deadlines, stops, a full disk, damaged commits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import toys

from factory.commits import Commits
from factory.rows import parquet_bytes
from factory.run import plan, run
from factory.snapshot import Snapshot
from factory.store import LocalStore
from schemas.errors import MissingFileError, StoreError


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
    assert toys.counts(log) == {"a_bad.count": attempts}
    record = Commits(store).quarantine_record("count", report.failures[0][1].key.hex())
    assert (record.unit_id, record.cause, record.attempts) == ("a/bad", cause, attempts)
    assert "in misbehave" in record.traceback
    assert record.peak_rss > 0
    # The others are published as if it were not there.
    assert set(Snapshot.open(store).table("states")["unit"].to_pylist()) == {u.unit_id for u in units[:5]}
    # It is not tried again until its key changes or someone asks.
    assert run(toys.pipeline(), units, store).exit_code == 3
    assert toys.counts(log) == {"a_bad.count": attempts}
    assert plan(toys.pipeline(), units, store).counts["QUARANTINED"] == 1
    run(toys.pipeline(), units, store, retry_quarantined=True)
    assert toys.counts(log) == {"a_bad.count": 2 * attempts}
    # The payload is not keyed, so a cured cause outside the key needs the asking, and then the record goes.
    corrected = [*units[:5], toys.unit("a/bad", 4)]
    report = run(toys.pipeline(), corrected, store, retry_quarantined=True)
    assert (report.exit_code, report.counts["made"]) == (0, 1)
    assert [*Commits(store).quarantined()] == []


def test_a_corrected_input_repairs_just_that_unit(store: LocalStore) -> None:
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
    assert toys.counts(log)["a_busy.count"] == 2


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
    for stage in ("count", "square"):
        path = next((store.root / "units" / stage).rglob("*.parquet"))
        path.write_bytes(path.read_bytes()[:-40])
    (next((store.root / "units" / "word").rglob("unit.json"))).write_text("{")
    for ref in ("other",):
        report = run(toys.pipeline(), units, store, ref)
        assert report.snapshot_id == whole.snapshot_id
    # If the whole snapshot is gone too, it is packed again from the repaired commits.
    path = next((store.root / "units" / "square").rglob("squares.parquet"))
    path.write_bytes(path.read_bytes()[::-1])
    (store.root / "snapshots" / whole.snapshot_id / "manifest.json").unlink()  # type: ignore[operator]
    before = toys.files(store, whole.snapshot_id)  # type: ignore[arg-type]
    again = run(toys.pipeline(), units, store)
    assert again.snapshot_id == whole.snapshot_id
    assert toys.files(store, whole.snapshot_id) == before  # type: ignore[arg-type]
    assert again.stages == {"square": 1}


def test_a_sound_file_with_other_rows_is_found_and_made_again(store: LocalStore) -> None:
    """Nothing in the file is damaged: only the hash of its rows can tell that it is another one."""
    units = toys.units(6)
    run(toys.pipeline(), units, store)
    for name, column, value in (("numbers", "n", 7), ("scratch", "sum", 7.0)):
        for path in (store.root / "units").rglob(f"{name}.parquet"):
            rows = pq.ParquetFile(path).read()
            values = pa.array([value] * len(rows), rows.schema.field(column).type)
            at = rows.schema.get_field_index(column)
            path.write_bytes(parquet_bytes(rows.set_column(at, rows.schema.field(column), values)))
    # Both later stages read what is committed, under new parameters; the aggregate reads it too.
    changed = toys.pipeline(square=toys.Square(power=3.0), word=toys.Word(phrase="now"))
    report = run(changed, units, store, renew=("total",))
    whole = LocalStore(store.root.parent / "whole", durable=False)
    assert report.snapshot_id == run(changed, units, whole).snapshot_id
    assert report.stages["count"] == 6
