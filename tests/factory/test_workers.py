"""Workers in processes of their own, with Ray and without: the same rows as inline, whoever dies on the way."""

from __future__ import annotations

import os
import pickle
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Final

import pytest
import toys

from factory import InlineExecutor, LocalStore, run
from factory.auto_executor import AutoExecutor
from factory.commits import Commits
from factory.context import RunContext
from factory.heartbeat import Busy, Heartbeat
from factory.process_executor import ProcessExecutor
from factory.ray_executor import RayExecutor
from factory.receipt import Receipt
from factory.report import Silence
from schemas.errors import StoreError

Workers = ProcessExecutor | RayExecutor

KINDS: Final = [
    pytest.param(ProcessExecutor, id="processes"),
    pytest.param(RayExecutor, id="ray", marks=pytest.mark.ray),
]


@pytest.fixture(params=KINDS, scope="session")
def executor(request: pytest.FixtureRequest) -> Iterator[Workers]:
    with request.param(workers=2) as found:
        yield found


class Watch(Silence):
    """Keeps the receipts."""

    def __init__(self) -> None:
        self.receipts: list[Receipt] = []

    def unit(self, receipt: Receipt) -> None:
        self.receipts.append(receipt)


def parts(store: LocalStore, snapshot_id: str | None) -> dict[str, bytes]:
    folder = store.root / "snapshots" / str(snapshot_id)
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.parquet"))}


def test_two_workers_publish_what_one_process_does(executor: Workers, tmp_path: Path) -> None:
    units = toys.units(150)
    inline, ray = LocalStore(tmp_path / "inline", durable=False), LocalStore(tmp_path / "ray", durable=False)
    expected = run(toys.pipeline(), units, inline, part_bytes=3000)
    random.Random(5).shuffle(units)
    watch = Watch()
    found = run(toys.pipeline(), units, ray, executor=executor, part_bytes=3000, progress=watch)
    assert found.snapshot_id == expected.snapshot_id
    assert parts(ray, found.snapshot_id) == parts(inline, expected.snapshot_id)
    assert found.stages == expected.stages
    assert max(len(pickle.dumps(receipt)) for receipt in watch.receipts) <= 2048


def test_a_unit_that_kills_its_worker_is_found_and_the_others_go_on(
    executor: Workers, store: LocalStore, tmp_path: Path
) -> None:
    log = tmp_path / "log"
    log.mkdir()
    units = [
        *toys.units(30, log=str(log)),
        toys.unit("a/poison", 4, trouble="die", log=str(log)),
        toys.unit("a/unlucky", 4, trouble=f"die-once:{tmp_path / 'once'}", log=str(log)),
        toys.unit("a/greedy", 4, trouble=f"memory-once:{tmp_path / 'memory'}", log=str(log)),
        toys.unit("a/glutton", 4, trouble="memory", log=str(log)),
    ]
    report = run(toys.pipeline(), units, store, executor=executor)
    assert report.exit_code == 3
    causes = {name: (failure.stage, failure.cause) for name, failure in report.failures}
    assert causes == {"a/poison": ("count", "worker"), "a/glutton": ("count", "memory")}
    assert report.counts["ok"] + report.counts["skipped"] == 32
    record = Commits(store).quarantine_record("count", dict(report.failures)["a/poison"].key.hex())
    assert record is not None
    assert "died" in record.message
    # A committed unit is never made twice, whatever happened to the task it travelled in.
    for path in log.iterdir():
        runs = len(path.read_text().splitlines())
        assert runs == 1 or path.name.split(".")[0] in ("a_poison", "a_unlucky", "a_greedy", "a_glutton")
    sound = [unit for unit in units if unit.unit_id not in causes]
    assert run(toys.pipeline(), sound, LocalStore(tmp_path / "other", durable=False)).snapshot_id == report.snapshot_id


def test_a_unit_whose_worker_is_ended_is_not_at_fault(executor: Workers, store: LocalStore, tmp_path: Path) -> None:
    """A worker that receives SIGTERM does not quarantine its unit: the unit is run again."""
    units = [toys.unit("a/struck", 4, trouble=f"terminate-once:{tmp_path / 'once'}"), *toys.units(6)]
    report = run(toys.pipeline(), units, store, executor=executor)
    assert [*Commits(store).quarantined()] == []
    assert (report.exit_code, report.counts["ok"]) == (0, 7)


def test_a_deadline_holds_in_a_worker(executor: Workers, store: LocalStore) -> None:
    units = [*toys.units(4), toys.unit("a/hang", trouble="hang")]
    report = run(toys.pipeline(), units, store, executor=executor, deadline=8.0)
    assert [(name, failure.cause) for name, failure in report.failures] == [("a/hang", "deadline")]


def test_a_memory_ceiling_holds_in_a_worker(executor: Workers, store: LocalStore) -> None:
    """The worker lives on: the unit is not one that a worker died of."""
    units = [*toys.units(4), toys.unit("a/hog", trouble="hog"), toys.unit("a/request", trouble="request")]
    report = run(toys.pipeline(), units, store, executor=executor, memory=1 << 30)
    assert (report.exit_code, report.counts["ok"]) == (3, 4)
    found = {name: (failure.cause, failure.exception, failure.attempts) for name, failure in report.failures}
    assert found == dict.fromkeys(("a/hog", "a/request"), ("memory", "MemoryCeilingError", 1))


def test_a_store_that_fails_in_a_worker_ends_the_run(executor: Workers, store: LocalStore) -> None:
    with pytest.raises(StoreError, match="no space"):
        run(toys.pipeline(), toys.units(20), store, executor=executor, faults="unit-before-commit@2=full")
    assert [*Commits(store).quarantined()] == []
    report = run(toys.pipeline(), toys.units(20), store, executor=executor)
    assert report.exit_code == 0


def test_long_units_in_workers_are_mentioned(
    executor: Workers, store: LocalStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Workers report units that are at a stage for half a minute; here the limit is lower."""
    found: list[Busy] = []

    class Listener(Silence):
        def busy(self, unit: Busy, message: str) -> None:
            found.append(unit)

    driver = sys.modules["factory.run"]
    monkeypatch.setattr(driver, "Heartbeat", partial(Heartbeat, after=1.0, pause=0.2))
    monkeypatch.setattr(driver, "RunContext", partial(RunContext, busy_seconds=1.0))
    units = [*toys.units(3), toys.unit("a/slow", seconds=12.0)]
    assert run(toys.pipeline(), units, store, executor=executor, progress=Listener()).exit_code == 0
    assert {(busy.unit_id, busy.stage, busy.endable) for busy in found} == {("a/slow", "count", True)}


@pytest.mark.soak
def test_compiled_code_that_hangs_is_ended_with_its_worker(executor: Workers, store: LocalStore) -> None:
    units = [*toys.units(6), toys.unit("a/lock", trouble="lock")]
    report = run(toys.pipeline(), units, store, executor=executor, deadline=8.0)
    assert [(name, failure.cause) for name, failure in report.failures] == [("a/lock", "deadline")]
    assert "compiled code" in report.failures[0][1].message
    assert report.counts["ok"] == 6


@pytest.mark.parametrize("kind", [ProcessExecutor, RayExecutor])
def test_nothing_is_started_for_nothing(
    kind: type[Workers], store: LocalStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(toys.pipeline(), toys.units(4), store)
    monkeypatch.setattr(kind, "start", lambda self: pytest.fail("started"))
    with kind(workers=2) as idle:
        assert run(toys.pipeline(), toys.units(4), store, executor=idle).exit_code == 0


def test_a_small_run_stays_inline_and_says_so(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(ProcessExecutor, "start", lambda self: pytest.fail("started"))
    with AutoExecutor(InlineExecutor(), ProcessExecutor(workers=2), said.append) as auto:
        report = run(toys.pipeline(), [toys.unit(f"a/{n}", cost=0.1) for n in range(4)], store, executor=auto)
    assert report.exit_code == 0
    assert [line.split(":")[0] for line in said] == ["about 0 CPU s of work", "about 0 CPU s of work"]


def test_a_big_run_goes_to_workers(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(InlineExecutor, "run", lambda self, context, tasks: pytest.fail("went inline"))
    units = [toys.unit(f"a/{n}", cost=90.0) for n in range(4)]
    with AutoExecutor(InlineExecutor(), ProcessExecutor(workers=2)) as auto:
        assert (auto.workers_for(1.0), auto.workers_for(1000.0)) == (1, 2)
        assert run(toys.pipeline(), units, store, executor=auto).exit_code == 0
    # One worker beside the driver is not faster than the driver.
    assert AutoExecutor(InlineExecutor(), ProcessExecutor(workers=1)).workers_for(1000.0) == 1


@pytest.mark.soak
@pytest.mark.parametrize("flag", ["--processes=2", "--workers=2"])
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_a_stopped_driver_takes_its_workers_along(tmp_path: Path, flag: str, how: signal.Signals) -> None:
    log = tmp_path / "log"
    log.mkdir()
    command = [sys.executable, "-m", "drivers", str(tmp_path / "store"), f"--log={log}", "--seconds=0.2", flag]
    # A shell's background job is born deaf to SIGINT, and so are its children; this driver listens.
    listen = partial(signal.signal, signal.SIGINT, signal.default_int_handler)
    driver = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, preexec_fn=listen)
    while len(traces := [text for path in log.iterdir() if (text := path.read_text())]) < 6:
        assert driver.poll() is None
        time.sleep(0.05)
    workers = {int(text.split()[0]) for text in traces}
    driver.send_signal(how)
    _, errors = driver.communicate(timeout=200)
    assert "KeyboardInterrupt" in errors
    for _ in range(600):
        if not any(os.path.exists(f"/proc/{pid}") for pid in workers):
            break
        time.sleep(0.1)
    assert not any(os.path.exists(f"/proc/{pid}") for pid in workers)
