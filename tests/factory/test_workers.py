"""Ray workers: the same rows as inline, whoever dies on the way."""

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

import pytest
import toys
from faulty import FaultyStore

from factory.commits import Commits
from factory.executor import Executor, InlineExecutor
from factory.ray_executor import RayExecutor
from factory.receipt import Receipt
from factory.report import Progress
from factory.run import run
from factory.store import LocalStore
from schemas.errors import ClusterError, FormatError, StoreError

pytestmark = pytest.mark.ray


class Watch(Progress):
    """Keeps the receipts."""

    def __init__(self) -> None:
        self.receipts: list[Receipt] = []

    def unit(self, receipt: Receipt) -> None:
        self.receipts.append(receipt)


def test_two_workers_publish_what_one_process_does(executor: RayExecutor, tmp_path: Path) -> None:
    units = toys.units(150)
    inline, ray = LocalStore(tmp_path / "inline", durable=False), LocalStore(tmp_path / "ray", durable=False)
    expected = run(toys.pipeline(), units, inline, part_bytes=3000)
    random.Random(5).shuffle(units)
    watch = Watch()
    found = run(toys.pipeline(), units, ray, executor=executor, part_bytes=3000, progress=watch)
    assert found.snapshot_id == expected.snapshot_id
    assert toys.files(ray, found.snapshot_id) == toys.files(inline, expected.snapshot_id)
    assert found.stages == expected.stages
    assert max(len(pickle.dumps(receipt)) for receipt in watch.receipts) <= 2048


def test_a_unit_that_kills_its_worker_is_found_and_the_others_go_on(
    executor: RayExecutor, store: LocalStore, tmp_path: Path
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
    assert "died" in record.message
    # A committed unit is never made twice, whatever happened to the task it travelled in.
    for path in log.iterdir():
        runs = len(path.read_text().splitlines())
        assert runs == 1 or path.name.split(".")[0] in ("a_poison", "a_unlucky", "a_greedy", "a_glutton")
    sound = [unit for unit in units if unit.unit_id not in causes]
    assert run(toys.pipeline(), sound, LocalStore(tmp_path / "other", durable=False)).snapshot_id == report.snapshot_id


def test_a_unit_whose_worker_is_ended_is_not_at_fault(executor: RayExecutor, store: LocalStore, tmp_path: Path) -> None:
    """A worker that receives SIGTERM does not quarantine its unit: the unit is run again."""
    units = [toys.unit("a/struck", 4, trouble=f"terminate-once:{tmp_path / 'once'}"), *toys.units(6)]
    report = run(toys.pipeline(), units, store, executor=executor)
    assert [*Commits(store).quarantined()] == []
    assert (report.exit_code, report.counts["ok"]) == (0, 7)


def test_a_deadline_holds_in_a_worker(executor: RayExecutor, store: LocalStore) -> None:
    units = [*toys.units(4), toys.unit("a/hang", trouble="hang")]
    report = run(toys.pipeline(), units, store, executor=executor, deadline=8.0)
    assert [(name, failure.cause) for name, failure in report.failures] == [("a/hang", "deadline")]


def test_a_memory_ceiling_holds_in_a_worker(executor: RayExecutor, store: LocalStore) -> None:
    """The worker lives on: the unit is not one that a worker died of."""
    units = [*toys.units(4), toys.unit("a/hog", trouble="hog"), toys.unit("a/request", trouble="request")]
    report = run(toys.pipeline(), units, store, executor=executor, memory=1 << 30)
    assert (report.exit_code, report.counts["ok"]) == (3, 4)
    found = {name: (failure.cause, failure.exception, failure.attempts) for name, failure in report.failures}
    assert {name: values[:2] for name, values in found.items()} == dict.fromkeys(
        ("a/hog", "a/request"), ("memory", "MemoryCeilingError")
    )


def test_a_store_that_fails_in_a_worker_ends_the_run(executor: RayExecutor, store: LocalStore) -> None:
    with pytest.raises(StoreError, match="no space"):
        run(toys.pipeline(), toys.units(20), FaultyStore(store.root, "unit-before-commit@2=full"), executor=executor)
    assert [*Commits(store).quarantined()] == []
    report = run(toys.pipeline(), toys.units(20), store, executor=executor)
    assert report.exit_code == 0


@pytest.mark.soak
def test_compiled_code_that_hangs_is_ended_with_its_worker(executor: RayExecutor, store: LocalStore) -> None:
    units = [*toys.units(6), toys.unit("a/lock", trouble="lock")]
    report = run(toys.pipeline(), units, store, executor=executor, deadline=8.0)
    assert [(name, failure.cause) for name, failure in report.failures] == [("a/lock", "deadline")]
    assert "compiled code" in report.failures[0][1].message
    assert report.counts["ok"] == 6


def test_nothing_is_started_for_nothing(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    run(toys.pipeline(), toys.units(4), store)
    monkeypatch.setattr(RayExecutor, "start", lambda self: pytest.fail("started"))
    with RayExecutor(workers=2) as idle:
        assert run(toys.pipeline(), toys.units(4), store, executor=idle).exit_code == 0


def test_a_small_run_stays_in_this_process(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RayExecutor, "start", lambda self: pytest.fail("started"))
    monkeypatch.setattr(RayExecutor, "running", False)  # the other tests' Ray
    warmed: list[Executor] = []
    small = RayExecutor(workers=2, small=20.0, warm=warmed.append)
    units = [toys.unit(f"a/{n}", cost=0.1) for n in range(4)]
    assert run(toys.pipeline(), units, store, executor=small).exit_code == 0
    assert [type(one) for one in warmed] == [InlineExecutor]


def test_a_big_run_goes_to_ray(executor: RayExecutor, store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    executor.start()
    monkeypatch.setattr(InlineExecutor, "run", lambda self, context, tasks: pytest.fail("went inline"))
    warmed: list[Executor] = []
    big = RayExecutor(workers=2, small=20.0, warm=warmed.append)
    units = [toys.unit(f"a/{n}", cost=90.0) for n in range(4)]
    assert run(toys.pipeline(), units, store, executor=big).exit_code == 0
    assert warmed == [big], "once, for all passes"


def squares(number: int) -> Iterator[int]:
    if number == 7:
        raise FormatError("cut", where="a.json")
    if number == 9:
        os._exit(9)
    yield from (number * n for n in range(3))


@pytest.mark.parametrize("ray", [False, True], ids=["inline", "ray"])
def test_generators_go_to_the_workers(executor: RayExecutor, ray: bool) -> None:
    """What verbs other than generate use: one stream for each item, and the error of the function."""
    if ray:
        executor.start()
    chosen: Executor = executor if ray else InlineExecutor()
    assert [[*one] for one in chosen.streams(squares, [1, 2], "test")] == [[0, 1, 2], [0, 2, 4]]
    one, two = chosen.streams(squares, [1, 7], "test")
    assert [*one] == [0, 1, 2]
    with pytest.raises(FormatError, match=r"a\.json: cut"):
        list(two)


@pytest.mark.soak
def test_a_function_that_kills_its_workers_is_an_error(executor: RayExecutor) -> None:
    executor.start()
    (one,) = executor.streams(squares, [9], "test")
    with pytest.raises(ClusterError, match="died 3 times"):
        list(one)


@pytest.mark.soak
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_a_stopped_driver_takes_its_workers_along(tmp_path: Path, how: signal.Signals) -> None:
    log = tmp_path / "log"
    log.mkdir()
    command = [sys.executable, "-m", "drivers", str(tmp_path / "store"), f"--log={log}", "--seconds=0.2", "--workers=2"]
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
