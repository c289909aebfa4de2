"""Drivers killed at every named point, and readers that look on: nothing committed is lost, nothing half is seen."""

from __future__ import annotations

import multiprocessing
import shutil
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import toys
from faulty import POINTS, FaultyStore

from factory.run import run
from factory.snapshot import Snapshot, read_ref
from factory.stage import Unit
from factory.store import LocalStore
from schemas.errors import StoreError

# A server that has imported everything forks each driver in a few milliseconds.
SPAWN = multiprocessing.get_context("forkserver")
SPAWN.set_forkserver_preload(["factory", "pandas", "toys"])

UNITS = 14


def drive(store: Path, fault: str, log: str = "", size: int = 0) -> None:
    """A driver in its own process. ``size`` > 0 is another corpus, published before."""
    units = (
        [toys.unit(f"{'ab'[n % 2]}/u{n:05d}", size, partition="ab"[n % 2]) for n in range(6)] if size else corpus(log)
    )
    run(
        toys.pipeline(),
        units,
        FaultyStore(store, fault) if fault else LocalStore(store, durable=False),
        part_bytes=300,
        renew=() if size else ("total",),
    )


def corpus(log: str = "") -> list[Unit]:
    return toys.units(UNITS, log=log)


def in_a_process(function: Callable[..., None], *arguments: object) -> int:
    process = SPAWN.Process(target=function, args=arguments)
    process.start()
    process.join(60)
    assert process.exitcode is not None
    return process.exitcode


def published(store: LocalStore) -> dict[str, list[dict[str, object]]]:
    """What a reader sees: all rows of all tables, checked against the manifest."""
    snapshot = Snapshot.open(store)
    return {name: snapshot.table(name).to_pylist() for name in snapshot.manifest.tables}


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> tuple[str | None, dict[str, bytes]]:
    store = LocalStore(tmp_path_factory.mktemp("expected"), durable=False)
    report = run(toys.pipeline(), corpus(), store, part_bytes=300)
    return report.snapshot_id, toys.files(store, report.snapshot_id)


@pytest.fixture(scope="module")
def published_before(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store in which another corpus is published; read only."""
    folder = tmp_path_factory.mktemp("before") / "store"
    drive(folder, "", "", 4)
    return folder


@pytest.mark.parametrize("point", [p for p in POINTS if p != "quarantine-before-record"])
def test_killed_at_every_point_the_next_run_ends_the_same(
    tmp_path: Path, published_before: Path, expected: tuple[str | None, dict[str, bytes]], point: str
) -> None:
    store = LocalStore(shutil.copytree(published_before, tmp_path / "store"), durable=False)
    log = tmp_path / "log"
    log.mkdir()
    before = published(store)
    # Points of units are hit in the middle; those of the snapshot come once or a few times.
    fault = f"{point}@9" if point.startswith("unit") else point
    assert in_a_process(drive, store.root, fault, str(log)) == -signal.SIGKILL
    if point == "snapshot-after-ref":
        assert Snapshot.open(store).snapshot_id == expected[0]
    else:
        assert published(store) == before
    committed = {path.parent.name for path in (store.root / "units").rglob("unit.json")}
    runs = {path.name: len(path.read_text().splitlines()) for path in log.iterdir()}
    report = run(toys.pipeline(), corpus(str(log)), store, part_bytes=300, renew=("total",))
    assert report.snapshot_id == expected[0]
    assert toys.files(store, report.snapshot_id) == expected[1]
    # What was committed is not made again; at most the one stage that was under way is.
    again = {
        path.name
        for path in log.iterdir()
        if path.name in runs and len(path.read_text().splitlines()) > runs[path.name]
    }
    assert len(again) <= (1 if point.startswith("unit-be") else 0)
    assert committed <= {path.parent.name for path in (store.root / "units").rglob("unit.json")}


def test_readers_never_see_part_of_a_snapshot(tmp_path: Path) -> None:
    """A reader polls while snapshots are published one after the other; every look shows one whole snapshot."""
    store = LocalStore(tmp_path / "store", durable=False)
    sizes = [3, 5, 2, 6, 4]
    seen: list[set[int]] = []
    failures: list[BaseException] = []
    over = threading.Event()

    def read() -> None:
        while not over.is_set():
            try:
                rows = published(store)["numbers"]
                names = [row["unit"] for row in rows]
                seen.append({names.count(name) for name in set(names)})
            except StoreError as error:
                if "nothing is published" not in str(error):
                    failures.append(error)
            except BaseException as error:
                failures.append(error)

    reader = threading.Thread(target=read)
    reader.start()
    for size in sizes:
        run(toys.pipeline(), [toys.unit(f"a/{n}", size) for n in range(8)], store, part_bytes=200)
    over.set()
    reader.join()
    assert not failures
    assert seen
    assert all(len(look) == 1 for look in seen)


def test_a_killed_quarantine_is_found_again(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store", durable=False)
    assert in_a_process(drive_with_failure, store.root) == -signal.SIGKILL
    report = run(toys.pipeline(), [*corpus(), toys.unit("a/bad", trouble="error")], store)
    assert [name for name, _ in report.failures] == ["a/bad"]


def drive_with_failure(store: Path) -> None:
    units = [*corpus(), toys.unit("a/bad", trouble="error")]
    run(toys.pipeline(), units, FaultyStore(store, "quarantine-before-record"))


@pytest.mark.parametrize("point", ["unit-before-data@3", "unit-before-commit@3", "snapshot-between-parts"])
def test_a_full_disk_ends_the_run_and_costs_nothing(
    tmp_path: Path, expected: tuple[str | None, dict[str, bytes]], point: str
) -> None:
    store = LocalStore(tmp_path / "store", durable=False)
    with pytest.raises(StoreError, match="no space"):
        run(toys.pipeline(), corpus(), FaultyStore(store.root, f"{point}=full"), part_bytes=300)
    assert read_ref(store, "main") == (None, None)
    assert run(toys.pipeline(), corpus(), store, part_bytes=300).snapshot_id == expected[0]
