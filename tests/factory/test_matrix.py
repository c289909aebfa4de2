"""The determinism matrix: whoever works, wherever it is kept, whatever dies, the rows and the id are the same."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import drivers
import pytest
import toys

from factory.object_store import ObjectStore
from factory.run import run
from factory.snapshot import Snapshot
from factory.store import LocalStore, Store, open_store
from tests.ending import kill_driver


def drive(*arguments: str) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-m", "drivers", *arguments], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def hashes(store: Store) -> dict[str, tuple[str, list[str]]]:
    """Logical hash and files' SHA-256 of every table and partition."""
    manifest = Snapshot.open(store).manifest
    return {
        f"{name}/{source}": (partition.logical_hash, [part.sha256 for part in partition.parts])
        for name, table in manifest.tables.items()
        for source, partition in table.partitions.items()
    }


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> tuple[str | None, dict[str, tuple[str, list[str]]]]:
    store = LocalStore(tmp_path_factory.mktemp("expected"), durable=False)
    report = run(toys.pipeline(), drivers.corpus(), store, part_bytes=2000)
    return report.snapshot_id, hashes(store)


@pytest.fixture
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "local":
        return str(tmp_path / "store")
    server = request.getfixturevalue("s3_server")
    return f"s3://bucket/{tmp_path.name}-{os.getpid()}?endpoint={server}"


def test_an_object_store_holds_the_same(
    object_store: ObjectStore, expected: tuple[str | None, dict[str, tuple[str, list[str]]]]
) -> None:
    report = run(toys.pipeline(), drivers.corpus(), object_store, part_bytes=2000)
    assert report.snapshot_id == expected[0]
    assert hashes(object_store) == expected[1]
    again = run(toys.pipeline(), drivers.corpus(), object_store, part_bytes=2000)
    assert (again.published, again.stages, again.counts["fresh"]) == (False, {}, drivers.COUNT)
    changed = [*drivers.corpus()[1:], toys.unit("a/u00000", 4, content="new")]
    report = run(toys.pipeline(), changed, object_store, part_bytes=2000)
    assert report.counts["made"] == 1


@pytest.mark.soak
@pytest.mark.ray
@pytest.mark.parametrize(
    ("address", "way"),
    [
        ("local", "--shuffle=3"),
        ("local", "--workers=1"),
        ("local", "--workers=2 --shuffle=9"),
        ("local", "--nodes=2"),
        ("s3", "--shuffle=3"),
        ("s3", "--workers=2"),
    ],
    indirect=["address"],
)
def test_every_way_gives_one_id_and_equal_files(
    address: str, way: str, expected: tuple[str | None, dict[str, tuple[str, list[str]]]]
) -> None:
    assert drive(address, *way.split())["id"] == expected[0]
    assert hashes(open_store(address)) == expected[1]


@pytest.mark.soak
@pytest.mark.ray
@pytest.mark.parametrize(("address", "way"), [("local", "--workers=2"), ("s3", "")], indirect=["address"])
def test_killed_and_resumed(
    address: str, tmp_path: Path, way: str, expected: tuple[str | None, dict[str, tuple[str, list[str]]]]
) -> None:
    log = tmp_path / "log"
    log.mkdir()
    command = [sys.executable, "-m", "drivers", address, f"--log={log}", "--seconds=0.1", *way.split()]
    driver = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len([*log.iterdir()]) < 12:
        assert driver.poll() is None
        time.sleep(0.02)
    kill_driver(driver)
    done = {path.name for path in log.iterdir()}
    found = drive(address, f"--log={log}", *way.split())
    assert [*open_store(address).list("quarantine")] == [], "a killed worker's unit is not at fault"
    assert (found["exit"], found["id"]) == (0, expected[0])
    assert hashes(open_store(address)) == expected[1]
    twice = [name for name in done if len((log / name).read_text().splitlines()) > 1]
    assert len(twice) <= 2, "only what was under way is made again"


@pytest.mark.soak
@pytest.mark.ray
def test_a_lost_node_costs_only_what_it_had_in_hand(
    tmp_path: Path, expected: tuple[str | None, dict[str, tuple[str, list[str]]]]
) -> None:
    log = tmp_path / "log"
    log.mkdir()
    store = str(tmp_path / "store")
    found = drive(store, f"--log={log}", "--nodes=2", "--lose", "--seconds=0.2")
    assert (found["id"], found["exit"]) == (expected[0], 0)
    assert hashes(open_store(store)) == expected[1]
    runs = {path.name: len(path.read_text().splitlines()) for path in log.iterdir()}
    assert 8 <= int((tmp_path / "lost").read_text()) < len(runs), "the node went while there was work"
    assert sum(count - 1 for count in runs.values()) <= 2, "a node of one CPU has one unit in hand, and one waiting"
