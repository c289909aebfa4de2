"""``condvln explore``: the page of a configuration and of an export alone, with agents, without a browser."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from condvln.export.tables import FolderTables
from condvln.manifest import manifest_lines, manifest_paths
from condvln.sources.family import FAMILIES
from jobs.evaluate import walk_split
from jobs.explore import Exploration, explore
from jobs.explore_statistics import former_episodes
from jobs.export import card_pictures
from jobs.generate import run_generate
from jobs.report import Report
from jobs.workspace import published, snapshot_folder
from schemas.config import Config, InstructionsConfig
from schemas.errors import UsageError
from tests.jobs.conftest import configuration
from tests.site_chunks import chunk_content


def chunks(page: Path) -> dict[str, Any]:
    return dict(chunk_content(path.read_bytes()) for path in sorted((page / "data").glob("*.js")))


@pytest.fixture(scope="module")
def asked(
    made_run: tuple[Config, Report], export: Path, split: str, tmp_path_factory: pytest.TempPathFactory
) -> Exploration:
    folder = tmp_path_factory.mktemp("explored")
    config = made_run[0].model_copy(update={"export": export})
    walk_split(export, split, "perfect", folder / "perfect.json", [config.sources[0].root], 0)
    return Exploration(folder / "page", export, config, (folder / "perfect.json",))


def test_a_snapshot_is_shown_whole(asked: Exploration, split: str) -> None:
    assert asked.config is not None
    report = explore(asked)
    found = chunks(asked.out)
    snapshot = published(asked.config)
    assert (
        report.document["episodes"] == snapshot.manifest.tables["episodes"].rows == len(found["index"]["columns"]["id"])
    )
    shown = {one["id"]: one for name, many in found.items() if name.startswith("episodes-") for one in many}
    for row in snapshot.table("episodes").to_pylist():
        one = shown[str(row["episode_id"])]
        assert one["text"] == row["instruction_text"]
        assert one["heading"] == pytest.approx(row["start_heading_degrees"], abs=0.06)
        assert [leaf["route_length"] for leaf in one["leaves"]] == [leaf["route_length"] for leaf in row["leaves"]]
        assert one["clauses"], "the text's own grammar reads it"
    plans = [found[f"scene-{k}"] for k in range(len(found["index"]["scenes"]))]
    assert sum(len(plan["objects"]) for plan in plans) == snapshot.manifest.tables["objects"].rows
    assert sum(len(plan["rooms"]) for plan in plans) == snapshot.manifest.tables["rooms"].rows
    assert all(plan["floor"] for plan in plans)
    edges = [row for row in snapshot.table("relations", columns=["kind"])["kind"].to_pylist() if row != "containment"]
    assert sum(len(found[f"graph-{k}"]["subject"]) for k in range(len(plans))) == len(edges)
    (agent,) = found["index"]["agents"]
    own = {str(line.fields()["episode_id"]) for line in manifest_lines(asked.export / "manifest" / f"{split}.jsonl")}  # type: ignore[operator]
    success = found["index"]["outcomes"].index("success")
    assert {
        name: outcome
        for name, outcome in zip(found["index"]["columns"]["id"], agent["outcome"], strict=True)
        if outcome
    } == dict.fromkeys(own, success)
    walks = {name: walk for key, many in found.items() if key.startswith("walks-") for name, walk in many.items()}
    assert walks.keys() == own
    assert all(walk["perfect"]["distance"][-1] < 1.0 and walk["perfect"]["geodesic"] for walk in walks.values())


def test_a_condition_has_the_numbers_of_the_tables(asked: Exploration) -> None:
    assert asked.config is not None
    explore(dataclasses.replace(asked, predictions=()))
    used = {
        (row["scene_id"], row["subject"], row["target"]): row["used_distance"]
        for row in published(asked.config).table("relations").to_pylist()
        if row["kind"] == "canonical"
    }
    compared = 0
    for name, many in chunks(asked.out).items():
        for one in many if name.startswith("episodes-") else ():
            for condition, facts in zip(one["program"]["conditions"], one["facts"], strict=True):
                named = {thing["id"] for thing in facts["things"] if thing["role"] == "witness"}
                assert named == set(condition["witnesses"])
                if condition["qualifier"] is not None and len(condition["qualifier"]["anchors"]) == 1:
                    anchor = condition["qualifier"]["anchors"][0]["object_id"]
                    for thing in facts["things"]:
                        assert thing["used"] == pytest.approx(used[one["scene"], thing["id"], anchor], abs=6e-4)
                        compared += 1
    assert compared


def test_rejections_have_examples_that_the_scene_holds(asked: Exploration) -> None:
    assert asked.config is not None
    explore(dataclasses.replace(asked, predictions=()))
    found = chunks(asked.out)
    plans = [found[f"scene-{k}"] for k in range(len(found["index"]["scenes"]))]
    held = {plan["id"]: {item["id"] for item in plan["objects"]} for plan in plans}
    counts = Counter[tuple[str, str, str]]()
    for row in published(asked.config).table("rejections").to_pylist():
        counts[row["stage"], row["reason"], row["scene_id"]] += row["count"]
    shown = Counter[str]()
    for one in found["statistics"]["rejections"]:
        assert one["rule"], one["reason"]
        assert one["places"]
        for scene, count in one["places"]:
            assert count == counts[one["stage"], one["reason"], scene]
        for example in one["examples"]:
            shown[one["stage"]] += 1
            assert example["objects"]
            assert set(example["objects"]) <= held[example["scene"]]
            assert all(name in example["example"] for name in example["objects"] if f"({name})" in example["example"])
    assert shown["programs"]
    assert shown["episodes"]


def test_an_export_alone_is_shown_without_furniture(asked: Exploration, export: Path, tmp_path: Path) -> None:
    explore(Exploration(tmp_path / "page", export, roots=asked.roots, before=export))
    found = chunks(tmp_path / "page")
    rows = [line.fields() for path in manifest_paths(export) for line in manifest_lines(path)]
    assert sorted(found["index"]["columns"]["id"]) == sorted(str(row["episode_id"]) for row in rows)
    assert found["scene-0"]["rooms"] == found["scene-0"]["objects"] == []
    drift = found["statistics"]["drift"]
    assert (drift["kept"], drift["gone"], drift["new"], drift["reworded"]) == (len(rows), 0, 0, 0)
    assert (drift["by"], drift["scenes"]) == ("split", [])
    assert sum(now for *_, now in drift["cells"]) == sum(was for *_, was, _ in drift["cells"]) == len(rows)


def test_two_snapshots_are_compared(made_run: tuple[Config, Report], made_dataset: Path, tmp_path: Path) -> None:
    first = configuration(tmp_path, made_dataset)
    shutil.copytree(made_run[0].store, first.store)
    before = published(first)
    second = first.model_copy(update={"instructions": InstructionsConfig(per_category={"simple": 3, "nested": 2})})
    run_generate(second, inline=True)
    now = published(second)
    assert now.snapshot_id != before.snapshot_id
    old, new = ({row["episode_id"]: row for row in one.table("episodes").to_pylist()} for one in (before, now))
    shared = old.keys() & new.keys()
    explore(Exploration(tmp_path / "page", None, second, before=before.snapshot_id[:12]))
    drift = chunks(tmp_path / "page")["statistics"]["drift"]
    assert drift["before"] == before.snapshot_id
    counted = (len(shared), len(old.keys() - shared), len(new.keys() - shared))
    assert (drift["kept"], drift["gone"], drift["new"]) == counted
    assert counted[2] > 0
    assert drift["reworded"] == sum(old[one]["instruction_text"] != new[one]["instruction_text"] for one in shared)
    for shown, keys in (("cells", ("source", "category")), ("scenes", ("source", "scene_id"))):
        was, are = (Counter(tuple(row[key] for key in keys) for row in rows.values()) for rows in (old, new))
        rows = [[*key, was[key], are[key]] for key in sorted({*was, *are})]
        assert drift[shown] == [row for row in rows if shown == "cells" or row[2] != row[3]]
    assert former_episodes(before.snapshot_id, second).episodes.keys() == {str(name) for name in old}
    assert former_episodes(second.name, second).episodes.keys() == {str(name) for name in new}, "a ref names the latest"


def test_the_card_shows_a_plan_of_each_source(export: Path) -> None:
    record = json.loads((export / "export.json").read_text())
    (picture,) = (export / "pictures").iterdir()
    assert picture.name == "replicacad.png"
    data = picture.read_bytes()
    assert len(data) < 500_000
    assert data.startswith(b"\x89PNG")
    assert hashlib.sha256(data).hexdigest() == record["files"]["pictures/replicacad.png"]["sha256"]
    card = (export / "README.md").read_text()
    assert "(pictures/replicacad.png)" in card
    assert record["pictures"]["pictures/replicacad.png"] in card


def test_licensed_scenes_have_no_picture(monkeypatch: pytest.MonkeyPatch, asked: Exploration, export: Path) -> None:
    licensed = dataclasses.replace(FAMILIES["replicacad"], licensed=True)
    monkeypatch.setitem(FAMILIES, "replicacad", licensed)
    snapshot = published(asked.config)
    tables = FolderTables(snapshot_folder(asked.config.store, snapshot))
    assert [*card_pictures(tables, lambda *_: None, export)] == []
    monkeypatch.undo()
    assert [one.path for one in card_pictures(tables, lambda *_: None, export)] == ["pictures/replicacad.png"]


def test_faults_leave_no_page(asked: Exploration, export: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    other.write_text(json.dumps({"999": [{"position": [0, 0, 0], "heading": 0, "stop": True}]}))
    for wrong, said in (
        (Exploration(tmp_path / "page", tmp_path), "neither a configuration nor an export"),
        (Exploration(tmp_path / "page", export, predictions=(other,)), "no episode of the export"),
        (Exploration(tmp_path / "page", export, before=tmp_path), "names no export and no snapshot"),
        (Exploration(tmp_path / "page", export, asked.config, before="ffff"), "names no export and no snapshot"),
        (Exploration(tmp_path / "page", export, views=1), "holds no scenes"),
    ):
        with pytest.raises(UsageError, match=said):
            explore(wrong)
        assert not (tmp_path / "page").exists()
