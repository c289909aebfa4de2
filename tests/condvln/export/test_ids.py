"""Ids of episodes: integers in every file, made from the hash beside them; predictions may name either."""

from __future__ import annotations

import json
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
from condvln.manifest import manifest_lines, read_manifest
from schemas.errors import FormatError
from tests.condvln.evaluation.conftest import OpenPlain
from tests.made_snapshot import MemoryTables
from tests.strict_loader import read

LIMIT = 2**53


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
        kind = str if variant == "rxr" else int  # RxR's loader makes no texts of them
        assert [e["episode_id"] for e in episodes] == [e["trajectory_id"] for e in episodes] == [*map(kind, ids)]
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


@pytest.mark.parametrize("own", [{"episode_id": "a1"}, {"episode_id": "12", "episode_hash": "a"}, {"episode_id": 12}])
def test_a_manifest_of_an_older_release_is_refused_with_what_to_do(
    exported: Path, tmp_path: Path, own: dict[str, Any]
) -> None:
    """Its ids were texts, of the hash or of the number."""
    row = json.loads((exported / "manifest" / "train.jsonl").read_text().splitlines()[0])
    del row["episode_id"], row["episode_hash"]
    (tmp_path / "train.jsonl").write_text(json.dumps(row | own) + "\n")
    with pytest.raises(FormatError, match=r"train\.jsonl: line 1: episode_(id|hash): .*Export the split again"):
        list(read_manifest(tmp_path / "train.jsonl"))
    with pytest.raises(FormatError, match=r"train\.jsonl: line 1: episode_(id|hash): .*Export the split again"):
        [line.ids() for line in manifest_lines(tmp_path / "train.jsonl")]
