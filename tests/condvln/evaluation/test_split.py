"""A split from its files to its scores: the manifest's reader, predictions matched to tasks, navmeshes proven."""

from __future__ import annotations

import gzip
import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.episodes.identity import numeric_id
from condvln.evaluation.episode_stats import evaluation_of_stats, is_episode_stats, read_episode_stats
from condvln.evaluation.evaluate import AXES, Evaluation, evaluate
from condvln.evaluation.predictions import Prediction, read_predictions
from condvln.evaluation.split import SplitOptions, evaluate_split, split_tasks
from condvln.evaluation.task import Task, read_tasks
from condvln.export.snapshot import export_snapshot
from condvln.navigation.navmesh_folder import NavmeshFolder
from condvln.navigation.pathfinder import Pathfinder
from schemas.errors import FormatError, MissingFileError, PathEscapeError, UsageError
from tests.condvln.evaluation.conftest import OpenPlain, task_with
from tests.made_snapshot import made_snapshot


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export")
    export_snapshot(made_snapshot(), out)
    return out


@pytest.fixture(scope="module")
def tasks(export: Path) -> list[Task]:
    return split_tasks(export, "train")


def perfect(task: Task) -> Prediction:
    return Prediction(task.episode_id, task.reference, True, False)


def world(task: Task) -> Any:
    return OpenPlain()


def test_tasks_are_those_of_the_manifest(export: Path, tasks: list[Task]) -> None:
    lines = [json.loads(line) for line in (export / "manifest" / "train.jsonl").read_text().splitlines()]
    assert [task.episode_id for task in tasks] == [str(line["episode_id"]) for line in lines]
    for task, line in zip(tasks, lines, strict=True):
        gold = line["leaves"][line["gold_leaf"]]
        assert task.gold.goals.tolist() == gold["goals"]
        assert task.gold.subgoals.tolist() == [s["position"] for s in gold["subgoals"]]
        assert task.reference[0].tolist() == line["start_position"]
        assert task.axes["scene"] == f"{line['source']}/{line['scene_id']}"
        assert set(task.axes) == set(AXES)
        assert len(task.leaves) == len(line["leaves"])


def test_without_ground_truth_the_reference_path_is_made_dense(export: Path, tasks: list[Task]) -> None:
    for bare, full in zip(read_tasks(export / "manifest" / "train.jsonl"), tasks, strict=True):
        np.testing.assert_allclose(bare.reference, full.reference, atol=6e-4)  # ground truth is rounded to 1 mm


def test_perfect_paths_score_one(tasks: list[Task]) -> None:
    found = evaluate(tasks, map(perfect, tasks), world, agent="perfect")
    assert len(found) == len(tasks)
    for name in ("success", "oracle_success", "ndtw", "sdtw", "bsa_all", "csr_all"):
        assert (found.scores[name] == 1).all(), name
    np.testing.assert_allclose(found.scores["spl_route"], 1, atol=1e-3)
    np.testing.assert_allclose(found.scores["cls"], 1, atol=1e-3)
    assert not np.isnan(found.scores["bsa"]).any()


def test_predictions_in_any_order_and_missing_ones(tasks: list[Task]) -> None:
    handed_in = [perfect(task) for task in tasks]
    whole = evaluate(tasks, handed_in, world)
    assert evaluate(tasks, handed_in[::-1], world).rows() == whole.rows()
    half = evaluate(tasks, handed_in[: len(tasks) // 2], world)
    assert half.scores["missing"].sum() == len(tasks) - len(tasks) // 2
    assert half.scores["success"].sum() == len(tasks) // 2
    assert evaluate(tasks, [], world).scores["success"].sum() == 0


def test_rxr_numbers_stand_for_ids(tasks: list[Task]) -> None:
    numbered = [Prediction(str(numeric_id(t.episode_hash)), t.reference, True, False) for t in tasks]
    assert (evaluate(tasks, numbered, world).scores["success"] == 1).all()
    assert len({numeric_id(t.episode_hash) for t in tasks}) == len(tasks)
    with pytest.raises(FormatError, match="predicted twice"):
        evaluate(tasks, [numbered[0], perfect(tasks[0])], world)


def test_unknown_and_repeated_ids_are_errors(tasks: list[Task]) -> None:
    stranger = Prediction("stranger", tasks[0].reference, True, False)
    with pytest.raises(FormatError, match=r"agent.json: no episode 'stranger' in this split"):
        evaluate(tasks, [stranger], world, where="agent.json")
    with pytest.raises(FormatError, match="predicted twice"):
        evaluate(tasks, [perfect(tasks[0])] * 2, world)


def test_a_sweep_keeps_what_depends_on_the_distance(tasks: list[Task]) -> None:
    short = [Prediction(t.episode_id, t.reference[:-5], True, False) for t in tasks if len(t.reference) > 6]
    found = evaluate(tasks, short, world, radii=(0.5, 1.0, 3.0))
    assert set(found.sweep) == {0.5, 1.0, 3.0}
    rates = [found.sweep[radius]["success"].mean() for radius in (0.5, 1.0, 3.0)]
    assert rates == sorted(rates)
    assert rates[0] < rates[-1]
    np.testing.assert_array_equal(found.sweep[1.0]["spl"], found.scores["spl"])


def test_rows_are_plain(tasks: list[Task]) -> None:
    rows = evaluate(tasks, [], world).rows()
    assert json.loads(json.dumps(rows, allow_nan=False)) == rows
    assert rows[0]["episode_id"] == tasks[0].episode_id
    assert rows[0]["steps"] is None


# -- files -------------------------------------------------------------------------------------------------------------


def spoiled(export: Path, folder: Path, change: Any) -> Path:
    lines = [json.loads(line) for line in (export / "manifest" / "train.jsonl").read_text().splitlines()]
    change(lines)
    path = folder / "train.jsonl"
    path.write_text("\n".join(json.dumps(line) for line in lines))
    return path


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda lines: lines[2].pop("gold_leaf"), "line 3: gold_leaf"),
        (lambda lines: lines[1].update(extra=1), "line 2: extra"),
        (lambda lines: lines[1].update(gold_leaf=9), "line 2: gold_leaf: there is no leaf"),
        (lambda lines: lines[1].update(gold_leaf=-1), "line 2: gold_leaf: there is no leaf"),
        (lambda lines: lines[1]["leaves"].pop(), "line 2: leaves"),
        (lambda lines: lines[1]["leaves"][0].update(leaf=1), "line 2: leaves"),
        (lambda lines: lines.append(lines[0]), "occurs twice"),
        (lambda lines: lines[0].update(start_position=[0, 0]), "line 1: start_position"),
    ],
)
def test_a_damaged_manifest_is_told_by_line(export: Path, tmp_path: Path, change: Any, says: str) -> None:
    with pytest.raises(FormatError, match=says):
        list(read_tasks(spoiled(export, tmp_path, change)))


def test_ground_truth_must_fit(export: Path, tmp_path: Path) -> None:
    manifest = export / "manifest" / "train.jsonl"
    truth = tmp_path / "gt.json"
    for text, says in (
        ("{}", "has no entry in"),
        ('{"a": {"locations": []}}', "episode a: locations: empty"),
        ('{"a": {"locations": [[0, 0]]}}', "episode a"),
        ("[[1]]", "an array"),
    ):
        truth.write_text(text)
        with pytest.raises(FormatError, match=says):
            list(read_tasks(manifest, truth))


def test_no_such_split_names_those_there_are(export: Path) -> None:
    with pytest.raises(MissingFileError, match="test, train, val_seen, val_unseen"):
        split_tasks(export, "all")


@pytest.fixture
def navmesh(tmp_path: Path, l_shape: Pathfinder) -> tuple[Path, str]:
    path = tmp_path / "data" / "meshes" / "a.navmesh"
    path.parent.mkdir(parents=True)
    l_shape.save(path)
    return path, hashlib.sha256(path.read_bytes()).hexdigest()


LEAVES = [{"goals": [[1, 0, 1]]}, {"goals": [[3, 0, 1]]}]


def test_navmeshes_are_found_below_the_roots_and_proven(navmesh: tuple[Path, str], tmp_path: Path) -> None:
    _, digest = navmesh
    task = task_with(LEAVES, navmesh="meshes/a.navmesh", navmesh_sha256=digest)
    folder = NavmeshFolder((tmp_path, tmp_path / "data"))
    assert folder(task).navigable_area == pytest.approx(12)
    assert folder(task) is folder(task)
    with pytest.raises(MissingFileError, match="--navmesh-root"):
        NavmeshFolder((tmp_path,))(task)
    with pytest.raises(FormatError, match="its hash differs"):
        NavmeshFolder((tmp_path / "data",))(task_with(LEAVES, navmesh="meshes/a.navmesh", navmesh_sha256="1" * 64))


@pytest.mark.parametrize("name", ["/etc/passwd", "../data/meshes/a.navmesh", "a/../../b"])
def test_a_navmesh_outside_of_the_roots_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(PathEscapeError):
        NavmeshFolder((tmp_path,))(task_with(LEAVES, navmesh=name))


def test_files_in_evaluations_out(
    export: Path, tmp_path: Path, tasks: list[Task], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("condvln.evaluation.split.NavmeshFolder", lambda roots: world)
    poses = {
        t.episode_id: [{"position": p, "heading": 0, "stop": i == 1} for i, p in enumerate(t.reference[:2].tolist())]
        for t in tasks
    }
    first, second = tmp_path / "near.json", tmp_path / "walker.jsonl"
    first.write_text(json.dumps(poses))
    lines = [{"instruction_id": t.episode_id, "path": t.reference.tolist()} for t in tasks]
    second.write_text("\n".join(json.dumps(line) for line in lines))
    found, there = evaluate_split(export, "train", [first, second], SplitOptions(radii=(3.0,)))
    assert [e.agent for e in found] == ["near", "walker"]
    assert len(there) == len(tasks)
    assert found[0].scores["success"].mean() < 0.2
    assert found[1].scores["success"].mean() == 1
    with pytest.raises(UsageError, match="have the same name"):
        evaluate_split(export, "train", [first, first])


# -- results that others wrote -----------------------------------------------------------------------------------------


def test_episode_stats_are_aggregated_without_flattery(tmp_path: Path) -> None:
    tasks = [
        task_with(LEAVES, episode_id=name)
        if name != "d"
        else task_with([{**LEAVES[0], "subgoals": [[0, 0, 1]]}, LEAVES[1]], episode_id=name)
        for name in "abcd"
    ]
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "stats_a.json").write_text(
        '{"distance_to_goal": 0.5, "success": 1.0, "spl": 0.9, "collisions": {"count": 3}}'
    )
    (folder / "stats_b.json").write_text('{"distance_to_goal": Infinity, "success": 0.0, "spl": NaN}')
    (folder / "stats_d.json").write_text('{"d": {"success": true, "bsa": 1.0, "spl": 1.0}}')
    (folder / "notes.json").write_text("[]")
    stats = read_episode_stats(folder)
    assert stats["a"] == {"navigation_error": 0.5, "success": 1.0, "spl": 0.9, "collisions": 3.0}
    found: Evaluation = evaluation_of_stats(tasks, stats, agent="theirs")
    assert found.scores["success"].tolist() == [1, 0, 0, 1]
    assert found.scores["missing"].tolist() == [0, 0, 1, 0]
    assert math.isnan(found.scores["navigation_error"][1])  # infinite is undefined, never 0
    assert math.isnan(found.scores["spl"][1])
    np.testing.assert_array_equal(found.scores["bsa"], [1, np.nan, np.nan, 1])
    np.testing.assert_array_equal(found.scores["csr"], [1, np.nan, np.nan, 1])
    np.testing.assert_array_equal(found.scores["bsa_all"], [1, 0, 0, 1])
    together = tmp_path / "snapshot.json"
    together.write_text(json.dumps({"a": {"success": 1}}))
    assert read_episode_stats(together) == {"a": {"success": 1.0}}
    with pytest.raises(FormatError, match="no episode 'z'"):
        evaluation_of_stats(tasks, {"z": {}})


BRANCHES = ("bsa", "csr", "bsa_all", "csr_all")


def test_results_of_the_forks_have_their_own_bsa_and_those_of_vlnce_none(tmp_path: Path) -> None:
    with_stop = [{**LEAVES[0], "subgoals": [[0, 0, 1]]}, LEAVES[1]]
    tasks = [task_with(with_stop if name in "cd" else LEAVES, episode_id=name) for name in "abcde"]
    path = tmp_path / "stats.json"
    stock = {name: {"success": float(name in "ac"), "spl": 0.5} for name in "abcd"}
    path.write_text(json.dumps(stock))
    plain = evaluation_of_stats(tasks, read_episode_stats(path))
    for name in BRANCHES:
        assert np.isnan(plain.scores[name]).all(), "what is not there is undefined"
    assert plain.scores["success"].tolist() == [1, 0, 1, 0, 0]
    assert plain.scores["spl"].tolist() == [0.5, 0.5, 0.5, 0.5, 0]
    assert np.isnan(plain.scores["ndtw"]).all(), "not even where an episode is missing"
    theirs = {"a": 1.0, "b": 0.0, "c": 0.25, "d": 1.0}
    path.write_text(json.dumps({name: {**stock[name], "branch_selection_accuracy": theirs[name]} for name in stock}))
    fork = evaluation_of_stats(tasks, read_episode_stats(path))
    assert fork.scores["bsa_all"].tolist() == [1, 0, 0.25, 1, 0]
    assert fork.scores["csr_all"].tolist() == [1, 0, 0, 0, 0]
    np.testing.assert_array_equal(fork.scores["bsa"], [1, np.nan, 0.25, 1, np.nan])


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("stats_a.json", "{", "is not JSON"),
        ("stats_a.json", '{"success": "yes"}', "success is not a number"),
        ("other.json", '{"success": 1}', "neither"),
        ("stats_a.json", "[1]", "neither"),
    ],
)
def test_episode_stats_gone_wrong(tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=says):
        read_episode_stats(tmp_path / name)


def test_episode_stats_of_nothing_or_twice(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="holds no episode"):
        read_episode_stats(tmp_path)
    (tmp_path / "stats_a.json").write_text('{"success": 1}')
    (tmp_path / "stats_b.json").write_text('{"a": {"success": 1}}')
    with pytest.raises(FormatError, match="two results"):
        read_episode_stats(tmp_path)


def test_predictions_read_back_from_vlnce_files_score_the_same(tasks: list[Task], tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    poses = {
        t.episode_id: [{"position": p, "stop": i == len(t.reference) - 1} for i, p in enumerate(t.reference.tolist())]
        for t in tasks
    }
    path.write_text(json.dumps(poses))
    found = evaluate(tasks, read_predictions(path), world)
    assert (found.scores["success"] == 1).all()
    np.testing.assert_array_equal(found.scores["steps"], [len(t.reference) - 1 for t in tasks])


def test_results_of_a_stock_split_without_a_manifest(tmp_path: Path) -> None:
    """As R2R_VLNCE's: {episodes} beside results of VLN-CE by id; paths are refused with a reason."""
    episodes = [
        {"episode_id": number, "scene_id": f"mp3d/{scene}/{scene}.glb"}
        for number, scene in enumerate(("a", "a", "b", "c"))
    ]
    (tmp_path / "val_seen").mkdir()
    (tmp_path / "val_seen" / "val_seen.json").write_text(json.dumps({"episodes": episodes}))
    with gzip.open(tmp_path / "val_seen" / "val_seen.json.gz", "wt") as file:
        json.dump({"episodes": episodes}, file)
    results = tmp_path / "stats.json"
    results.write_text(json.dumps({str(k): {"success": float(k < 2), "spl": k / 4} for k in range(4)}))
    (found,), tasks = evaluate_split(tmp_path, "val_seen", [results])
    assert tasks == []
    assert found.means["success"] == 0.5
    assert found.means["spl"] == pytest.approx(1.5 / 4, abs=1e-12)
    assert np.isnan(found.means["bsa_all"])
    assert np.isnan(found.means["csr"])
    assert found.axes["scene"].tolist() == [episode["scene_id"] for episode in episodes]
    paths = tmp_path / "paths.json"
    paths.write_text(json.dumps({"0": [{"position": [0, 0, 0], "stop": True}]}))
    with pytest.raises(UsageError, match="manifest"):
        evaluate_split(tmp_path, "val_seen", [paths])
    with gzip.open(tmp_path / "val_seen" / "val_seen.json.gz", "wt") as file:
        json.dump({"episodes": [*episodes, episodes[0]]}, file)
    with pytest.raises(FormatError, match="twice"):
        evaluate_split(tmp_path, "val_seen", [results])


def test_lines_of_streamvln_are_results(export: Path, tmp_path: Path) -> None:
    """Its evaluator writes a line an episode, and at last a line that sums them up."""
    tasks = split_tasks(export, "train")
    rows = [
        {
            "scene_id": "apt",
            "episode_id": task.episode_id if k % 2 else int(task.episode_id),
            "success": float(k % 2),
            "spl": 0.5 * (k % 2),
            "os": 1.0,
            "ne": 1.5 + k,
            "steps": 10 + k,
            "episode_instruction": "If {there} is [a lamp",
        }
        for k, task in enumerate(tasks)
    ]
    total = {"sucs_all": 0.5, "length": len(rows)}
    (tmp_path / "result.json").write_text("\n".join(json.dumps(row) for row in [*rows, total]) + "\n")
    assert is_episode_stats(tmp_path / "result.json")
    ((found,), _) = evaluate_split(export, "train", [tmp_path / "result.json"])
    means = found.means
    assert means["success"] == pytest.approx(sum(row["success"] for row in rows) / len(rows))
    assert means["navigation_error"] == pytest.approx(sum(row["ne"] for row in rows) / len(rows))
    assert means["oracle_success"] == 1.0
    assert means["steps"] == pytest.approx(sum(row["steps"] for row in rows) / len(rows))
    assert math.isnan(means["csr_all"])
