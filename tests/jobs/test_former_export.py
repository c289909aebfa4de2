"""Exports of the release before integer ids, under every command that reads one."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from jobs.command import app
from jobs.export import export_snapshot_of
from jobs.report import Report
from jobs.show_export import show_export
from schemas.config import Config
from tests.former_export import former_export

runner = CliRunner()


@pytest.fixture(scope="module")
def former(export: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return former_export(export, tmp_path_factory.mktemp("former"))


def answered(*words: object) -> Any:
    result = runner.invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_it_is_walked_evaluated_validated_and_shown(
    former: Path, split: str, made_dataset: Path, tmp_path: Path
) -> None:
    roots = ("--navmesh-root", made_dataset)
    answered("walk", former, split, "--agent", "oracle", "--out", tmp_path / "oracle.json", *roots)
    lines = (former / "manifest" / f"{split}.jsonl").read_text().splitlines()
    hashes = [json.loads(line)["episode_id"] for line in lines]
    assert list(json.loads((tmp_path / "oracle.json").read_text())) == hashes
    tables = json.loads(answered("evaluate", former, split, tmp_path / "oracle.json", *roots, "--json"))["tables"]
    (row,) = next(table for table in tables if table["name"] == "main")["rows"]
    assert row["success"]["mean"] == row["bsa_all"]["mean"] == 1
    assert "\n0 errors, " in answered("export", "--validate", former)
    (shown,) = show_export(former, episode=hashes[0]).document["episodes"]
    assert shown["episode_id"] == hashes[0]
    answered("oracle", former, split, "--out", tmp_path / "twin.json.gz")


def test_predictions_by_hash_are_taken_by_the_export_of_now(
    former: Path, export: Path, split: str, made_dataset: Path, tmp_path: Path
) -> None:
    roots = ("--navmesh-root", made_dataset)
    for folder in (former, export):
        answered("walk", folder, split, "--agent", "always-then", "--out", tmp_path / f"{folder.name}.json", *roots)
    files = [tmp_path / f"{folder.name}.json" for folder in (former, export)]
    tables = json.loads(answered("evaluate", export, split, *files, *roots, "--json"))["tables"]
    one, other = next(table for table in tables if table["name"] == "main")["rows"]
    assert {**one, "agent": ""} == {**other, "agent": ""}


def test_a_new_export_takes_its_place_and_knows_its_episodes(
    made_run: tuple[Config, Report], former: Path, export: Path, tmp_path: Path
) -> None:
    config, _ = made_run
    place = Path(shutil.copytree(former, tmp_path / "place"))
    index = json.loads((place / "export.json").read_text())
    (place / "export.json").write_text(json.dumps({**index, "snapshot": "former"}))
    for path in (place / "manifest").glob("*.jsonl"):
        path.write_text(path.read_text().replace(index["snapshot"], "former"))
    report = export_snapshot_of(config.model_copy(update={"export": place}))
    assert report.exit_code == 0
    total = sum(report.document["episodes"].values())
    text = (place / "CHANGELOG.md").read_text()
    assert f"{total:,} episodes are as they were" in text
    assert "### " not in text
    for path in (export / "manifest").glob("*.jsonl"):
        assert (place / "manifest" / path.name).read_bytes() == path.read_bytes()
