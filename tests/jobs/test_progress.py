"""The log of a run: kept beside its record when the run ends, left where it is when the run is stopped."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from factory import LocalStore, RunReport
from factory.auto_executor import AutoExecutor
from factory.executor import InlineExecutor
from factory.heartbeat import Busy
from factory.process_executor import ProcessExecutor
from factory.ray_executor import RayExecutor
from factory.receipt import Receipt, StageReceipt
from factory.report import Silence
from jobs.generate import open_executor
from jobs.progress import LOGS, LoggedRun, RunProgress
from schemas.config import Config, RayConfig, SourceConfig
from schemas.errors import StoreError


class Noted(Silence):
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
        with LoggedRun(store, tmp_path / "state", Silence()) as log:
            log.progress.note("under way")
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
        with LoggedRun(store, tmp_path / "state", Silence()) as log:
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


def done(unit_id: str, expected: float, took: float) -> Receipt:
    key = b"k" * 16
    stage = StageReceipt("count", key, key, key, key, key, took, 10, True, False, ())
    return Receipt(unit_id, "a", "ok", "", key, (stage,), expected=expected)


def test_a_log_says_what_is_left_and_which_unit_takes_long() -> None:
    text = io.StringIO()
    with RunProgress(Console(file=text, width=200)) as progress:
        progress.phase("units", 4, 400.0, workers=2)
        progress.unit(done("a/1", 100.0, 100.0))
        progress.busy(Busy("a/2", "count", 31.0), "a/2: at stage count for 31 s")
        progress.unit(done("a/2", 100.0, 300.0))
        for name in ("a/3", "a/4"):
            progress.unit(done(name, 100.0, 200.0))
    said = text.getvalue().splitlines()
    assert said[0] == "units: 4 to do, about 400 CPU s, shared by 2 workers: 3 min on an idle machine"
    # As the model says, for two workers; then twice as slow, since the second unit took three times what was expected.
    assert said[1] == "units: 1/4 a/1 (about 2 min left)"
    assert said[2] == "a/2: at stage count for 31 s"
    assert said[3] == "units: 2/4 a/2 (about 3 min left)"
    assert said[-1] == "units: 4/4 a/4"


@pytest.mark.parametrize(
    ("ray", "inline", "kind"),
    [
        ({}, False, AutoExecutor),
        ({"workers": 1}, False, ProcessExecutor),
        ({"workers": 2}, False, ProcessExecutor),
        ({"workers": 2, "address": "local"}, False, RayExecutor),
        ({"address": "auto"}, False, RayExecutor),
        ({"workers": 3, "address": "auto"}, False, RayExecutor),
        ({"workers": 2}, True, InlineExecutor),
        ({"workers": 2, "address": "auto"}, True, InlineExecutor),
    ],
)
def test_the_executor_is_the_one_configured(
    ray: dict[str, object], inline: bool, kind: type[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jobs.generate._ray_is_up", lambda: False)  # other tests of this process may have started one
    config = Config(
        name="x",
        store=tmp_path,
        sources=(SourceConfig(family="ithor", root=tmp_path),),
        ray=RayConfig.model_validate(ray),
    )
    said: list[str] = []
    with open_executor(config.ray, inline, said.append) as executor:
        assert type(executor) is kind
        if isinstance(executor, RayExecutor | ProcessExecutor) and "workers" in ray:
            assert executor.workers == ray["workers"]
