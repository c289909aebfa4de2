"""The log of a run: kept beside its record when the run ends, left where it is when the run is stopped."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from factory.executor import InlineExecutor
from factory.ray_executor import RayExecutor
from factory.receipt import Receipt, StageReceipt
from factory.report import Progress, RunReport
from factory.store import LocalStore
from jobs.executor import SMALL_SECONDS, open_executor, place_of_work
from jobs.progress import LOGS, LoggedRun, RunProgress
from schemas.config import RayConfig
from schemas.errors import StoreError


class Noted(Progress):
    """Keeps what a person would be told."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, message: str) -> None:
        self.notes.append(message)


def lines(text: str) -> list[dict[str, object]]:
    return [json.loads(line) for line in text.splitlines()]


def test_a_stopped_run_leaves_its_log_on_this_machine(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")

    def stopped() -> None:
        with LoggedRun(store, tmp_path / "state", Progress()) as log:
            log.note("under way")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    (path,) = (tmp_path / "state" / LOGS).iterdir()
    events = [line["event"] for line in lines(path.read_text())]
    assert events == ["note", "end"]
    assert "KeyboardInterrupt" in str(lines(path.read_text())[-1]["error"])
    assert [*store.list("")] == []


def test_a_finished_run_has_its_log_under_the_name_of_its_record(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    for record in ("runs/20260101T000000Z-abc.json", ""):
        with LoggedRun(store, tmp_path / "state", Progress()) as log:
            log.keep(RunReport(record=record, exit_code=3))
    assert [entry.path for entry in store.list("")] == ["logs/20260101T000000Z-abc.jsonl"]
    (line,) = lines(store.read("logs/20260101T000000Z-abc.jsonl").decode())
    assert (line["event"], line["exit_code"]) == ("end", 3)
    assert [*(tmp_path / "state" / LOGS).iterdir()] == []


def test_a_store_that_takes_no_log_costs_the_run_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: LocalStore, path: str, data: object, **how: object) -> None:
        raise StoreError("no space left")

    monkeypatch.setattr(LocalStore, "write", refuse)
    told = Noted()
    with LoggedRun(LocalStore(tmp_path / "store"), tmp_path / "state", told) as log:
        log.keep(RunReport(record="runs/x.json"))
    assert "no space left" in told.notes[0]
    assert len([*(tmp_path / "state" / LOGS).iterdir()]) == 1


@pytest.mark.parametrize(
    ("ray", "inline", "environment", "kind", "workers", "said"),
    [
        ({}, False, "", RayExecutor, 4, "by 4 workers of a Ray on this machine"),
        ({"workers": 1}, False, "", InlineExecutor, 1, "in this process (ray.workers is 1)"),
        ({"workers": 2}, False, "", RayExecutor, 2, "by 2 workers of a Ray on this machine"),
        ({"workers": 2, "address": "local"}, False, "h:1", RayExecutor, 2, "by 2 workers of a Ray on this machine"),
        ({"workers": 3, "address": "auto"}, False, "", RayExecutor, 3, "on the Ray cluster at auto (ray.address)"),
        ({"workers": 3}, False, "h:1", RayExecutor, 3, "at h:1 (environment variable RAY_ADDRESS)"),
        ({"workers": 1}, False, "h:1", RayExecutor, 1, "at h:1 (environment variable RAY_ADDRESS)"),
        ({"workers": 2}, True, "", InlineExecutor, 1, "in this process (--inline)"),
        ({"workers": 2, "address": "auto"}, True, "h:1", InlineExecutor, 1, "in this process (--inline)"),
    ],
)
def test_the_executor_is_the_one_configured(
    ray: dict[str, object],
    inline: bool,
    environment: str,
    kind: type[object],
    workers: int,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("jobs.executor.cores", lambda: 4)
    monkeypatch.setattr("factory.machine.cores", lambda: 4)
    monkeypatch.setenv("RAY_ADDRESS", environment)
    configured = RayConfig.model_validate(ray)
    assert said in place_of_work(configured, 1000.0, inline=inline)[1]
    with open_executor(configured, inline=inline) as executor:
        assert type(executor) is kind
        assert executor.workers == workers


def test_small_work_stays_in_this_process_unless_workers_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jobs.executor.cores", lambda: 4)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    chosen, said = place_of_work(RayConfig(), SMALL_SECONDS - 1)
    assert not chosen
    assert "Ray takes about ten seconds to start" in said
    assert place_of_work(RayConfig(), SMALL_SECONDS + 1)[0]
    assert place_of_work(RayConfig(workers=2), 0.1)[0]
    assert place_of_work(RayConfig(address="auto"), 0.1)[0]
    monkeypatch.setattr("jobs.executor.cores", lambda: 1)
    assert place_of_work(RayConfig(), 1000.0) == (False, "the work is done in this process (this machine has one core)")


def test_no_time_is_said_before_enough_units_are_measured() -> None:
    """Two workers' first units pay for imports: 60 s each. The others take twice what was expected of them."""
    told = io.StringIO()
    with RunProgress(Console(file=told, width=200)) as progress:
        progress.phase("first pass, for priors", 20, 20.0, 2)
        for k in range(20):
            stage = StageReceipt("count", b"", b"", b"", b"", b"", 60.0 if k < 2 else 2.0, 0, True, False, ())
            progress.unit(Receipt(f"unit {k}", "made", "ok", "", b"", (stage,), expected=1.0))
    head, *units = told.getvalue().splitlines()
    assert head == "first pass, for priors: 20 to do, about 20 CPU s, shared by 2 workers"
    assert not any("left" in line for line in units[:3]), "too little is measured"
    assert units[3] == "first pass, for priors: 4/20 unit 3 (about 16 s left of this pass)"
    assert units[18].endswith("(about 1 s left of this pass)")
    assert "left" not in units[19]
