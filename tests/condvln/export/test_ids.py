"""Ids of episodes: integers in every file, made from a hash that stands beside them; and files whose ids are hashes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.episodes.identity import numeric_id
from condvln.evaluation.episode_stats import evaluation_of_stats, read_episode_stats
from condvln.evaluation.evaluate import evaluate
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.split import split_tasks
from condvln.evaluation.task import Task
from condvln.export.snapshot import export_snapshot
from condvln.export.splits import SPLITS
from condvln.export.tables import MemoryTables
from condvln.export.twin import rewrite_split
from condvln.export.validation.folder import validate
from condvln.manifest import read_manifest
from schemas.errors import FormatError
from tests.condvln.evaluation.conftest import OpenPlain
from tests.condvln.export.conftest import linear_text
from tests.former_export import former_export, former_tables
from tests.strict_loader import read

LIMIT = 2**53


@pytest.fixture(scope="module")
def former(exported: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same export as the release before wrote it."""
    return former_export(exported, tmp_path_factory.mktemp("former"))


def walked(tasks: list[Task], names: list[str]) -> list[Prediction]:
    return [Prediction(name, task.reference, True, False) for name, task in zip(names, tasks, strict=True)]


def world(task: Task) -> OpenPlain:
    return OpenPlain()


@pytest.mark.parametrize("split", SPLITS)
def test_every_id_of_every_file_is_an_integer_made_from_the_hash(exported: Path, split: str) -> None:
    rows = [json.loads(line) for line in (exported / "manifest" / f"{split}.jsonl").read_text().splitlines()]
    ids = [row["episode_id"] for row in rows]
    assert rows
    assert all(type(name) is int and 0 <= name < LIMIT for name in ids)
    assert len(set(ids)) == len(ids)
    assert ids == [numeric_id(row["episode_hash"]) for row in rows]
    assert all(int(float(name)) == name for name in ids), "JavaScript keeps them"
    for variant in ("vlnce", "ansr", "rxr", "oracle"):
        stem = f"{split}_guide" if variant == "rxr" else split
        episodes = read(exported / variant / split / f"{stem}.json.gz")["episodes"]
        assert [e["episode_id"] for e in episodes] == [e["trajectory_id"] for e in episodes] == ids
        assert all(type(e["episode_id"]) is int for e in episodes)
        assert [e["info"]["episode_hash"] for e in episodes] == [row["episode_hash"] for row in rows]
        assert [int(name) for name in read(exported / variant / split / f"{stem}_gt.json.gz")] == ids
        if variant == "rxr":
            assert [int(e["instruction"]["instruction_id"]) for e in episodes] == ids


def test_the_larger_hash_of_a_collision_is_left_out(tables: MemoryTables, tmp_path: Path) -> None:
    episodes = tables.tables["replicacad"]["episodes"]
    rows = episodes.to_pylist()
    single = [k for k, row in enumerate(rows) if row["group_id"] is None]
    one, other = single[0], single[-1]  # of two scenes
    rows[one]["episode_id"] = rows[other]["episode_id"]
    large = max(rows[k]["episode_hash"] for k in (one, other))
    assert rows[one]["scene_id"] != rows[other]["scene_id"]
    made = type(episodes).from_pylist(rows, episodes.schema)
    report = export_snapshot(
        MemoryTables("two", {"replicacad": {**tables.tables["replicacad"], "episodes": made}}), tmp_path
    )
    (reason,) = [name for name in report.left_out if "id_collision" in name]
    assert report.left_out[reason] == 1
    published = [row for split in SPLITS for row in read_manifest(tmp_path / "manifest" / f"{split}.jsonl")]
    assert large not in {row.episode_hash for row in published}
    assert len({row.episode_id for row in published}) == len(published)


@pytest.mark.parametrize("names", [lambda t: t.episode_id, lambda t: t.episode_hash])
def test_predictions_by_the_hash_score_as_those_by_the_id(exported: Path, tmp_path: Path, names: Any) -> None:
    tasks = split_tasks(exported, "train")
    own = evaluate(tasks, walked(tasks, [task.episode_id for task in tasks]), world)
    assert (own.scores["success"] == 1).all()
    other = evaluate(tasks, walked(tasks, [names(task) for task in tasks]), world)
    assert other.rows() == own.rows()
    both = walked(tasks[:1] * 2, [tasks[0].episode_id, tasks[0].episode_hash])
    with pytest.raises(FormatError, match="predicted twice"):
        evaluate(tasks, both, world)
    stats = tmp_path / "stats.json"
    stats.write_text(json.dumps({names(task): {"success": 1.0, "spl": k / len(tasks)} for k, task in enumerate(tasks)}))
    found = evaluation_of_stats(tasks, read_episode_stats(stats))
    np.testing.assert_allclose(found.scores["spl"], np.arange(len(tasks)) / len(tasks))
    twice = {tasks[0].episode_id: {"success": 1.0}, tasks[0].episode_hash: {"success": 1.0}}
    with pytest.raises(FormatError, match="two results"):
        evaluation_of_stats(tasks, twice)


# -- files of the release before ---------------------------------------------------------------------------------------


def test_a_former_export_is_evaluated(former: Path, exported: Path) -> None:
    tasks, now = split_tasks(former, "train"), split_tasks(exported, "train")
    assert [task.episode_id for task in tasks] == [task.episode_hash for task in now]
    numbers = [str(numeric_id(task.episode_id)) for task in tasks]  # of its RxR files
    for names in ([task.episode_id for task in tasks], numbers):
        found = evaluate(tasks, walked(tasks, names), world)
        assert (found.scores["success"] == 1).all()
        assert (found.scores["ndtw"] == 1).all()


def test_a_former_export_is_valid_but_loaders_that_want_numbers_are_warned_of(former: Path) -> None:
    report = validate(former)
    assert not [finding for finding in report if finding.severity == "error"]
    assert {finding.code for finding in report} == {"id-not-integer"}
    assert len(report) == len(list(former.glob("*/*/*.json.gz"))) / 2, "one for each document, not for each episode"


def test_a_former_snapshot_exports_to_the_same_files(tables: MemoryTables, exported: Path, tmp_path: Path) -> None:
    export_snapshot(former_tables(tables), tmp_path, oracle_texts=linear_text)
    for path in exported.rglob("*"):
        if path.is_file():
            assert (tmp_path / path.relative_to(exported)).read_bytes() == path.read_bytes(), path.name


def test_an_export_over_a_former_one_finds_its_episodes_again(
    tables: MemoryTables, former: Path, tmp_path: Path
) -> None:
    place = Path(shutil.copytree(former, tmp_path / "place"))
    later = MemoryTables("later", tables.tables)
    report = export_snapshot(later, place, oracle_texts=linear_text, former=former_tables(tables))
    total = sum(report.episodes.values())
    text = (place / "CHANGELOG.md").read_text()
    assert f"{total:,} episodes are as they were" in text
    assert "### Added" not in text
    assert "### Dropped" not in text


def test_the_twin_of_a_former_file(former: Path, exported: Path, tmp_path: Path) -> None:
    manifest = {str(row.episode_id): row for row in read_manifest(former / "manifest" / "train.jsonl")}
    done = rewrite_split(
        former / "vlnce" / "train" / "train.json.gz", manifest, tmp_path / "twin.json.gz", lambda row: "Go."
    )
    assert done.episodes == len(manifest)
