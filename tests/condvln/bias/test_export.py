"""An export judges itself, says so in its documents, and fails only where it is asked to."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Literal

import pytest

from condvln.bias import BiasReport, Finding, judge_export
from condvln.export.snapshot import export_snapshot
from factory.store import LocalStore
from jobs.bias import add_bias, priors_behind
from jobs.report import Report
from schemas.config import SplitsConfig
from schemas.snapshot import Pin, PinnedTable
from tests.made_snapshot import made_snapshot

SCENES = {"replicacad": [f"v3_sc0_staging_{k:02}" for k in range(8)]}


@pytest.fixture(scope="module")
def leaking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An export of made rows, whose nearest leaf is then made the gold one in all of its manifests."""
    folder = tmp_path_factory.mktemp("leaking")
    export_snapshot(made_snapshot(SCENES), folder)
    for path in (folder / "manifest").glob("*.jsonl"):
        rows = [json.loads(line) for line in path.read_text().splitlines()]
        for row in rows:
            row["leaves"][row["gold_leaf"]]["geodesic_distance"] = 0.0
        path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


def test_the_verdict_stands_in_the_summary_and_on_the_card(tmp_path: Path) -> None:
    done = export_snapshot(made_snapshot(SCENES), tmp_path)
    assert done.bias.tests > 0
    assert json.loads((tmp_path / "export.json").read_bytes())["bias"] == json.loads(json.dumps(done.bias.document()))
    assert f"Verdict: {done.bias.verdict()}." in (tmp_path / "README.md").read_text()
    assert done.bias.document() == judge_export(tmp_path).document()


def test_nobody_is_judged_who_does_not_ask(tmp_path: Path) -> None:
    done = export_snapshot(made_snapshot(), tmp_path, SplitsConfig(bias="off"))
    assert done.bias is None
    assert json.loads((tmp_path / "export.json").read_bytes())["bias"] is None
    assert "Not tested." in (tmp_path / "README.md").read_text()


@pytest.mark.parametrize(("action", "code"), [("warn", 0), ("fail", 3)])
def test_a_failed_gate_warns_or_fails(leaking: Path, action, code: int) -> None:
    report = Report({})
    add_bias(report, judge_export(leaking), action)
    assert report.exit_code == code
    assert report.lines[0].startswith("WARNING: bias gate: guesses beat chance: nearest target 1.000")
    assert any(row[0] == "nearest target" for row in report.sections[0].rows)


def test_a_passed_gate_never_fails(tmp_path: Path) -> None:
    export_snapshot(made_snapshot(), tmp_path)
    report = Report({})
    add_bias(report, judge_export(tmp_path), "fail")
    assert report.exit_code == 0
    assert report.lines[0].startswith("bias gate: ")


def test_statements_that_tell_the_truth_are_named_with_what_helps() -> None:
    def said(guesser: str, statements: Literal["any", "even"]) -> list[str]:
        finding = Finding(guesser, "procthor", "all", 900, 90, 0.6, 0.5, 0.55, 0.65, 1e-9, 1e-8)
        report = Report({})
        add_bias(report, BiasReport(episodes=900, groups=0, findings=(finding,), uniformity=(), untested=()), "warn",
                 statements=statements)  # fmt: skip
        return report.lines[1:]

    (line,) = said("whole statement", "any")
    assert "splits.statements=even" in line
    assert said("whole statement", "even") == said("nearest target", "any") == []


def test_priors_of_fewer_scenes_are_named_as_a_cause(leaking: Path, tmp_path: Path) -> None:
    judged, store = judge_export(leaking), LocalStore(tmp_path)
    stages = {"scene": SimpleNamespace(units=9, skipped=1), "text": SimpleNamespace(units=8, skipped=0)}
    snapshot = SimpleNamespace(store=store, manifest=SimpleNamespace(stages=stages))
    assert priors_behind(snapshot, "main") is None, "nothing is pinned"
    for name, units in (("main", 5), ("other", 1)):
        pin = Pin(tables={"priors": PinnedTable(version=2, hash="0" * 32, rows=1, units=units)})
        store.write(f"pins/condvln/{name}.json", pin.model_dump_json().encode())
    assert priors_behind(snapshot, "main") == (5, 8)
    told, silent = Report({}), Report({})
    add_bias(told, judged, "warn", (5, 8))
    add_bias(silent, judged, "warn")
    assert told.lines[:1] == silent.lines
    assert "counted over 5 scenes, but 8 are published" in told.lines[1]
    assert "condvln generate CONFIG --priors" in told.lines[1]
    full = Pin(tables={"priors": PinnedTable(version=2, hash="0" * 32, rows=1, units=8)})
    store.write("pins/condvln/main.json", full.model_dump_json().encode())
    assert priors_behind(snapshot, "main") is None
    store.write("pins/condvln/main.json", b"{")
    assert priors_behind(snapshot, "main") is None
