"""The Ray executor: the same rows as inline, whoever dies on the way."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest
import toys
from ray.remote_function import RemoteFunction

from factory import LocalStore, run
from factory.ray_executor import RayExecutor
from factory.ray_metrics import METRICS, RunMetrics

pytestmark = pytest.mark.ray


@pytest.fixture(scope="session")
def executor() -> Iterator[RayExecutor]:
    with RayExecutor(workers=2) as found:
        yield found


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


def test_workers_are_those_asked_for_or_there(executor: RayExecutor, monkeypatch: pytest.MonkeyPatch) -> None:
    assert RayExecutor(workers=3).workers == 3
    assert RayExecutor().workers == os.cpu_count()
    executor.start()
    # A cluster is asked, unless a number is configured: never the CPUs of the driver's own machine.
    monkeypatch.setattr(os, "cpu_count", lambda: 77)
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
    # Both passes come back with them.
    assert found["factory_units_total", "quarantined"] == 4
    assert found["factory_task_failures_total", "memory"] == 1
    assert found["factory_rows_total", "numbers"] == sum(unit.inputs[0].size for unit in units[:8])
    assert found["factory_tasks_in_flight", ""] == 0
    assert found["factory_unit_peak_rss_bytes", ""] > 10_000_000


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
