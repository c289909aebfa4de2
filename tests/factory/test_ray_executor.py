"""The Ray executor: the same rows as inline, whoever dies on the way."""

from __future__ import annotations

import json
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
from typing import Any, ClassVar

import pytest
import toys
from ray.remote_function import RemoteFunction

from factory import InlineExecutor, LocalStore, run
from factory.auto_executor import AutoExecutor
from factory.commits import Commits
from factory.context import RunContext
from factory.heartbeat import Busy, Heartbeat
from factory.ray_executor import RayExecutor
from factory.ray_metrics import METRICS, RunMetrics
from factory.receipt import Receipt
from factory.report import Silence
from schemas.errors import StoreError

pytestmark = pytest.mark.ray


@pytest.fixture(scope="session")
def executor() -> Iterator[RayExecutor]:
    with RayExecutor(workers=2) as found:
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


def test_two_workers_publish_what_one_process_does(executor: RayExecutor, tmp_path: Path) -> None:
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
    assert record is not None
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


def test_who_ran_out_of_memory_gets_a_node_to_itself(
    executor: RayExecutor, store: LocalStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What another unit beside it holds must not cost a unit its last try."""
    asked: list[int] = []
    options = RemoteFunction.options

    def watched(function: RemoteFunction, **settings: Any) -> Any:
        asked.append(settings["num_cpus"])
        return options(function, **settings)

    executor.start()
    monkeypatch.setattr(RemoteFunction, "options", watched)
    units = [*toys.units(6), toys.unit("a/greedy", trouble=f"memory-once:{tmp_path / 'once'}")]
    report = run(toys.pipeline(), units, store, executor=executor)
    assert report.exit_code == 0
    assert asked.count(executor.workers) == 1
    assert {*asked} == {1, executor.workers}


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
    assert found == dict.fromkeys(("a/hog", "a/request"), ("memory", "MemoryCeilingError", 1))


def test_a_store_that_fails_in_a_worker_ends_the_run(executor: RayExecutor, store: LocalStore) -> None:
    with pytest.raises(StoreError, match="no space"):
        run(toys.pipeline(), toys.units(20), store, executor=executor, faults="unit-before-commit@2=full")
    assert [*Commits(store).quarantined()] == []
    report = run(toys.pipeline(), toys.units(20), store, executor=executor)
    assert report.exit_code == 0


def test_a_small_run_stays_inline_and_says_so(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(RayExecutor, "running", False)
    monkeypatch.setattr(RayExecutor, "start", lambda self: pytest.fail("Ray was started"))
    with AutoExecutor(RayExecutor(workers=2), said.append) as auto:
        report = run(toys.pipeline(), [toys.unit(f"a/{n}", cost=0.1) for n in range(4)], store, executor=auto)
    assert report.exit_code == 0
    assert [line.split(":")[0] for line in said] == ["about 0 CPU s of work", "about 0 CPU s of work"]


def test_a_big_run_goes_to_ray(executor: RayExecutor, store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RayExecutor, "running", False)
    monkeypatch.setattr(InlineExecutor, "run", lambda self, context, tasks: pytest.fail("went inline"))
    auto = AutoExecutor(executor)
    assert run(toys.pipeline(), [toys.unit(f"a/{n}", cost=90.0) for n in range(4)], store, executor=auto).exit_code == 0


def test_workers_are_those_asked_for_or_there(executor: RayExecutor, monkeypatch: pytest.MonkeyPatch) -> None:
    assert RayExecutor(workers=3).workers == 3
    assert RayExecutor().workers == os.cpu_count()
    executor.start()
    # A cluster is asked, unless a number is configured: never the CPUs of the driver's own machine.
    monkeypatch.setattr(os, "cpu_count", lambda: 77)
    assert RayExecutor(address="auto").workers == 2
    assert RayExecutor(workers=5, address="auto").workers == 5
    auto = AutoExecutor(RayExecutor(workers=4))
    monkeypatch.setattr(RayExecutor, "running", False)
    assert (auto.workers_for(1.0), auto.workers_for(1000.0)) == (1, 4)


@pytest.mark.parametrize(("asked", "most"), [(1, 1), (3, 3), (None, 8)])
def test_workers_bound_the_tasks_in_flight_on_a_cluster(
    executor: RayExecutor, store: LocalStore, monkeypatch: pytest.MonkeyPatch, asked: int | None, most: int
) -> None:
    seen: list[int] = []
    monkeypatch.setattr(RunMetrics, "in_flight", lambda self, tasks: seen.append(tasks))
    executor.start()
    joined = RayExecutor(workers=asked, address="auto")
    # Costs that give each unit a task of its own.
    units = [toys.unit(f"a/{n}", cost=30.0) for n in range(20)]
    assert run(toys.pipeline(), units, store, executor=joined).exit_code == 0
    assert max(seen) == most


def test_ray_is_not_started_for_nothing(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    run(toys.pipeline(), toys.units(4), store)
    monkeypatch.setattr(RayExecutor, "start", lambda self: pytest.fail("Ray was started"))
    with RayExecutor(workers=2) as idle:
        assert run(toys.pipeline(), toys.units(4), store, executor=idle).exit_code == 0


def test_long_units_in_workers_are_mentioned(
    executor: RayExecutor, store: LocalStore, monkeypatch: pytest.MonkeyPatch
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
def test_compiled_code_that_hangs_is_ended_with_its_worker(executor: RayExecutor, store: LocalStore) -> None:
    units = [*toys.units(6), toys.unit("a/lock", trouble="lock")]
    report = run(toys.pipeline(), units, store, executor=executor, deadline=8.0)
    assert [(name, failure.cause) for name, failure in report.failures] == [("a/lock", "deadline")]
    assert "compiled code" in report.failures[0][1].message
    assert report.counts["ok"] == 6


class Recorder:
    """Stands for one of Ray's metrics."""

    values: ClassVar[dict[tuple[str, str], float]] = {}

    def __init__(self, name: str, description: str, tag_keys: tuple[str, ...] = (), boundaries: object = None) -> None:
        assert description == METRICS[name]
        self.name = name

    def inc(self, value: float, tags: dict[str, str]) -> None:
        key = (self.name, *tags.values())
        self.values[key] = self.values.get(key, 0.0) + value  # type: ignore[index, arg-type]

    def observe(self, value: float, tags: dict[str, str]) -> None:
        self.inc(1, tags)

    def set(self, value: float) -> None:
        self.values[self.name, ""] = value


def test_metrics_count_what_came_back(
    executor: RayExecutor, store: LocalStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("Counter", "Gauge", "Histogram"):
        monkeypatch.setattr(f"ray.util.metrics.{name}", Recorder)
    Recorder.values.clear()
    units = [*toys.units(8), toys.unit("a/bad", trouble="error"), toys.unit("a/greedy", trouble="memory")]
    report = run(toys.pipeline(), units, store, executor=executor)
    found = Recorder.values
    assert {name: int(found["factory_stages_total", name]) for name in report.stages} == report.stages
    assert {name: int(found["factory_stage_seconds", name]) for name in report.stages} == report.stages
    assert found["factory_units_total", "ok"] == report.counts["ok"]
    # Both passes come back with them.
    assert found["factory_units_total", "quarantined"] == 4
    assert found["factory_task_failures_total", "memory"] == 1
    assert found["factory_rows_total", "numbers"] == sum(unit.inputs[0].size for unit in units[:8])
    assert found["factory_tasks_in_flight", ""] == 0
    assert found["factory_unit_peak_rss_bytes", ""] > 10_000_000


@pytest.mark.soak
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_a_stopped_driver_takes_its_ray_along(tmp_path: Path, how: signal.Signals) -> None:
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


@pytest.mark.soak
def test_a_unit_that_ray_kills_for_its_memory_gets_one_more_try(tmp_path: Path) -> None:
    import psutil

    memory = psutil.virtual_memory()
    if memory.available < 10 << 30:
        pytest.skip("needs 10 GiB of free memory")
    script = f"""
import toys, json
from factory import LocalStore, run
from factory.ray_executor import RayExecutor
units = [*toys.units(4), toys.unit("a/hog", trouble="hog")]
with RayExecutor(workers=2) as executor:
    # No ceiling of our own, which would stop the unit before Ray does.
    report = run(toys.pipeline(), units, LocalStore({str(tmp_path / "store")!r}), executor=executor, memory=1 << 60)
print(json.dumps([(name, f.stage, f.cause, f.message) for name, f in report.failures]))
"""
    # Ray kills when the whole machine is above a share; ours is far enough above what is in use for the others here.
    share = (memory.total - memory.available + (5 << 30)) / memory.total
    environment = {**os.environ, "RAY_memory_usage_threshold": f"{share:.3f}", "RAY_memory_monitor_refresh_ms": "50"}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    # Its own estimate is 1 MiB, and the second try asked for twice that.
    assert '["a/hog", "count", "memory", "out of memory with 2 MiB asked for' in done.stdout
    (path,) = (tmp_path / "store" / "quarantine" / "count").iterdir()
    record = json.loads(path.read_text())
    assert (record["unit_id"], record["cause"], record["attempts"]) == ("a/hog", "memory", 2)
    assert record["peak_rss"] > 500 << 20, "what the worker held when Ray ended it"
    assert "COMMAND" not in record["message"], "nothing of what else runs on the machine"
