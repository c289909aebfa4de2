"""What a store tells of itself: refs, snapshots, quarantine with causes and attempts, runs, drift; local and away."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from factory.commits import sealed
from factory.store import LocalStore
from jobs.command import app
from jobs.generate import run_generate
from jobs.plan import make_plan
from jobs.report import Report
from jobs.show import show_episodes
from jobs.status import target_status
from jobs.workspace import Target, find_target
from schemas.config import Config
from schemas.errors import UsageError
from schemas.snapshot import Ref

runner = CliRunner()

BROKEN = "replicacad/made_001"


def written(config: Config, folder: Path) -> str:
    path = folder / "run.yaml"
    path.write_text(config.model_dump_json())
    return str(path)


def status(*words: str) -> dict[str, object]:
    result = runner.invoke(app, ["status", *words, "--json"])
    assert result.exit_code == 0, result.output
    document: dict[str, object] = json.loads(result.stdout)
    return document


def test_a_configuration_its_store_and_one_away_tell_the_same(
    made_run: tuple[Config, Report], made_away: Config, tmp_path: Path
) -> None:
    config, report = made_run
    named = status(written(config, tmp_path))
    assert named["ref"]["snapshot_id"] == report.document["snapshot_id"]  # type: ignore[index]
    assert named["snapshot"]["units"] == {"ok": report.document["counts"]["ok"]}  # type: ignore[index]
    assert [ref["name"] for ref in named["refs"]] == [config.name]  # type: ignore[attr-defined]
    assert [run["published"] for run in named["runs"]] == [True]  # type: ignore[attr-defined]
    assert status(str(config.store)) == named
    assert {**status(str(made_away.store)), "store": named["store"]} == named


def test_drift_and_sizes_are_told_when_asked(made_run: tuple[Config, Report], made_away: Config) -> None:
    for config in (made_run[0], made_away):
        target = Target(config.store, config.name, config)
        document = target_status(target, measure_drift=True, sizes=True).document
        (priors,) = document["drift"]
        assert (priors["name"], priors["differing"], priors["units_now"]) == ("priors", 0, 2)
        assert document["sizes"]["units"]["bytes"] > document["sizes"]["refs"]["bytes"] > 0
        (pinned,) = document["pinned"]
        assert (pinned["units"], pinned["units_now"]) == (2, 2)
    with pytest.raises(UsageError, match="needs a configuration, whose stages"):
        target_status(Target(made_run[0].store, None), measure_drift=True)


def test_a_failure_shows_its_cause_and_attempts(
    dataset: Path, configured: Callable[..., Config], monkeypatch: pytest.MonkeyPatch
) -> None:
    config = configured(dataset)
    path = dataset / "configs" / "scenes" / "made_001.scene_instance.json"
    path.write_bytes(path.read_bytes()[:200])
    assert run_generate(config, inline=True).exit_code == 3
    report = target_status(Target.of(config))
    (record,) = report.document["quarantine"]
    assert (record["unit_id"], record["attempts"], record["cause"]) == (BROKEN, 1, "input")
    assert "made_001.scene_instance.json" in record["message"]
    assert record["recorded_at"]
    (run,) = report.document["runs"]
    (failure,) = run["failures"]
    assert (failure["unit_id"], failure["attempts"], run["exit_code"]) == (BROKEN, 1, 3)
    shown = next(section for section in report.sections if section.title == "Quarantine")
    assert shown.rows[0][:4] == (BROKEN, record["stage"], "input", 1)
    log = LocalStore(str(config.store)).read(f"logs/{run['started_at']}-{run['token']}.jsonl").decode()
    line = next(line for line in map(json.loads, log.splitlines()) if line.get("unit") == BROKEN)
    assert (line["failure"]["attempts"], line["failure"]["cause"]) == (1, "input")


def test_a_store_with_several_names_says_which_there_are(made_run: tuple[Config, Report], tmp_path: Path) -> None:
    config, _ = made_run
    shutil.copytree(config.store, tmp_path / "store")
    ref = tmp_path / "store" / "refs" / "made.json"
    document = json.loads(ref.read_text())
    other = sealed(Ref(**{**document, "name": "other"}))
    (tmp_path / "store" / "refs" / "other.json").write_bytes(other)
    shutil.copy(
        tmp_path / "store" / "pins" / "condvln" / "made.json", tmp_path / "store" / "pins" / "condvln" / "other.json"
    )
    assert [found["name"] for found in status(str(tmp_path / "store"))["refs"]] == ["made", "other"]  # type: ignore[attr-defined]
    both = find_target(str(tmp_path / "store"))
    with pytest.raises(UsageError, match="made, other"):
        both.snapshot()
    assert find_target(str(tmp_path / "store"), ref="other").snapshot().snapshot_id == document["snapshot_id"]


def test_what_is_neither_configuration_nor_store_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="neither a configuration nor a store"):
        find_target(str(tmp_path / "nowhere"))
    with pytest.raises(UsageError, match="no store is in this folder"):
        find_target(str(tmp_path))
    with pytest.raises(UsageError, match="object store's address"):
        find_target("gs://bucket")
    (tmp_path / "refs").mkdir()
    assert "nothing is published yet" in target_status(find_target(str(tmp_path))).lines
    with pytest.raises(UsageError, match="only for a configuration"):
        find_target(str(tmp_path), ["seed=1"])


def test_plan_and_show_work_on_a_store_away(made_run: tuple[Config, Report], made_away: Config) -> None:
    config, _ = made_run
    assert make_plan(made_away).document == make_plan(config).document
    assert show_episodes(made_away, sample=2).document == show_episodes(config, sample=2).document
