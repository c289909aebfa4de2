"""The log of a run: kept beside its record when the run ends, left where it is when the run is stopped."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from factory import LocalStore, RunReport
from factory.report import Silence
from jobs.progress import LOGS, LoggedRun
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
