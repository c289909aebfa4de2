"""The discrete variant from files to tables: on an export's R2R file with its manifest, and on a stranger's without."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from condvln.evaluation.evaluate import Evaluation
from condvln.evaluation.plots import save_figures
from condvln.evaluation.reading import ReadRules
from condvln.evaluation.score import ScoreRules
from condvln.evaluation.split import SplitOptions, evaluate_split
from condvln.evaluation.tables import all_tables
from condvln.evaluation.task import Task
from condvln.export.snapshot import export_snapshot
from condvln.navigation.graph_pathfinder import GraphFolder
from schemas.errors import FormatError, MissingFileError, UsageError
from tests.made_snapshot import MemoryTables, made_snapshot

SCAN = "17DRP5sb8fy"  # of the official training list
SIDE = 7
SPACING = 2.0


def connectivity() -> list[dict[str, Any]]:
    """A grid of viewpoints, each joined to its neighbours."""
    places = [(x, y) for x in range(SIDE) for y in range(SIDE)]
    return [
        {
            "image_id": f"v{x}{y}",
            "pose": [1, 0, 0, SPACING * x, 0, 1, 0, SPACING * y, 0, 0, 1, 1.5, 0, 0, 0, 1],
            "height": 1.5,
            "included": True,
            "unobstructed": [abs(x - a) + abs(y - b) == 1 for a, b in places],
            "visible": [True] * len(places),
        }
        for x, y in places
    ]


def at(name: str) -> dict[str, float]:
    """Place of a viewpoint in Habitat's frame, 10 cm off."""
    return {"x": SPACING * int(name[1]) + 0.1, "y": 0.0, "z": -SPACING * int(name[2])}


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every start in the middle, leaves at the corners, subgoals half way: all are far apart on the graph."""
    out = tmp_path_factory.mktemp("discrete")
    (out / "connectivity").mkdir()
    (out / "connectivity" / f"{SCAN}_connectivity.json").write_text(json.dumps(connectivity()))
    made = made_snapshot({"mp3d": [SCAN]}, per_category=8)
    rows = made.tables["mp3d"]["episodes"].to_pylist()
    for row in rows:
        row["start_position"] = at("v33")
        for leaf, corner in zip(row["leaves"], ("v00", "v06", "v60", "v66"), strict=False):
            leaf["goals"] = [at(corner)]
            for subgoal in leaf["subgoals"]:
                subgoal["position"] = at("v11" if corner == "v00" else f"v{corner[1]}3")
    episodes = pa.Table.from_pylist(rows, made.tables["mp3d"]["episodes"].schema)
    tables = MemoryTables("discrete", {"mp3d": {**made.tables["mp3d"], "episodes": episodes}})
    report = export_snapshot(tables, out / "export", graphs=GraphFolder(out / "connectivity"))
    assert report.r2r_left_out == {}
    return out / "export"


def options(export: Path, **changes: Any) -> SplitOptions:
    return SplitOptions(connectivity=(export.parent / "connectivity",), **changes)


def walks(export: Path, path: Path, walk: Any) -> Path:
    items = json.loads((export / "r2r" / "R2R_train.json").read_text())
    records = [
        {"instr_id": f"{item['path_id']}_0", "trajectory": [[v, 0.0, 0.0] for v in walk(item["path"])]}
        for item in items
    ]
    path.write_text(json.dumps(records))
    return path


@pytest.fixture(scope="module")
def found(export: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Evaluation], list[Task]]:
    folder = tmp_path_factory.mktemp("predictions")
    perfect = walks(export, folder / "perfect.json", lambda path: path)
    lazy = walks(export, folder / "lazy.json", lambda path: path[:1])
    corner = walks(export, folder / "corner.json", lambda path: ["v33", "v11", "v00"])
    return evaluate_split(export, "train", [perfect, lazy, corner], options(export, radii=(1.0, 5.0)))


def test_perfect_lazy_and_stubborn(found: tuple[list[Evaluation], list[Task]], export: Path) -> None:
    (perfect, lazy, corner), tasks = found
    items = json.loads((export / "r2r" / "R2R_train.json").read_text())
    assert [int(task.episode_id) for task in tasks] == [item["path_id"] for item in items]
    for name in ("success", "oracle_success", "bsa_all", "csr_all", "leaf_correct", "ndtw", "spl_route"):
        np.testing.assert_allclose(perfect.scores[name], 1, err_msg=name)
    assert (lazy.scores["success"] == 0).all()
    assert (lazy.scores["no_commit"] == 1).all()
    assert (corner.scores["committed_leaf"] == 0).all()
    right = np.array([float(task.gold_leaf == 0) for task in tasks])
    assert 0 < right.mean() < 1
    # v11, the subgoal on the way to leaf 0, is 4 m of graph from the others' or more
    for name in ("success", "leaf_correct", "csr_all", "bsa_all"):
        assert corner.scores[name].tolist() == right.tolist(), name
    assert corner.scores["wrong_branch"].tolist() == (1 - right).tolist()
    assert [e.agent for e in (perfect, lazy, corner)] == ["perfect", "lazy", "corner"]


def test_paths_over_viewpoints_have_all_measures_that_need_no_actions(
    found: tuple[list[Evaluation], list[Task]],
) -> None:
    scores = found[0][2].scores
    lacking = {name for name, values in scores.items() if np.isnan(values).all()}
    looking = {"spl_look", "ndtw_look", "sdtw_look", "cls_look", "justified"}
    assert lacking == {"steps", "collisions", "stopped", "over_budget", "off_navmesh", *looking}


def test_three_predictions_for_one_text_are_one_episode(
    export: Path, found: tuple[list[Evaluation], list[Task]], tmp_path: Path
) -> None:
    """R2R's evaluator asks for three instructions a path, so our files have each text three times."""
    items = json.loads((export / "r2r" / "R2R_train.json").read_text())
    assert all(len(item["instructions"]) == 3 and len({*item["instructions"]}) == 1 for item in items)
    records = [
        {"instr_id": f"{item['path_id']}_{k}", "trajectory": [item["path"], item["path"][:1]][k > 0]}
        for item in items
        for k in range(3)
    ]
    file = tmp_path / "three.json"
    file.write_text(json.dumps(records))
    (three,), tasks = evaluate_split(export, "train", [file], options(export))
    assert len(three) == len(tasks) == len(items)
    for name, values in found[0][0].scores.items():
        np.testing.assert_array_equal(three.scores[name], values, err_msg=name)
    assert three.notes == (f"{2 * len(items)} predictions for texts that the file has again were left out",)
    file.write_text(json.dumps([record for record in records if record["instr_id"].endswith("_1")]))
    (second,), _ = evaluate_split(export, "train", [file], options(export))
    assert second.scores["missing"].sum() == 0
    assert second.notes == ()


def test_a_strangers_file_gets_r2rs_own_measures(export: Path, tmp_path: Path) -> None:
    (tmp_path / "R2R_train.json").write_bytes((export / "r2r" / "R2R_train.json").read_bytes())
    perfect = walks(export, tmp_path / "perfect.json", lambda path: path)
    evaluations, tasks = evaluate_split(tmp_path, "train", [perfect], options(export))
    assert tasks == []
    tables = {table.name: table for table in all_tables(evaluations, tasks)}
    assert set(tables) == {"main", "branches"}
    keys = [column.key for column in tables["main"].columns]
    assert keys == [
        "source", "agent", "success", "path_length", "navigation_error", "oracle_success", "spl",
        "spl_route", "ndtw", "sdtw", "cls", "episodes",
    ]  # fmt: skip
    with pytest.raises(UsageError, match="depth"):
        save_figures(evaluations, tmp_path / "plots")


def test_what_is_amiss_is_said(export: Path, tmp_path: Path) -> None:
    graph = walks(export, tmp_path / "graph.json", lambda path: path)
    space = tmp_path / "space.json"
    space.write_text('{"e": [{"position": [0, 0, 0], "stop": true}]}')
    with pytest.raises(UsageError, match="two calls"):
        evaluate_split(export, "train", [graph, space], options(export))
    for changes in (
        {"rules": ScoreRules(distance="euclidean")},
        {"rules": ScoreRules(fast_dtw=True)},
        {"reading": ReadRules(assume_stop=True)},
        {"forward": 1.0},
    ):
        with pytest.raises(UsageError, match="scored by R2R's rules"):
            evaluate_split(export, "train", [graph], options(export, **changes))
    with pytest.raises(MissingFileError, match="--connectivity"):
        evaluate_split(export, "train", [graph])
    with pytest.raises(MissingFileError, match=r"R2R_train\.json"):
        evaluate_split(tmp_path, "train", [graph], options(export))
    records = json.loads(graph.read_text())
    graph.write_text(json.dumps([*records, records[0]]))
    with pytest.raises(FormatError, match="the file has two predictions of this episode"):
        evaluate_split(export, "train", [graph], options(export))
    graph.write_text(json.dumps([{**records[0], "trajectory": []}]))
    items = json.loads((export / "r2r" / "R2R_train.json").read_text())
    for path, says in ([], "reference path is empty"), (["nowhere"], "no viewpoint 'nowhere'"):
        items[0]["path"] = path
        (tmp_path / "R2R_train.json").write_text(json.dumps(items))
        with pytest.raises(FormatError, match=says):
            evaluate_split(tmp_path, "train", [graph], options(export))
    missing, _ = evaluate_split(export, "train", [graph], options(export))
    assert missing[0].scores["missing"].mean() == 1
