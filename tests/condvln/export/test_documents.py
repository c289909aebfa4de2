"""The card, Croissant, the changelog and the consumers' files: valid, and saying what the report says."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml

from condvln.export.card import dataset_card
from condvln.export.changelog import PublishedEpisodes, changes_between
from condvln.export.contents import CHANGELOG
from condvln.export.report import ExportReport
from condvln.export.snapshot import export_snapshot
from condvln.export.splits import SPLITS, oddness_class, route_class, words_class
from tests.made_snapshot import MemoryTables, made_snapshot
from tests.strict_loader import AnsrEpisode, RxRInstruction, load_split, read

LINK = "data/datasets/condvln"


@pytest.fixture(scope="module")
def index(exported: Path) -> dict[str, Any]:
    return json.loads((exported / "export.json").read_text())


def test_the_card_opens_with_metadata_that_names_the_files(exported: Path, index: dict[str, Any]) -> None:
    text = (exported / "README.md").read_text()
    _, front, body = text.split("---\n", 2)
    fields = yaml.safe_load(front)
    assert fields["license"] == "other"
    assert fields["size_categories"] == ["n<1K"]
    (config,) = fields["configs"]
    for entry in config["data_files"]:
        assert (exported / entry["path"]).stat().st_size > 0
    assert [entry["split"] for entry in config["data_files"]] == list(SPLITS)
    for count in index["episodes"].values():
        assert f" {count:,} |" in body
    assert "ReplicaCAD" in body
    assert "Matterport3D terms" not in body
    for reason in index["left_out"]:
        assert reason in body
    assert index["snapshot"] in body


def test_every_axis_is_counted(exported: Path, index: dict[str, Any]) -> None:
    """Depth, chain, composition, observability and horizon (moves, length, words), each over every episode."""
    body = (exported / "README.md").read_text()
    assert "Observability: O0f: all evidence is in the first view; O0: " in body
    for split, episodes in index["episodes"].items():
        rows = [json.loads(line) for line in (exported / "manifest" / f"{split}.jsonl").read_text().splitlines()]
        shape = index["shapes"][split]
        for axis in ("depth", "chain", "composition", "oddness", "observability", "moves", "route", "words"):
            assert sum(shape[axis].values()) == episodes
            assert all(f"| {axis}: {value} |" in body for value in shape[axis])
        assert shape["depth"] == {str(k): n for k, n in Counter(row["depth"] for row in rows).items()}
        assert shape["oddness"] == Counter(oddness_class(row["oddness"]) for row in rows)
        assert shape["words"] == Counter(words_class(row["words"]) for row in rows)
        assert shape["route"] == Counter(route_class(row["route_length"]) for row in rows)
        at_once = sum(row["observability"] == "O0" and row["evidence_in_view"] for row in rows)
        assert shape["observability"].get("O0f", 0) == at_once


def test_the_card_shows_an_episode_of_each_category(exported: Path) -> None:
    body = (exported / "README.md").read_text()
    rows = [json.loads(line) for path in (exported / "manifest").glob("*.jsonl") for line in path.open()]
    for category in {row["category"] for row in rows}:
        first = min((row for row in rows if row["category"] == category), key=lambda row: row["episode_id"])
        assert f"* {category} (episode {first['episode_id']}): “{first['instruction_text']}”\n" in body


def test_croissant_lists_the_manifests_with_their_hashes(exported: Path, index: dict[str, Any]) -> None:
    document = json.loads((exported / "croissant.json").read_text())
    assert document["conformsTo"] == "http://mlcommons.org/croissant/1.0"
    # every source in it is credited, and named with its terms
    assert "Szot et al." in document["citeAs"]
    assert document["license"].startswith("ReplicaCAD: ")
    assert index["snapshot"] in document["citeAs"]
    files = {entry["@id"]: entry for entry in document["distribution"]}
    assert set(files) == {f"manifest/{split}.jsonl" for split in SPLITS}
    for path, entry in files.items():
        assert entry["sha256"] == index["files"][path]["sha256"]
        assert entry["contentSize"] == f"{index['files'][path]['bytes']} B"
    row = json.loads((exported / "manifest" / "train.jsonl").read_text().splitlines()[0])
    kinds = {"sc:Text": str, "sc:Integer": int, "sc:Float": float}
    for records in document["recordSet"]:
        assert records["key"]["@id"] in {entry["@id"] for entry in records["field"]}
        for entry in records["field"]:
            assert entry["source"]["fileObject"]["@id"] in files
            assert isinstance(row[entry["source"]["extract"]["column"]], kinds[entry["dataType"]])


def test_consumers_files_point_at_files_that_are_there(exported: Path) -> None:
    folder = exported / "configs"
    files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.yaml"))
    assert files == [
        "habitat_lab/condvln.yaml",
        "internnav/condvln.yaml",
        "navid/condvln_experiment.yaml",
        "navid/condvln_task.yaml",
        "navila/condvln_experiment.yaml",
        "navila/condvln_task.yaml",
        "open_nav/condvln_experiment.yaml",
        "open_nav/condvln_task.yaml",
        "streamvln/condvln.yaml",
        "vln_zero/condvln_experiment.yaml",
        "vln_zero/condvln_task.yaml",
        "vlnce/condvln_oracle_task.yaml",
        "vlnce/condvln_rxr_task.yaml",
        "vlnce/condvln_task.yaml",
    ]
    pointed = 0
    for name in files:
        document = yaml.safe_load((folder / name).read_text())
        for key, value in walk(document):
            if isinstance(value, str) and LINK in value:
                root, path = value.split(LINK + "/")
                assert root == ("VLN_CE/" if name.startswith("vln_zero") else "")
                if key[-1] == "GRAPHS_FILE":
                    assert (exported / path).is_file()
                    continue
                for split in SPLITS:
                    assert (exported / path.format(split=split, role="guide")).is_file(), (name, key, value)
                pointed += 1
            if key[-1] in ("SUCCESS_DISTANCE", "success_distance"):
                assert value == (3.0 if {"NDTW", "SDTW"} & set(key) else 1.0), (name, key)
    assert pointed == 7 * 3 + 3 + 4  # tasks name episodes and truth twice; habitat-lab episodes; experiments a task


def walk(value: Any, key: tuple[str, ...] = ()) -> Any:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from walk(inner, (*key, name))
    else:
        yield key, value


TASKS = ["vlnce/condvln_task", "vlnce/condvln_oracle_task", "vlnce/condvln_rxr_task", "open_nav/condvln_task",
         "vln_zero/condvln_task", "navid/condvln_task", "navila/condvln_task"]  # fmt: skip


@pytest.mark.parametrize("name", TASKS)
def test_a_task_file_stands_alone(exported: Path, name: str) -> None:
    document = yaml.safe_load((exported / "configs" / f"{name}.yaml").read_text())
    task = document["TASK"]
    assert task["SUCCESS"] == task["ORACLE_SUCCESS"] == task["SPL"] == {"SUCCESS_DISTANCE": 1.0}
    assert task["SUCCESS_DISTANCE"] == 1.0
    # what is measured is configured, and what the simulator shows is a sensor that is set up
    assert {"SUCCESS", "SPL", "ORACLE_SUCCESS", "NDTW"} <= set(task["MEASUREMENTS"])
    assert set(document["SIMULATOR"]["AGENT_0"]["SENSORS"]) <= set(document["SIMULATOR"])
    assert task["SENSORS"]
    assert "INSTRUCTION_SENSOR" in task["SENSORS"]  # RxR's own reads features of texts from files
    assert task["INSTRUCTION_SENSOR_UUID"] == "instruction"
    ansr = document["DATASET"]["TYPE"] == "ANSR-v1"
    assert ansr == ("BRANCH_SELECTION_ACCURACY" in task["MEASUREMENTS"]) == name.startswith(("open_nav", "vln_zero"))
    if ansr:
        assert task["BRANCH_SELECTION_ACCURACY"] == {"SUCCESS_DISTANCE": 1.0}
    assert document["DATASET"]["SPLIT"] == "val_unseen"
    assert document["ENVIRONMENT"]["MAX_EPISODE_STEPS"] > 0
    # NaVid's evaluator emits int(degrees / 30) turns, and reads the drawn map as VLN-Zero's does
    wide = name.startswith(("navid", "vln_zero")) or "rxr" in name
    assert document["SIMULATOR"]["TURN_ANGLE"] == (30 if wide else 15)
    assert ("TOP_DOWN_MAP_VLNCE" in task["MEASUREMENTS"]) == name.startswith(("navid", "vln_zero"))
    assert document["SIMULATOR"].get("TYPE") == ("Sim-v1" if name.startswith("open_nav") else None)


def test_the_rxr_task_has_the_body_the_cameras_and_the_actions_of_rxr(exported: Path) -> None:
    """As VLN-CE's rxr_vlnce_english_task.yaml."""
    text = (exported / "configs/vlnce/condvln_rxr_task.yaml").read_text()
    document = yaml.safe_load(text)
    simulator = document["SIMULATOR"]
    body = {key: simulator["AGENT_0"][key] for key in ("HEIGHT", "RADIUS")}
    assert body == {"HEIGHT": 0.88, "RADIUS": 0.18}
    assert (simulator["TURN_ANGLE"], simulator["TILT_ANGLE"], simulator["ACTION_SPACE_CONFIG"]) == (30, 30, "v1")
    assert simulator["HABITAT_SIM_V0"]["ALLOW_SLIDING"] is False
    view = {"WIDTH": 640, "HEIGHT": 480, "HFOV": 79, "POSITION": [0, 0.88, 0]}
    assert simulator["RGB_SENSOR"] == view
    assert simulator["DEPTH_SENSOR"] == {**view, "MIN_DEPTH": 0.5, "MAX_DEPTH": 5.0}
    assert document["TASK"]["POSSIBLE_ACTIONS"][-2:] == ["LOOK_UP", "LOOK_DOWN"]
    assert "0.18 m" in text
    assert "BERT" in text


@pytest.mark.parametrize("name", TASKS)
def test_the_measures_of_a_task_find_the_truth_of_each_episode(exported: Path, name: str) -> None:
    """VLN-CE's nDTW opens the truth of both of RxR's roles where its path has a place for a role, and looks ids up."""
    document = yaml.safe_load((exported / "configs" / f"{name}.yaml").read_text())
    split, root = document["DATASET"]["SPLIT"], "VLN_CE/" if name.startswith("vln_zero") else ""
    kinds: dict[str, Any] = {"instruction": RxRInstruction} if "rxr" in name else {}
    if document["DATASET"]["TYPE"] == "ANSR-v1":
        kinds["kind"] = AnsrEpisode
    path = document["DATASET"]["DATA_PATH"].removeprefix(f"{root}{LINK}/").format(split=split, role="guide")
    episodes = load_split(exported / path, **kinds)
    for measure in ("NDTW", "SDTW"):
        truth = document["TASK"][measure]["GT_PATH"].removeprefix(f"{root}{LINK}/")
        roles = ("guide", "follower") if "{role}" in truth else ("",)
        found = set().union(*(read(exported / truth.format(split=split, role=role)) for role in roles))
        assert {episode.episode_id for episode in episodes} <= found


def test_the_file_for_streamvln_is_whole_and_global(exported: Path) -> None:
    """Hydra puts a file without its package line under the name of its folder."""
    assert (exported / "configs/internnav/condvln.yaml").read_text().startswith("# @package _global_\n")
    text = (exported / "configs/streamvln/condvln.yaml").read_text()
    assert text.startswith("# @package _global_\n")
    habitat = yaml.safe_load(text)["habitat"]
    assert habitat["dataset"]["type"] == "R2RVLN-v1"
    assert habitat["simulator"]["turn_angle"] == 15
    camera = habitat["simulator"]["agents"]["main_agent"]["sim_sensors"]["rgb_sensor"]
    assert camera == {"width": 640, "height": 480, "hfov": 79}


def test_experiment_files_name_what_their_agents_need(exported: Path) -> None:
    def of(name: str) -> dict[str, Any]:
        found: dict[str, Any] = yaml.safe_load((exported / "configs" / name / "condvln_experiment.yaml").read_text())
        return found

    assert of("open_nav")["TRAINER_NAME"] == "schedulesampler-OPENNAV"
    assert of("navila")["TRAINER_NAME"] == "navila"
    for name, steps, turns in (("navid", 400, 25), ("vln_zero", 100, 10)):
        evaluation = of(name)["EVAL"]
        assert (evaluation["EARLY_STOP_STEPS"], evaluation["EARLY_STOP_ROTATION"]) == (steps, turns)
        assert evaluation["IDENTIFICATION"] == "condvln"


def test_the_card_has_another_version_for_other_contents(exported: Path, tmp_path: Path) -> None:
    def version(folder: Path) -> str:
        front = yaml.safe_load((folder / "README.md").read_text().split("---")[1])
        return str(front["configs"][0]["version"])

    first = made_snapshot({"replicacad": SCENES})
    versions = []
    for number, tables in enumerate((first, second(first), first)):
        export_snapshot(tables, tmp_path / str(number))
        versions.append(version(tmp_path / str(number)))
    assert versions[0] == versions[2] != versions[1]
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", one) for one in (*versions, version(exported)))


@pytest.mark.soak
def test_the_datasets_library_reads_the_newest_export_of_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    import datasets  # takes seconds, and reads its environment when it is imported

    first = made_snapshot({"replicacad": SCENES})
    for tables in (first, second(first), first):
        export_snapshot(tables, tmp_path / "export")
        found = datasets.load_dataset(str(tmp_path / "export"), cache_dir=str(tmp_path / "cache"))
        for split, rows in found.items():
            written = (tmp_path / "export" / "manifest" / f"{split}.jsonl").read_text().splitlines()
            assert rows["instruction_text"] == [json.loads(line)["instruction_text"] for line in written]


def test_a_split_that_can_not_be_filled_is_named() -> None:
    counts = {"train": 1408, "val_seen": 112, "val_unseen": 1549, "test": 59}
    even = ("simple", "nested", "deep_nested", "chain", "long_chain", "nested_chain")
    shapes = {split: {"category": dict.fromkeys(even, count // 6)} for split, count in counts.items()}
    shapes["test"] = {"category": {"simple": 44, "nested": 15}}
    scenes = {split: [f"s{k}" for k in range(3 if split == "test" else 21)] for split in counts}
    report = ExportReport("s", episodes=counts, scenes=scenes, shapes=shapes)
    assert report.lopsided == {
        "test": "59 episodes where the largest split has 1,549; 3 scenes where another split has 21; "
        "no deep_nested, no chain, no long_chain, no nested_chain; 44 of them simple"
    }
    assert report.document()["lopsided_splits"] == report.lopsided
    assert "* `test`: 59 episodes where" in dataset_card(report)


def test_a_category_that_is_rare_in_one_split_only_is_named() -> None:
    """ReplicaCAD's default splits once had 3 nested episodes of 112 in val_seen, where an even share is 19."""
    even = dict.fromkeys(("simple", "nested", "deep_nested", "chain", "long_chain", "nested_chain"), 240)
    seen = {"simple": 30, "nested": 3, "deep_nested": 28, "chain": 15, "long_chain": 16, "nested_chain": 20}
    shapes = {"train": {"category": even}, "val_seen": {"category": seen}}
    counts = {"train": 1440, "val_seen": 112}
    report = ExportReport("s", episodes=counts, scenes=dict.fromkeys(counts, ["s"] * 21), shapes=shapes)
    assert report.lopsided == {"val_seen": "only 3 of its 112 episodes are nested"}
    rare = {name: 40 if name == "nested" else count for name, count in even.items()}
    shapes["train"] = {"category": rare}
    assert report.lopsided == {}, "it is rare everywhere"


# -- changelog ---------------------------------------------------------------------------------------------------------


def changed(tables: MemoryTables, identity: str, change: Any) -> MemoryTables:
    named = dict(tables.tables["replicacad"])
    for table in ("episodes", "instructions", "scenes"):
        rows = [row for row in named[table].to_pylist() if change(table, row) is not False]
        named[table] = pa.Table.from_pylist(rows, named[table].schema)
    return MemoryTables(identity, {"replicacad": named})


SCENES = ["v3_sc0_staging_00", "v3_sc1_staging_00", "apt_0"]


def second(first: MemoryTables) -> MemoryTables:
    """One scene gone, one reworded, one with other budgets."""

    def change(table: str, row: dict[str, Any]) -> bool | None:
        if row["scene_id"] == "apt_0":
            return False
        if table == "episodes" and row["scene_id"] == "v3_sc1_staging_00":
            row["instruction_text"] += " Please."
        if table == "episodes" and row["scene_id"] == "v3_sc0_staging_00":
            row["max_steps"] -= 1
        return None

    return changed(first, "second", change)


def test_a_second_snapshot_tells_what_moved(tmp_path: Path) -> None:
    first = made_snapshot({"replicacad": SCENES})
    export_snapshot(first, tmp_path)
    assert not (tmp_path / CHANGELOG).exists()
    export_snapshot(second(first), tmp_path)
    text = (tmp_path / CHANGELOG).read_text()
    assert text.startswith("# Changelog\n\n## second\n\nFrom made; 0 episodes are as they were.")
    for reason in ("their scene is gone", "other wording", "other start, goals or routes"):
        assert text.count(reason) == 1
    export_snapshot(second(first), tmp_path)
    assert (tmp_path / CHANGELOG).read_text() == text
    export_snapshot(first, tmp_path)
    again = (tmp_path / CHANGELOG).read_text()
    assert again.endswith(text.removeprefix("# Changelog\n\n"))
    assert "their scene is new" in again
    index = json.loads((tmp_path / "export.json").read_text())
    assert CHANGELOG not in index["files"]


def test_a_fresh_folder_tells_what_moved_since_the_snapshot_before(tmp_path: Path) -> None:
    first = made_snapshot({"replicacad": SCENES})
    export_snapshot(first, tmp_path / "old")
    export_snapshot(second(first), tmp_path / "old")
    export_snapshot(second(first), tmp_path / "new", former=first)
    assert (tmp_path / "new" / CHANGELOG).read_text() == (tmp_path / "old" / CHANGELOG).read_text()
    export_snapshot(first, tmp_path / "same", former=first)
    assert not (tmp_path / "same" / CHANGELOG).exists()


def test_a_former_snapshot_that_says_nothing_is_no_obstacle(tmp_path: Path) -> None:
    first = made_snapshot({"replicacad": SCENES})
    none = changed(first, "none", lambda table, row: table == "scenes")
    export_snapshot(first, tmp_path / "fresh", former=none)
    assert not (tmp_path / "fresh" / CHANGELOG).exists()
    export_snapshot(first, tmp_path / "old")
    export_snapshot(second(first), tmp_path / "old", former=replace(none, id="made"))
    assert "their scene is gone" in (tmp_path / "old" / CHANGELOG).read_text()


def test_generation_and_choice_are_told_apart(tmp_path: Path) -> None:
    first = made_snapshot({"replicacad": SCENES})
    export_snapshot(first, tmp_path)
    chosen = [json.loads(line) for line in (tmp_path / "manifest" / "train.jsonl").read_text().splitlines()]
    over, lost = chosen[0]["episode_id"], chosen[1]["episode_id"]

    def change(table: str, row: dict[str, Any]) -> bool | None:
        if table == "episodes" and row["episode_id"] == over:
            row["ground_truth_steps"] = 251
        return not (table == "episodes" and row["episode_id"] == lost)

    other = changed(first, "other", change)
    export_snapshot(other, tmp_path, former=first)
    text = (tmp_path / CHANGELOG).read_text()
    assert f"1: left out now: over the step budget (such as {over})" in text
    assert f"1: no longer generated (such as {lost})" in text
    assert "chosen otherwise" not in text
    export_snapshot(first, tmp_path, former=other)
    back = (tmp_path / CHANGELOG).read_text().split("## other")[0]
    assert f"1: was left out before: over the step budget (such as {over})" in back
    assert f"1: newly generated (such as {lost})" in back


def told(published: PublishedEpisodes, rows: Any) -> PublishedEpisodes:
    """Some of the episodes."""
    columns = {key: getattr(published, key)[rows] for key in ("ids", "scene", "split", "text", "geometry")}
    return replace(published, snapshot="some", names=published.names[rows], **columns)


def test_every_difference_has_a_reason(exported: Path) -> None:
    whole = PublishedEpisodes.of_export(exported)
    assert len(whole) == sum(json.loads((exported / "export.json").read_text())["episodes"].values())
    same = changes_between(whole, whole)
    assert (same.kept, same.added, same.dropped, same.changed) == (len(whole), {}, {}, {})
    half = told(whole, np.arange(0, len(whole), 2))
    changes = changes_between(whole, half)
    assert changes.kept == len(half)
    assert changes.dropped == {"generated or chosen otherwise in a scene that stayed": len(whole) - len(half)}
    assert changes_between(half, whole).added == changes.dropped
    test = SPLITS.index("test")
    moved = replace(whole, split=np.full(len(whole), test, np.int8), navmeshes=dict.fromkeys(whole.scenes, "other"))
    reasons = changes_between(whole, moved).changed
    assert sum(reasons.values()) == len(whole)
    assert reasons["other start, goals or routes"] == int((whole.split == test).sum())
    assert {reason for reason in reasons if reason.startswith("moved")} == {
        f"moved from {split} to test" for split in SPLITS if split != "test"
    }
    gone = told(whole, np.flatnonzero(whole.scene != 0))
    assert set(changes_between(whole, replace(gone, navmeshes={})).dropped) == {"their scene is gone"}


def test_an_export_that_can_not_be_read_is_no_former_export(tmp_path: Path) -> None:
    assert PublishedEpisodes.of_export(tmp_path) is None
    (tmp_path / "manifest").mkdir()
    for split in SPLITS:
        (tmp_path / "manifest" / f"{split}.jsonl").write_text("{")
    assert PublishedEpisodes.of_export(tmp_path) is None


def test_files_tell_the_command_that_puts_scenes_where_they_look(exported: Path, tmp_path: Path) -> None:
    """Of scans there is none: they are files already."""
    export_snapshot(made_snapshot({"mp3d": ["17DRP5sb8fy"]}, per_category=2), tmp_path)
    told = 0
    for path in sorted((exported / "configs").rglob("*.yaml")):
        text = path.read_text()
        document = yaml.safe_load(text)
        dataset = document.get("DATASET") or document.get("habitat", {}).get("dataset", {})
        scenes = dataset.get("SCENES_DIR") or dataset.get("scenes_dir")
        command = "condvln export CONFIG --compose "
        assert text.count(command) == 1
        assert "ReplicaCAD" in text
        if scenes is not None:  # experiments name a task file, which names the folder
            assert f"`{command}{scenes}`" in text
            assert f"put scene meshes below {scenes}." in text
            told += 1
    assert told == 10
    assert [p for p in sorted((tmp_path / "configs").rglob("*.yaml")) if "compose" in p.read_text()] == []
    assert "`condvln export CONFIG --compose data/scene_datasets`" in (exported / "README.md").read_text()
    assert "compose" not in (tmp_path / "README.md").read_text()
    assert "at the path that `scene_id` names" in (tmp_path / "README.md").read_text()
