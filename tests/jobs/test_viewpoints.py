"""Scans without a mesh: instructions on the viewpoint graph, checked against the graph and the annotation alone."""

from __future__ import annotations

import json
import shutil
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from condvln.evaluation.split import SplitOptions, evaluate_split
from condvln.export.tables import FolderTables
from condvln.export.viewpoints import FOLDER, GraphEpisodes, write_viewpoints
from condvln.navigation.graph_pathfinder import GraphFolder, read_connectivity
from condvln.sources.registry import open_source
from jobs.workspace import published, snapshot_folder
from schemas.base import SCHEMA_VERSION
from schemas.config import Config, SplitsConfig
from schemas.errors import MissingFileError
from schemas.evaluation import ManifestEpisode
from tests.made_snapshot import MemoryTables


@pytest.fixture(scope="module")
def config(scans_alone: Config) -> Config:
    return scans_alone


@pytest.fixture(scope="module")
def data(config: Config) -> Path:
    return config.sources[0].root


@pytest.fixture(scope="module")
def tables(config: Config) -> FolderTables:
    return FolderTables(snapshot_folder(config.store, published(config)))


@pytest.fixture(scope="module")
def graphs(data: Path) -> GraphFolder:
    return GraphFolder(data / "connectivity")


def test_every_rule_holds_of_what_is_placed(tables: FolderTables, graphs: GraphFolder, data: Path) -> None:
    found = GraphEpisodes(tables, graphs, SplitsConfig())
    episodes = list(found)
    assert len(episodes) >= 20
    assert len(episodes) + sum(found.left_out.values()) == _whole(tables, "instructions").num_rows
    source = open_source("mp3d", data)
    scenes = {name: source.read(name) for name in graphs}
    for episode in episodes:
        row, graph = episode.row, read_connectivity(data / "connectivity" / f"{episode.item['scan']}_connectivity.json")
        place = dict(zip(graph.ids, graph.positions.astype(float), strict=True))
        joined = {
            frozenset((graph.ids[a], graph.ids[b])): w for (a, b), w in zip(graph.edges, graph.lengths, strict=True)
        }
        path = episode.item["path"]
        assert all(frozenset(pair) in joined for pair in pairwise(path))
        assert episode.item["distance"] == pytest.approx(sum(joined[frozenset(pair)] for pair in pairwise(path)))
        assert episode.item["distance"] == pytest.approx(row["route_length"])
        assert 0 <= episode.item["heading"] < 2 * np.pi
        assert np.degrees(episode.item["heading"]) == pytest.approx(row["start_heading_degrees"])
        np.testing.assert_allclose(place[path[0]], row["start_position"], atol=1e-3)
        ends = []
        for leaf in row["leaves"]:
            item = scenes[row["scene_id"]].object_of[leaf["object_id"]]
            (goal,) = leaf["goals"]
            away = np.maximum(np.maximum(item.aabb[0] - goal, np.array(goal) - item.aabb[1]), 0)[[0, 2]]
            assert np.hypot(*away) <= 3.0
            ends.append(min(place, key=lambda name: float(np.linalg.norm(place[name] - goal))))
        for one, other in combinations(ends, 2):
            assert one != other
            assert np.linalg.norm(place[one] - place[other]) > 0
        gold = ends[row["gold_leaf"]]
        assert path[-1] == gold
        assert not {*ends} - {gold} & {*path}
        ManifestEpisode.model_validate(
            {**_names(row), "depth": episode.instruction["depth"], "chain": episode.instruction["chain"]}
            | {"program": {k: episode.instruction[k] for k in ("category", "conditions", "branches", "leaves")}}
        )


@pytest.mark.parametrize("lost", ["scenes", "instructions", "objects"])
def test_a_lost_partition_is_no_empty_one(tables: FolderTables, graphs: GraphFolder, tmp_path: Path, lost: str) -> None:
    copy = tmp_path / tables.folder.name
    shutil.copytree(tables.folder, copy)
    shutil.rmtree(copy / lost)
    with pytest.raises(MissingFileError, match=lost):
        list(GraphEpisodes(FolderTables(copy), graphs, SplitsConfig()))
    for name in ("scenes", "rooms", "objects", "instructions"):  # nothing of the family was published at all
        shutil.rmtree(copy / name, ignore_errors=True)
    with pytest.raises(MissingFileError):
        list(GraphEpisodes(FolderTables(copy), graphs, SplitsConfig()))
    shutil.rmtree(copy / "episodes")
    assert list(GraphEpisodes(FolderTables(copy), graphs, SplitsConfig())) == []


def _whole(tables: FolderTables, name: str) -> pa.Table:
    return pa.Table.from_batches(tables.batches(name, "mp3d"))


def _names(row: dict) -> dict:
    fields = ManifestEpisode.model_fields
    return {key: value for key, value in row.items() if key in fields} | {
        "schema_version": SCHEMA_VERSION,
        "source": "mp3d",
        "split": "test",
        "navmesh": "g",
        "snapshot": "s",
    }


def test_it_repeats_and_a_scan_more_changes_nothing(tables: FolderTables, graphs: GraphFolder) -> None:
    whole = [e.item for e in GraphEpisodes(tables, graphs, SplitsConfig())]
    assert whole == [e.item for e in GraphEpisodes(tables, graphs, SplitsConfig())]
    first = sorted(graphs)[0]
    names = ("scenes", "rooms", "objects", "instructions")
    alone = {name: (t := _whole(tables, name)).filter(pc.equal(t["scene_id"], first)) for name in names}
    few = [e.item for e in GraphEpisodes(MemoryTables("one", {"mp3d": alone}), graphs, SplitsConfig())]
    assert few == [item for item in whole if item["scan"] == first]


def test_the_folder_is_evaluated_like_an_export(
    tables: FolderTables, graphs: GraphFolder, data: Path, tmp_path: Path
) -> None:
    found = GraphEpisodes(tables, graphs, SplitsConfig(fractions=(0.0, 0.0, 1.0)))
    report = write_viewpoints(tmp_path, found, "snap", found.left_out)
    assert set(report.episodes) == {"test"}
    assert report.left_out == dict(sorted(found.left_out.items()))
    items = json.loads((tmp_path / FOLDER / "R2R_test.json").read_bytes())
    assert len(items) == report.episodes["test"]
    perfect = [
        {"instr_id": f"{item['path_id']}_0", "trajectory": [[v, 0.0, 0.0] for v in item["path"]]} for item in items
    ]
    (tmp_path / "perfect.json").write_text(json.dumps(perfect))
    stay = [{"instr_id": f"{item['path_id']}_0", "trajectory": [[item["path"][0], 0.0, 0.0]]} for item in items]
    (tmp_path / "stay.json").write_text(json.dumps(stay))
    options = SplitOptions(connectivity=(data / "connectivity",))
    (good, bad), tasks = evaluate_split(
        tmp_path / FOLDER, "test", [tmp_path / "perfect.json", tmp_path / "stay.json"], options
    )
    assert len(tasks) == len(items)
    assert good.scores["success"].all()
    assert not bad.scores["success"].any()


def test_a_run_writes_them_though_nothing_stands_on_a_navmesh(config: Config) -> None:
    assert config.export is not None
    items = json.loads((config.export / FOLDER / "R2R_test.json").read_bytes())
    assert len(items) >= 20
    assert not (config.export / "vlnce").exists()
