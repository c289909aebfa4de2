"""What keeps a store in order over time: history, sweeping, status, logs, drift, repairs, rebuilds at once."""

from __future__ import annotations

import os
import threading
import time

import pytest
import toys
from faulty import FaultyStore

from factory.report import Progress
from factory.run import plan, run
from factory.snapshot import Snapshot, read_ref
from factory.status import store_status
from factory.store import LocalStore, Store
from factory.sweep import sweep
from schemas.errors import CorruptShardError, StoreError

LATER = time.time() + 10 * 24 * 3600


def grow(store: Store, *sizes: int) -> list[str]:
    """Publish one snapshot for each size; returns their ids."""
    found = []
    for size in sizes:
        report = run(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", size)], store)
        assert report.snapshot_id is not None
        found.append(report.snapshot_id)
    return found


def everything(store: LocalStore) -> dict[str, bytes]:
    return {entry.path: store.read(entry.path) for entry in store.list("")}


def test_a_ref_remembers_what_it_was(store: LocalStore) -> None:
    ids = grow(store, 1, 2, 3)
    ref, _ = read_ref(store, "main")
    assert (ref.snapshot_id, [state.snapshot_id for state in ref.history]) == (ids[2], [ids[1], ids[0]])
    assert ref.generation == 3
    # Back to an older state: it moves to the front and stands there once.
    assert grow(store, 1) == [ids[0]]
    ref, _ = read_ref(store, "main")
    assert [ref.snapshot_id, *(state.snapshot_id for state in ref.history)] == [ids[0], ids[2], ids[1]]


def test_a_sweep_keeps_what_refs_need_and_all_that_is_young(store: LocalStore) -> None:
    ids = grow(store, 1, 2, 3, 4)
    before = everything(store)
    assert sweep(store, keep=2).removed == ()
    assert everything(store) == before, "all is younger than the grace period"
    done = sweep(store, keep=2, now=LATER)
    assert set(done.kept) == set(ids[2:])
    assert set(done.removed) == set(ids[:2])
    after = everything(store)
    assert after.items() <= before.items()
    assert sum(done.files.values()) == len(before) - len(after)
    # Both kept states can be published again without making anything.
    assert Snapshot.open(store).snapshot_id == ids[3]
    assert plan(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", 4)], store).empty
    report = run(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", 3)], store)
    assert (report.snapshot_id, report.stages) == (ids[2], {})
    # An older one can be made again: only its one unit is gone.
    report = run(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", 1)], store)
    assert (report.snapshot_id, report.counts["made"]) == (ids[0], 1)
    assert sweep(store, keep=9, now=LATER).removed == ()


def test_a_sweep_spares_every_ref_and_other_pins(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(4), store, "nightly")
    first = Snapshot.open(store, "nightly").snapshot_id
    last = grow(store, 5, 6)[-1]
    done = sweep(store, keep=1, now=LATER)
    assert set(done.kept) == {first, last}
    assert Snapshot.open(store, "nightly").table("squares").num_rows
    assert run(toys.pipeline(), toys.units(4), store, "nightly").stages == {}


@pytest.mark.parametrize("damage", ["index", "manifest"])
@pytest.mark.parametrize("gone", [False, True])
def test_a_sweep_takes_no_unit_where_it_cannot_know_what_is_needed(store: LocalStore, damage: str, gone: bool) -> None:
    grow(store, 1, 2)
    ref, _ = read_ref(store, "main")
    path = f"indexes/{ref.index}.parquet" if damage == "index" else f"snapshots/{ref.snapshot_id}/manifest.json"
    if gone:
        store.delete(path)
    else:
        store.write(path, store.read(path)[:-7])
    before = {entry.path for entry in store.list("") if entry.path.startswith(("units/", "aggregates/"))}
    done = sweep(store, keep=1, now=LATER)
    assert done.unreadable == (path,)
    assert before <= {entry.path for entry in store.list("")}
    assert run(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", 2)], store).stages == {}, "nothing is made again"
    assert sweep(store, keep=1, now=LATER).unreadable == ()


def test_a_snapshot_about_to_be_published_again_is_young(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed before it moved the ref: the manifest that it found there must not go under the next try."""
    ids = grow(store, 1, 2, 3)
    before = time.time() + 1000
    for entry in store.list(f"snapshots/{ids[0]}"):
        os.utime(store.root / entry.path, (0, 0))
    with pytest.raises(StoreError, match="injected"):
        run(
            toys.pipeline(),
            [*toys.units(4), toys.unit("a/grows", 1)],
            FaultyStore(store.root, "snapshot-before-ref=full"),
        )
    assert sweep(store, keep=1, grace=500.0, now=time.time() + 100).removed == ()
    assert set(sweep(store, keep=1, grace=500.0, now=before).removed) == set(ids[:2])


def test_records_and_logs_of_the_latest_runs_stay(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("factory.sweep.RUNS_KEPT", 2)
    names = [f"2026010{day}T000000Z-x" for day in (3, 1, 4, 2)]
    for name in names:
        store.write(f"runs/{name}.json", b"{}")
        store.write(f"logs/{name}.jsonl", b"{}")
    sweep(store, grace=3600.0)
    assert len([*store.list("logs")]) == 4, "they are young"
    sweep(store, now=LATER)
    assert sorted(entry.path for entry in store.list("")) == [
        f"{kind}/{day}T000000Z-x.{ending}"
        for kind, ending in (("logs", "jsonl"), ("runs", "json"))
        for day in ("20260103", "20260104")
    ]


def test_a_sweep_takes_what_killed_writers_left(store: LocalStore) -> None:
    grow(store, 1)
    left = store.root / "units" / "count" / ".tmp-0123"
    left.write_bytes(b"half")
    folder = store.root / "units" / "count" / "ff" / ("f" * 32)
    folder.mkdir(parents=True)
    (folder / "numbers.parquet").write_bytes(b"without a commit")
    done = sweep(store, now=LATER)
    assert (done.files["unfinished"], done.files["units"]) == (1, 1)
    assert not left.exists()
    assert not folder.exists()


def test_quarantine_stays_while_it_is_listed(store: LocalStore) -> None:
    bad = [*toys.units(3), toys.unit("a/bad", trouble="error")]
    run(toys.pipeline(), bad, store)
    sweep(store, keep=1, now=LATER)
    status = store_status(store)
    assert [(r.unit_id, r.cause, r.exception) for r in status.quarantine] == [("a/bad", "error", "ZeroDivisionError")]
    # One that was never published (the run was stopped) goes with the grace period.
    run(toys.pipeline(), [toys.unit("a/other", trouble="error")], store, "other", budget=0)
    assert len(store_status(store).quarantine) == 2
    sweep(store, keep=1, now=LATER)
    assert [record.unit_id for record in store_status(store).quarantine] == ["a/bad"]


def test_what_a_person_left_in_a_store_is_passed_over(store: LocalStore) -> None:
    units = [*toys.units(3), toys.unit("a/bad", trouble="error")]
    run(toys.pipeline(), units, store)
    before = store_status(store)
    strays = (
        "quarantine/readme.txt",
        "quarantine/count/notes.txt",
        "units/unit.json",
        "units/a/unit.json",
        "runs/x.json",
    )
    for path in (*strays, "refs/notes.txt", "pins/notes.txt", "snapshots/notes.txt", "indexes/notes.txt"):
        store.write(path, b"by hand")
    assert store_status(store).quarantine == before.quarantine
    assert plan(toys.pipeline(), units, store).counts == {"FRESH": 3, "QUARANTINED": 1}
    assert run(toys.pipeline(), [*units, toys.unit("a/more", 2)], store).exit_code == 3
    sweep(store, now=LATER)
    assert [record.unit_id for record in store_status(store).quarantine] == ["a/bad"]


def test_a_manifest_that_is_cut_is_told_with_what_to_do_and_written_anew(store: LocalStore) -> None:
    (found,) = grow(store, 2)
    path = f"snapshots/{found}/manifest.json"
    whole = store.read(path)
    store.write(path, whole[:-7])
    with pytest.raises(CorruptShardError, match=r"manifest\.json.*condvln generate CONFIG"):
        Snapshot.open(store)
    assert grow(store, 2) == [found]
    assert Snapshot.open(store).snapshot_id == found


def test_status_tells_refs_runs_and_sizes(store: LocalStore) -> None:
    assert store_status(store).refs == ()
    ids = grow(store, 2, 3)
    grow(store, 3)  # nothing to do, and so no record
    report = run(toys.pipeline(), [toys.unit("a/x", trouble="error")], store, "other", budget=0)
    status = store_status(store, sizes=True)
    assert [(item.ref.name, item.ref.snapshot_id) for item in status.refs] == [("main", ids[1])]
    assert status.refs[0].manifest.units == {"ok": 5}
    assert [(r.ref, r.exit_code, r.published) for r in status.runs if r.ref == "other"] == [("other", 4, False)]
    assert len(status.runs) == 3
    assert "budget" in next(r for r in status.runs if r.exit_code == 4).message
    assert status.runs[0].failures == [] or status.runs[0].failures[0].unit_id == "a/x"
    assert store.read(report.record)
    assert sum(status.files.values()) == len(everything(store))
    assert sum(status.bytes.values()) == sum(map(len, everything(store).values()))


def test_the_manifest_tells_what_each_stage_cost(store: LocalStore) -> None:
    units = toys.units(9, seconds=0.01)
    run(toys.pipeline(), units, store)
    stages = Snapshot.open(store).manifest.stages
    rows = sum(unit.inputs[0].size for unit in units)
    assert (stages["count"].units, stages["count"].skipped, stages["square"].units) == (9, 1, 8)
    # 'numbers' and 'states'; 'squares' and one row of 'scratch' for each unit that is not skipped.
    assert (stages["count"].rows, stages["square"].rows) == (rows + 9, rows + 8)
    assert stages["count"].seconds >= 0.01 * 8
    assert stages["count"].peak_rss > 10_000_000


def test_a_damaged_pinned_table_is_restored_from_the_snapshot(store: LocalStore) -> None:
    (first,) = grow(store, 1)
    (entry,) = store.list("aggregates")
    good = store.read(entry.path)
    store.write(entry.path, good[:-7])
    assert not plan(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", 1)], store).empty
    assert grow(store, 1) == [first]
    assert store.read(entry.path) == good


def test_a_pinned_table_lost_with_its_copy_is_never_replaced_by_another_silently(store: LocalStore) -> None:
    (second,) = grow(store, 1, 2)[1:]
    ref, _ = read_ref(store, "main")
    (entry,) = store.list("aggregates")
    (copy,) = store.list(f"snapshots/{ref.snapshot_id}/_shared")
    for path in (entry.path, copy.path):
        store.delete(path)
    # It was counted over five numbers less than there are now: no run may pin today's count in its place.
    with pytest.raises(StoreError, match=r"total.*--priors"):
        grow(store, 2)
    assert Snapshot.open(store).snapshot_id == second
    assert run(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", 2)], store, renew=["total"]).exit_code == 0
    assert plan(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", 2)], store).empty


@pytest.mark.parametrize("damage", ["removed", "cut", "older"])
def test_a_pin_is_restored_from_the_manifest(store: LocalStore, damage: str) -> None:
    grow(store, 1)
    older = store.read("pins/toy/main.json")
    units = [*toys.units(4), toys.unit("a/grows", 2)]
    first = run(toys.pipeline(), units, store, renew=["total"]).snapshot_id
    good = store.read("pins/toy/main.json")
    assert older != good
    if damage == "removed":
        store.delete("pins/toy/main.json")
    else:
        store.write("pins/toy/main.json", good[:-7] if damage == "cut" else older)
    assert plan(toys.pipeline(), units, store).damaged == ("pins/toy/main.json",)
    assert run(toys.pipeline(), units, store).snapshot_id == first
    assert store.read("pins/toy/main.json") == good
    assert plan(toys.pipeline(), units, store).empty


def test_a_damaged_published_file_is_found_and_made_again(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(9), store, part_bytes=200)
    snapshot = Snapshot.open(store)
    whole = snapshot.table("squares")
    path = store.root / snapshot.paths("squares")[1]
    good = path.read_bytes()
    path.write_bytes(good[:100] + b"?" + good[101:])
    with pytest.raises(CorruptShardError, match="differ from their recorded hash"):
        snapshot.table("squares")
    untouched = (store.root / snapshot.paths("squares")[0]).stat().st_ino
    report = run(toys.pipeline(), toys.units(9), store, part_bytes=200, verify=True)
    assert report.stages == {}
    assert path.read_bytes() == good
    assert (store.root / snapshot.paths("squares")[0]).stat().st_ino == untouched
    assert Snapshot.open(store).table("squares") == whole


class Rival(Progress):
    """Lets another run publish in the middle of this one."""

    def __init__(self, store: Store, size: int) -> None:
        self.store, self.size, self.notes = store, size, list[str]()

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        if name == "files":
            run(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", self.size)], self.store)

    def note(self, message: str) -> None:
        self.notes.append(message)


@pytest.fixture(params=["local", "s3"])
def any_store(request: pytest.FixtureRequest) -> Store:
    """An empty store on disk, and one on an object store."""
    found: Store = request.getfixturevalue("store" if request.param == "local" else "object_store")
    return found


def test_of_two_rebuilds_at_once_one_publishes_and_the_other_says_so(any_store: Store) -> None:
    store = any_store
    grow(store, 1)
    rival = Rival(store, 5)
    report = run(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", 6)], store, progress=rival)
    winner = Snapshot.open(store).snapshot_id
    assert (report.published, report.exit_code, report.snapshot_id) == (False, 0, winner)
    assert rival.notes == [report.message]
    assert winner in report.message
    assert Snapshot.open(store).table("numbers").num_rows == sum(u.inputs[0].size for u in toys.units(4)) + 5
    # Run again, and only publishing is left to do.
    again = run(toys.pipeline(), [*toys.units(4), toys.unit("a/grows", 6)], store)
    assert (again.published, again.stages) == (True, {})


def test_two_equal_rebuilds_at_once_are_no_conflict(store: LocalStore) -> None:
    reports = []
    start = threading.Barrier(2)

    def rebuild() -> None:
        start.wait()
        reports.append(run(toys.pipeline(), toys.units(10), store))

    threads = [threading.Thread(target=rebuild) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [report.message for report in reports] == ["", ""]
    assert {report.snapshot_id for report in reports} == {Snapshot.open(store).snapshot_id}
    assert sorted(report.published for report in reports) == [False, True]
