"""The Ray executor: the same rows as inline, whoever dies on the way."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import pytest
import toys
from faulty import FaultyStore

from factory import machine
from factory.dispatch import METRICS, RunMetrics
from factory.ray_executor import RayExecutor
from factory.run import run
from factory.store import LocalStore

pytestmark = pytest.mark.ray


def test_a_store_that_is_busy_once_costs_a_retry(executor: RayExecutor, store: LocalStore) -> None:
    """By Ray for a task of one unit; units that share a task are handed out one by one."""
    busy = FaultyStore(store.root, "unit-before-commit=transient")
    for units in ([toys.unit(f"a/{n}", cost=90.0) for n in range(3)], toys.units(20)):
        report = run(toys.pipeline(), units, busy, executor=executor)
        assert (report.exit_code, report.failures) == (0, [])


def test_workers_are_those_asked_for_or_there(executor: RayExecutor, monkeypatch: pytest.MonkeyPatch) -> None:
    assert RayExecutor(workers=3).workers == 3
    assert RayExecutor().workers == machine.cores()
    executor.start()
    # A cluster is asked, unless a number is configured: never the CPUs of the driver's own machine.
    monkeypatch.setattr(machine, "cores", lambda: 77)
    assert RayExecutor(address="auto").workers == 2
    assert RayExecutor(workers=5, address="auto").workers == 5


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
    assert found["factory_units_total", "quarantined"] == 2, "the second pass does not hand them out again"
    assert found["factory_task_failures_total", "memory"] == 1
    assert found["factory_rows_total", "numbers"] == sum(unit.inputs[0].size for unit in units[:8])
    assert found["factory_tasks_in_flight", ""] == 0
    assert found["factory_unit_peak_rss_bytes", ""] > 10_000_000


LISTED = """
import json, tempfile, time
import ray, toys
from factory.run import run
from factory.store import LocalStore
from factory.ray_executor import RayExecutor
units = [toys.unit(f"a/{n}", cost=90.0, trouble=trouble) for n, trouble in enumerate(["", "", "format", "die"])]
with RayExecutor(workers=2) as executor:
    report = run(toys.pipeline(), units, LocalStore(tempfile.mkdtemp()), ref="demo", executor=executor)
    time.sleep(3)  # workers report what they did once a second
    from ray.util.state import list_tasks
    tasks = list_tasks(ray.get_runtime_context().gcs_address, detail=True)
print(json.dumps([(one.name, one.state, one.attempt_number, one.error_message) for one in tasks]))
"""


@pytest.mark.soak
def test_ray_lists_what_was_done_and_what_failed() -> None:
    """As ``ray list tasks`` shows it, where Ray has its dashboard."""
    done = subprocess.run([sys.executable, "-c", LISTED], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    tasks = json.loads(done.stdout.splitlines()[-1])
    states = {(name, state) for name, state, *_ in tasks}
    assert {("condvln:demo:a/0", "FINISHED"), ("condvln:demo:a/1", "FINISHED")} <= states
    assert ("condvln:demo:a/2", "FAILED") in states
    assert any("cut short" in str(message) for name, _, _, message in tasks if name == "condvln:demo:a/2")
    tries = sorted(attempt for name, state, attempt, _ in tasks if name == "condvln:demo:a/3" and state == "FAILED")
    assert tries == [0, 1, 2], "Ray tries it again twice, and lists each try"
    assert [state for name, state, *_ in tasks if name == "condvln:demo:a/2"] == ["FAILED"], "it is handed out once"


@pytest.mark.soak
def test_a_unit_that_ray_kills_for_its_memory_gets_one_more_try(tmp_path: Path) -> None:
    import psutil

    memory = psutil.virtual_memory()
    if memory.available < 10 << 30:
        pytest.skip("needs 10 GiB of free memory")
    script = f"""
import toys, json
from factory.run import run
from factory.store import LocalStore
from factory.ray_executor import RayExecutor
units = [*toys.units(4), toys.unit("a/hog", trouble="hog", cost=90.0)]
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
    assert "COMMAND" not in record["message"], "nothing of what else runs on the machine"
