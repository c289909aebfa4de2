"""A benchmark over made scenes: one id however it is built, differences named, boards ranked and tested."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from condvln.evaluation.split import split_tasks
from condvln.export.splits import SPLITS, scene_group
from condvln.samples import make_samples
from condvln.sources.scene_source import SceneChoice
from jobs.benchmark import (
    RECORD,
    Benchmark,
    build_benchmark,
    check_benchmark,
    part_lines,
    read_record,
)
from jobs.evaluate import walk_split
from jobs.leaderboard import REFERENCES, score_benchmark
from jobs.pipeline import code_versions
from schemas.errors import ConfigError, FormatError, MissingFileError, UsageError
from tests.ending import kill_driver
from tests.once import made_once

"""Versions of stages that are past."""


def written(folder: Path, root: Path, **changes: Any) -> Path:
    """A benchmark of one category over the dataset `root`; its store and export are in `folder`."""
    folder.mkdir(exist_ok=True)
    run = {
        "name": "small",
        "store": "store",
        "export": "export",
        "sources": [{"family": "replicacad", "root": str(root)}],
        "instructions": {"per_category": {"simple": 6}, "counterfactual_groups": 0},
        "splits": {"scenes": {"val_unseen": ["replicacad/*"]}, "bias": "off"},
        **changes.pop("run", {}),
    }
    (folder / "run.yaml").write_text(yaml.safe_dump(run))
    document = {"benchmark": "small", "version": "v0", "draft": True, "run": "run.yaml", "floor": 5}
    document |= {"instructions": 100, **changes}
    (folder / "benchmark.yaml").write_text(yaml.safe_dump(document))
    return folder / "benchmark.yaml"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:

    def make(folder: Path) -> Path:
        make_samples(folder, family="replicacad", scenes=2, seed=5)
        return folder

    return made_once(tmp_path_factory, "dataset of the benchmark", make)


@pytest.fixture(scope="module")
def built(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """The benchmark's file and the report of its build; read only."""

    def make(folder: Path) -> tuple[Path, Any]:
        path = written(folder, dataset)
        return path, build_benchmark(path, inline=True)

    return made_once(tmp_path_factory, "benchmark", make)


def test_a_build_says_what_it_is_and_what_it_lacks(built: tuple[Path, Any]) -> None:
    path, report = built
    assert report.exit_code == 3, "cells below the floor, and too few instructions"
    record = read_record(path.parent / "export")
    assert "v0 (draft: it may still change)" in report.lines[0]
    assert record.stages == code_versions(Benchmark.read(path).config)
    assert any(line.startswith(f"SHORT: {record.instructions} instructions of 100") for line in report.lines)
    assert record.draft
    assert set(record.scenes) == {f"replicacad/made_00{k}" for k in range(2)}
    exported = json.loads((path.parent / "export" / "export.json").read_text())
    assert record.export_digest == exported["digest"]
    assert sum(cell.episodes for cell in record.cells) == sum(exported["episodes"].values())
    assert {(c.split, c.source, c.category) for c in record.cells} == {(s, "replicacad", "simple") for s in SPLITS}
    for cell in record.cells:
        assert cell.shortfall == max(0, 5 - cell.episodes)
        said = f"SHORT: split {cell.split}: 1 of 1 cells have fewer than 5 episodes"
        assert any(line.startswith(said) for line in report.lines) == bool(cell.shortfall)
    (source,) = record.sources.items()
    assert (source[0], source[1].scenes) == ("replicacad", 2)
    assert source[1].instructions == record.instructions
    assert source[1].episodes == sum(exported["episodes"].values())
    assert any("split test" in line and line.endswith("; nothing from replicacad") for line in report.lines)
    text = (path.parent / "export" / RECORD).read_text()
    assert str(path.parent) not in text, "a record holds no path of the machine"


def test_a_build_of_a_part_of_the_scenes_says_so(built: tuple[Path, Any], tmp_path: Path) -> None:
    path, report = built
    assert not any("a part of the scenes" in line for line in report.lines), "the file names no whole copies"
    (table,) = [section for section in report.sections if section.title == "Sources"]
    record = read_record(path.parent / "export")
    found = record.sources["replicacad"]
    assert table.columns == ("source", "scenes", "taken of whole copies", "instructions", "episodes")
    assert table.rows == [("replicacad", 2, None, found.instructions, found.episodes)]
    folder = shutil.copytree(path.parent, tmp_path / "copy")
    document = yaml.safe_load((folder / "benchmark.yaml").read_text())
    for whole, said in (({"replicacad": 2}, None), ({"replicacad": 3, "mp3d": 90}, "mp3d 0 of 90, replicacad 2 of 3")):
        (folder / "benchmark.yaml").write_text(yaml.safe_dump({**document, "scenes": whole}))
        lines = [line for line in build_benchmark(folder / "benchmark.yaml", inline=True).lines if "a part of" in line]
        assert [line.partition(": ")[2].replace(" scenes", "") for line in lines] == ([said] if said else [])
        assert all("so its snapshot id differs from that of a whole build: " in line for line in lines)
    assert read_record(folder / "export") == record, "the record does not depend on it"


def test_missing_scenes_are_told_from_those_that_were_refused(built: tuple[Path, Any]) -> None:
    path, _ = built
    record = read_record(path.parent / "export")
    file = Benchmark.read(path).file.model_copy(update={"scenes": {"mp3d": 90, "replicacad": 3}})

    def lines(**statuses: str) -> list[str]:
        """The report's lines if these scenes of the family have a status of their own."""
        scene = next(iter(record.scenes.values()))
        added = {f"replicacad/{name}": scene.model_copy(update={"status": what}) for name, what in statuses.items()}
        return part_lines(file, record.model_copy(update={"scenes": record.scenes | added}))

    part = "a build of a part of the scenes, so its snapshot id differs from that of a whole build: mp3d 0 of 90 scenes"
    assert lines() == [f"{part}, replicacad 2 of 3 scenes"]
    assert lines(a="quarantined") == [part, "scenes without rows: replicacad 1 quarantined"]
    assert lines(a="skipped", b="quarantined", c="quarantined") == [
        part,
        "scenes without rows: replicacad 2 quarantined, replicacad 1 skipped",
    ]
    bare = file.model_copy(update={"scenes": {}})
    assert part_lines(bare, record) == []


def test_a_build_tells_every_cell_and_the_stops_before_the_goals(built: tuple[Path, Any]) -> None:
    path, report = built
    record = read_record(path.parent / "export")
    tables = {section.title: section for section in report.sections}
    assert [row[:2] for row in tables["Episodes"].rows] == [(split, "replicacad") for split in SPLITS]
    for cell, row in zip(record.cells, tables["Episodes"].rows, strict=True):
        assert row[2:] == ((f"{cell.episodes} of 5" if cell.episodes < 5 else cell.episodes),)
    counted: Counter[tuple[str, int]] = Counter()
    for split in SPLITS:
        for line in (path.parent / "export" / "manifest" / f"{split}.jsonl").read_text().splitlines():
            row = json.loads(line)
            rooms = {branch["lead"]["room_id"] for branch in row["program"]["branches"] if branch["lead"]}
            for leaf in row["leaves"]:
                counted[split, sum(stop["object_id"] not in rooms for stop in leaf["subgoals"])] += 1
    assert sum(counted.values()) > 0
    assert {(one.split, k): n for one in record.stops for k, n in enumerate(one.stops) if n} == counted
    assert {one.leaves for one in record.stops} == {2}
    for one, row in zip(record.stops, tables["Stops before the goal"].rows, strict=True):
        shares = " / ".join(f"{100 * n / sum(one.stops):.1f}" for n in one.stops)
        assert row == (one.split, 2, sum(one.stops), shares, "80 / 17 / 3")


def test_a_build_that_reaches_its_floors_exits_with_zero(built: tuple[Path, Any], tmp_path: Path) -> None:
    folder = shutil.copytree(built[0].parent, tmp_path / "copy")
    document = yaml.safe_load((folder / "benchmark.yaml").read_text())
    document |= {"instructions": 1, "floor": 1, "splits": ["val_unseen"]}
    (folder / "benchmark.yaml").write_text(yaml.safe_dump(document))
    report = build_benchmark(folder / "benchmark.yaml", inline=True)
    assert report.exit_code == 0
    assert not any(line.startswith("SHORT") for line in report.lines)
    assert read_record(folder / "export").snapshot_id == read_record(built[0].parent / "export").snapshot_id


def test_other_copies_of_the_same_scenes_give_the_same_record(
    built: tuple[Path, Any], dataset: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(dataset, tmp_path / "elsewhere" / "copy")
    path = written(tmp_path / "again", copy)
    build_benchmark(path, inline=True)
    assert (path.parent / "export" / RECORD).read_bytes() == (built[0].parent / "export" / RECORD).read_bytes()
    report = check_benchmark(path, built[0].parent / "export", inline=True)
    assert (report.exit_code, report.document["same"], report.document["scenes"]) == (0, True, [])


def test_a_check_names_the_scene_whose_files_differ(built: tuple[Path, Any], dataset: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    scene = copy / "configs" / "scenes" / "made_001.scene_instance.json"
    document = json.loads(scene.read_text())
    document["object_instances"][0]["translation"][0] += 0.05
    scene.write_text(json.dumps(document))
    report = check_benchmark(written(tmp_path / "mine", copy), built[0].parent / "export" / RECORD, inline=True)
    assert report.exit_code == 3
    (found,) = [one for one in report.document["scenes"] if one["scene"] == "replicacad/made_001"]
    assert found["difference"].startswith("its files differ; other rows in ")
    others = [one["difference"] for one in report.document["scenes"] if one["scene"] != "replicacad/made_001"]
    # The priors are counted over all scenes, so that rows of others may follow; never their files.
    assert all(what.startswith("its files are the same") for what in others)
    assert "ANOTHER SNAPSHOT" in report.lines[0]


def test_a_check_names_missing_scenes_and_keys(built: tuple[Path, Any], dataset: Path, tmp_path: Path) -> None:
    run = {"sources": [{"family": "replicacad", "root": str(dataset), "scenes": ["made_000"]}], "seed": 4}
    report = check_benchmark(written(tmp_path / "mine", dataset, run=run), built[0].parent / "export", inline=True)
    assert (report.exit_code, report.document["same"]) == (3, False)
    missing = {"scene": "replicacad/made_001", "difference": "it is not among these copies"}
    assert missing in report.document["scenes"]
    assert "the configuration differs in: seed, sources" in report.lines


def test_a_release_that_can_not_make_the_published_rows_compares_nothing(
    built: tuple[Path, Any], dataset: Path, tmp_path: Path
) -> None:
    """It runs no stage."""
    record = json.loads((built[0].parent / "export" / RECORD).read_text())
    record["stages"]["priors"] += 1
    (tmp_path / RECORD).write_text(json.dumps(record))
    path = written(tmp_path / "mine", dataset)
    report = check_benchmark(path, tmp_path / RECORD, inline=True)
    assert (report.exit_code, report.document["same"], report.document["scenes"]) == (3, None, [])
    assert report.lines[0].startswith("ROWS NOT COMPARED: ")
    assert report.lines[0].endswith(
        f": priors {record['stages']['priors'] - 1} (published: {record['stages']['priors']})"
    )
    assert not (path.parent / "store" / "units").exists()


def test_records_that_are_none_are_refused(built: tuple[Path, Any], tmp_path: Path) -> None:
    (tmp_path / RECORD).write_text("{}")
    with pytest.raises(FormatError, match="not the record of a benchmark"):
        read_record(tmp_path)
    with pytest.raises(MissingFileError):
        read_record(tmp_path / "gone.json")
    record = json.loads((built[0].parent / "export" / RECORD).read_text())
    (tmp_path / RECORD).write_text(json.dumps({**record, "version": "v9"}))
    with pytest.raises(UsageError, match="v9"):
        check_benchmark(built[0], tmp_path / RECORD)
    for text, what in (
        ("[" * 5000, "nested too deeply"),
        ("floor: 1\nfloor: 2", "occurs twice"),
        ("floor: x", "not a bench"),
    ):
        (tmp_path / "bench.yaml").write_text(text)
        with pytest.raises(ConfigError, match=what) as found:
            Benchmark.read(tmp_path / "bench.yaml")
        assert "\n" not in str(found.value)
    with pytest.raises(ConfigError, match="no such benchmark file"):
        Benchmark.read(tmp_path / "none.yaml")


def test_a_board_ranks_references_and_submissions(built: tuple[Path, Any], dataset: Path, tmp_path: Path) -> None:
    export = built[0].parent / "export"
    walk_split(export, "val_unseen", "coin-flip", tmp_path / "mine.json", [dataset], seed=2)
    mine = [tmp_path / "mine.json"]
    report = score_benchmark(export, "val_unseen", mine, out=tmp_path / "board.json", roots=[dataset])
    board = json.loads((tmp_path / "board.json").read_text())
    assert board == report.document
    rows = board["rows"]
    assert {row["agent"] for row in rows} == {*REFERENCES, "mine"}
    assert rows[0]["agent"] == "oracle"
    success = [row["measures"]["success"]["mean"] for row in rows]
    assert success == sorted(success, reverse=True)
    assert success[0] == 1.0
    assert rows[0]["against_above"] is None
    for above, row in pairwise(rows):
        against = row["against_above"]
        assert against["above"] == above["agent"]
        assert against["difference"] == pytest.approx(
            row["measures"]["success"]["mean"] - above["measures"]["success"]["mean"], abs=2e-6
        )
        assert 0 < against["p_value"] <= 1
    (mine,) = [row for row in rows if row["agent"] == "mine"]
    assert (mine["kind"], mine["missing"]) == ("submission", 0)
    assert len(mine["predictions_sha256"]) == 64
    assert board["draft"]
    assert any("no row looker" in line for line in report.lines)
    assert any("this version is a draft" in line for line in report.lines)


def test_results_by_episode_need_no_navmesh_without_references(built: tuple[Path, Any], tmp_path: Path) -> None:
    """What such results don't have is undefined, and nothing is said about agents that nobody asked for."""
    export = built[0].parent / "export"
    lines = (export / "manifest" / "val_unseen.jsonl").read_text().splitlines()
    ids = [str(json.loads(line)["episode_id"]) for line in lines]
    results = {name: {"success": float(k % 2), "spl": 0.5} for k, name in enumerate(ids)}
    (tmp_path / "theirs.json").write_text(json.dumps(results))
    report = score_benchmark(export, "val_unseen", [tmp_path / "theirs.json"], references=False)
    assert f"split val_unseen, {len(ids)} episodes, snapshot " in report.lines[0]
    assert not any("looker" in line for line in report.lines)
    (row,) = report.document["rows"]
    assert row["measures"]["success"]["mean"] == pytest.approx((len(ids) // 2) / len(ids), abs=1e-6)
    assert row["notes"] == [f"spl was set to 0, as a failure has it, in {-(-len(ids) // 2)} of {len(ids)} results"]
    assert any(row["notes"][0] in line for line in report.lines)
    for name in ("spl_route", "csr_all", "bsa_all", "leaf_correct", "ndtw"):
        assert row["measures"][name]["mean"] is None


def test_a_board_needs_the_export_of_its_record(built: tuple[Path, Any], tmp_path: Path) -> None:
    export = shutil.copytree(built[0].parent / "export", tmp_path / "export")
    index = json.loads((export / "export.json").read_text())
    (export / "export.json").write_text(json.dumps({**index, "snapshot": "0" * 32}))
    with pytest.raises(UsageError, match="changed after the benchmark was built"):
        score_benchmark(export, "val_unseen", [], references=False)


@pytest.mark.parametrize("kind", ["gap", "off the navmesh"])
def test_a_board_refuses_walks_that_no_agent_can_have_made(
    built: tuple[Path, Any], dataset: Path, tmp_path: Path, kind: str
) -> None:
    export = built[0].parent / "export"
    walk_split(export, "val_unseen", "oracle", tmp_path / "mine.json", [dataset], seed=0)
    walks = json.loads((tmp_path / "mine.json").read_text())
    poses = next(iter(walks.values()))
    if kind == "gap":
        poses[1:-1] = []
    else:
        for pose in poses[1:]:
            pose["position"][1] += 0.6
    (tmp_path / "mine.json").write_text(json.dumps(walks))
    with pytest.raises(FormatError, match=r"1 of .*no single action can make.*--forward-step"):
        score_benchmark(export, "val_unseen", [tmp_path / "mine.json"], references=False, roots=[dataset])
    short = dict(list(json.loads((tmp_path / "mine.json").read_text()).items())[1:])
    (tmp_path / "mine.json").write_text(json.dumps(short))
    board = score_benchmark(export, "val_unseen", [tmp_path / "mine.json"], references=False, roots=[dataset])
    assert board.document["rows"][0]["missing"] == 1


def test_a_submission_may_not_be_called_looker(built: tuple[Path, Any], dataset: Path, tmp_path: Path) -> None:
    export = built[0].parent / "export"
    walk_split(export, "val_unseen", "stop-at-start", tmp_path / "looker.json", [dataset], seed=0)
    with pytest.raises(UsageError, match="'looker' is the name of a reference agent"):
        score_benchmark(export, "val_unseen", [tmp_path / "looker.json"], references=False, roots=[dataset])


@pytest.mark.soak
def test_a_board_with_scenes_has_a_row_of_looker(tmp_path: Path) -> None:
    """Its row is the score of its own walks. It takes the right branch more often than guessers do, or luck allows."""
    data = tmp_path / "data"
    make_samples(data, family="replicacad", scenes=4, seed=5)
    build_benchmark(written(tmp_path / "built", data), inline=True)
    export, scenes = tmp_path / "built" / "export", [f"replicacad={data}"]
    report = score_benchmark(export, "val_unseen", [], scenes=scenes)
    rows = {row["agent"]: row for row in report.document["rows"]}
    assert rows.keys() == {*REFERENCES, "looker"}
    assert not any("no row looker" in line for line in report.lines)

    walk_split(export, "val_unseen", "looker", tmp_path / "again.json", [], seed=0, datasets=scenes)
    (again,) = score_benchmark(
        export, "val_unseen", [tmp_path / "again.json"], references=False, roots=[data]
    ).document["rows"]
    assert (rows["looker"]["kind"], rows["looker"]["predictions_sha256"]) == ("reference", None)
    # Without the scenes it is unknown what was recognised.
    assert again["measures"].pop("justified")["n"] == 0 < rows["looker"]["measures"].pop("justified")["n"]
    for key in ("episodes", "missing", "measures"):
        assert rows["looker"][key] == again[key]

    right = {name: row["measures"]["leaf_correct"]["mean"] for name, row in rows.items()}
    assert right["looker"] > max(right[name] for name in REFERENCES if name not in ("oracle", "looking"))
    # How often an agent that draws a leaf at random would be right as often, over all its draws.
    leaves = [task.n_leaves for task in split_tasks(export, "val_unseen")]
    assert len(leaves) == rows["looker"]["episodes"] >= 24
    odds = np.ones(1)
    for count in leaves:
        odds = np.convolve(odds, [1 - 1 / count, 1 / count])
    assert odds[round(right["looker"] * len(leaves)) :].sum() < 1e-4
    assert right["looker"] >= 0.9


def test_a_user_names_the_datasets_that_are_there(dataset: Path, tmp_path: Path) -> None:
    """The others are left out, and what the version says of those that are there holds."""
    exclude = ["train-9*"]
    sources = [
        {"family": "procthor", "root": "nowhere", "exclude": exclude},
        {"family": "replicacad", "root": "nowhere"},
    ]
    path = written(tmp_path / "named", dataset, run={"sources": sources})
    copies = {name: shutil.copytree(dataset, tmp_path / name) for name in ("replicacad", "procthor")}
    for families in (("replicacad",), ("procthor", "replicacad")):
        found = Benchmark.read(path, scenes=[f"{name}={copies[name]}" for name in families])
        assert [(source.family, source.root) for source in found.config.sources] == [
            (name, copies[name]) for name in families
        ]
    assert found.config.sources[0].exclude == tuple(exclude)
    with pytest.raises(UsageError, match="the benchmark has no scenes of hssd") as raised:
        Benchmark.read(path, scenes=[f"hssd={dataset}"])
    assert "procthor, replicacad" in raised.value.remedy
    with pytest.raises(UsageError, match="is not FAMILY=DIR"):
        Benchmark.read(path, scenes=["replicacad"])
    with pytest.raises(ConfigError, match="no such folder"):
        Benchmark.read(path)


def test_of_procthor_10k_the_shipped_run_takes_some_houses_of_each_official_split(
    pytestconfig: pytest.Config,
) -> None:
    benchmark = Benchmark.read(pytestconfig.rootpath / "configs" / "benchmark.yaml", check_roots=False)
    (source,) = [one for one in benchmark.config.sources if one.family == "procthor"]
    choice = SceneChoice(source.scenes, source.exclude)
    taken: Counter[tuple[str, str]] = Counter()
    for file, houses in (("train", 10_000), ("val", 1_000), ("test", 1_000)):
        for name in (f"{file}-{k}" for k in range(houses)):
            if choice.wanted(name):
                taken[file, scene_group("procthor", name, benchmark.config.splits)] += 1
    assert taken == {("train", "train"): 100, ("val", "val_unseen"): 30, ("test", "test"): 30}
    assert sum(taken.values()) == benchmark.file.scenes["procthor"]


@pytest.mark.ray
@pytest.mark.soak
def test_one_and_two_workers_and_a_killed_build_give_one_record(
    built: tuple[Path, Any], dataset: Path, tmp_path: Path
) -> None:
    records = [(built[0].parent / "export" / RECORD).read_bytes()]
    for workers in (1, 2):
        path = written(tmp_path / f"workers-{workers}", dataset, run={"ray": {"workers": workers}})
        assert build_benchmark(path).exit_code == 3
        records.append((path.parent / "export" / RECORD).read_bytes())
    path = written(tmp_path / "killed", dataset)
    command = [
        sys.executable,
        "-c",
        "from jobs.command import main; main()",
        "benchmark",
        "build",
        str(path),
        "--inline",
    ]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as driver:
        deadline = time.monotonic() + 120
        while not [*tmp_path.glob("killed/store/units/scene/*/*/unit.json")] and time.monotonic() < deadline:
            time.sleep(0.005)
        kill_driver(driver)
    assert not (tmp_path / "killed" / "export" / RECORD).exists()
    assert build_benchmark(path, inline=True).exit_code == 3
    records.append((path.parent / "export" / RECORD).read_bytes())
    assert len(set(records)) == 1
