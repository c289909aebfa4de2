"""RxR guides, discrete R2R, shards: each as its own readers want it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from condvln.episodes.identity import numeric_id
from condvln.evaluation.discrete import evaluate_graph, read_graph_episodes
from condvln.evaluation.predictions import GraphPrediction
from condvln.export.snapshot import export_snapshot
from condvln.export.splits import SPLITS
from condvln.export.viewpoints import r2r_episode
from condvln.navigation.graph_pathfinder import GraphPathfinder, read_connectivity
from schemas.config import SplitsConfig
from tests.condvln.export.conftest import linear_text
from tests.condvln.viewpoint_graphs import graph_of
from tests.made_snapshot import MemoryTables, made_snapshot
from tests.strict_loader import AnsrEpisode, RxRInstruction, load_split, read


@pytest.mark.parametrize("split", SPLITS)
def test_rxr_guides_load_in_a_strict_loader(exported: Path, split: str) -> None:
    path = exported / "rxr" / split / f"{split}_guide.json.gz"
    assert list(read(path)) == ["episodes"]
    guides = load_split(path, instruction=RxRInstruction)
    stock = load_split(exported / "vlnce" / split / f"{split}.json.gz")
    assert [g.episode_id for g in guides] == [s.episode_id for s in stock]
    for guide, one in zip(guides, stock, strict=True):
        assert guide.instruction.instruction_text == one.instruction.instruction_text
        assert guide.instruction.language == "en-US"
        assert int(guide.instruction.instruction_id) == int(one.episode_id) < 2**53
        assert (guide.goals, guide.reference_path) == (one.goals, one.reference_path)
    assert {guide.episode_id for guide in guides} == set(read(exported / "rxr" / split / f"{split}_guide_gt.json.gz"))
    truths = (exported / "rxr" / split / f"{split}_guide_gt.json.gz").read_bytes()
    assert truths == (exported / "vlnce" / split / f"{split}_gt.json.gz").read_bytes()


def test_numbers_of_a_million_ids_do_not_collide() -> None:
    assert len({numeric_id(f"{n:016x}") for n in range(100_000)}) == 100_000


# -- shards ------------------------------------------------------------------------------------------------------------


def test_shards_hold_the_episodes_scene_by_scene(exported: Path, tables: MemoryTables, tmp_path: Path) -> None:
    report = export_snapshot(tables, tmp_path, SplitsConfig(sharded=True), oracle_text=linear_text)
    for variant, kind in (("vlnce", None), ("ansr", AnsrEpisode), ("oracle", None)):
        for split in SPLITS:
            whole = read(exported / variant / split / f"{split}.json.gz")
            folder = tmp_path / variant / split
            head = read(folder / f"{split}.json.gz")
            assert head == {"episodes": [], "instruction_vocab": whole["instruction_vocab"]}
            shards = sorted((folder / "content").glob("*.json.gz"))
            assert [p.name for p in shards] == [f"{s.split('/')[1]}.json.gz" for s in report.scenes[split]]
            episodes = [episode for path in shards for episode in read(path)["episodes"]]
            assert episodes == whole["episodes"]
            for path in shards:
                assert {e.scene_id.split("/")[-2] for e in load_split(path, *([kind] if kind else []))} == {
                    path.name.removesuffix(".json.gz")
                }
    assert (tmp_path / "manifest" / "train.jsonl").read_bytes() == (exported / "manifest" / "train.jsonl").read_bytes()


def test_two_sources_with_one_scene_name_get_two_shards(tmp_path: Path) -> None:
    made = made_snapshot({"procthor": ["house_1"]})
    renamed = made.tables["procthor"].copy()
    episodes = renamed["episodes"].to_pylist()
    for episode in episodes:
        episode["episode_hash"] += "b"
        episode["episode_id"] = numeric_id(episode["episode_hash"])
        episode["instruction_text"] += " b"
    renamed["episodes"] = pa.Table.from_pylist(episodes, renamed["episodes"].schema)
    both = MemoryTables("both", {"procthor": made.tables["procthor"], "ithor": renamed})
    report = export_snapshot(both, tmp_path, SplitsConfig(sharded=True))
    written = [path for path in report.files if path.startswith("vlnce/") and "/content/" in path]
    assert len(written) == sum(len(scenes) for scenes in report.scenes.values())
    assert sum(len(read(tmp_path / path)["episodes"]) for path in written) == sum(report.episodes.values())


# -- discrete R2R ------------------------------------------------------------------------------------------------------


def ring() -> GraphPathfinder:
    """Eight viewpoints on a circle of 4 m radius, joined to their neighbours."""
    angles = np.arange(8) * np.pi / 4
    places = np.stack([4 * np.sin(angles), np.zeros(8), -4 * np.cos(angles)], axis=1)
    return graph_of(places, [(i, (i + 1) % 8) for i in range(8)])


def at(index: int) -> list[float]:
    return [round(4 * math.sin(index * math.pi / 4), 3), 0.1, round(-4 * math.cos(index * math.pi / 4), 3)]


def row(start: int, gold: list[int], *others: int, heading: float = 90.0) -> dict[str, Any]:
    leaves = [
        {"leaf": 0, "goals": [at(gold[-1])], "subgoals": [{"object_id": "o", "position": at(i)} for i in gold[:-1]]}
    ]
    leaves += [{"leaf": 1 + n, "goals": [at(i)], "subgoals": []} for n, i in enumerate(others)]
    return {
        "episode_id": "e",
        "scene_id": "scan",
        "start_position": at(start),
        "start_heading_degrees": heading,
        "instruction_text": "Go.",
        "gold_leaf": 0,
        "leaves": leaves,
    }


def test_r2r_path_runs_through_the_subgoals_along_edges() -> None:
    graph = ring()
    found = r2r_episode(row(0, [7, 2], 4), graph)
    assert isinstance(found, dict)
    assert list(found) == ["distance", "scan", "path_id", "path", "heading", "instructions"]
    assert found["path"] == ["0", "7", "0", "1", "2"]
    edge = 8 * math.sin(math.pi / 8)
    assert found["distance"] == pytest.approx(4 * edge, abs=1e-5)
    assert found["heading"] == pytest.approx(math.pi / 2)  # clockwise from +y of the scan: 90° is east
    assert r2r_episode(row(0, [1], 4, heading=360.0), graph)["heading"] == 0  # type: ignore[index]


@pytest.mark.parametrize(
    ("case", "reason"),
    [
        (row(0, [1], 1), "two leaves at one viewpoint"),
        (row(0, [0], 4), "a leaf at the start's viewpoint"),
        (row(0, [4], 0), "a leaf at the start's viewpoint"),
        ({**row(0, [4], 2), "start_position": [90.0, 0.0, 0.0]}, "no viewpoint in reach"),
    ],
)
def test_what_means_nothing_on_the_graph_is_told(case: dict[str, Any], reason: str) -> None:
    assert reason in str(r2r_episode(case, ring()))
    islands = graph_of([[0, 0, 0], [4, 0, 0], [20, 0, 0], [24, 0, 0]], [(0, 1), (2, 3)])
    lost = row(0, [1], 2)
    lost["start_position"] = [0, 0, 0]
    lost["leaves"][0]["goals"], lost["leaves"][1]["goals"] = [[24, 0, 0]], [[4, 0, 0]]
    assert r2r_episode(lost, islands) == "its viewpoints are not connected"


@pytest.mark.parametrize(
    ("start", "leaves", "reason"),
    [
        (0, (2, 3), "two leaves within 3 m on the graph"),
        (0, (1, 4), "a leaf within 3 m of the start on the graph"),
        (0, (2, 4), None),
        (2, (0, 4), None),
    ],
)
def test_leaves_that_r2r_would_not_tell_apart_are_left_out(
    start: int, leaves: tuple[int, int], reason: str | None
) -> None:
    # 2 m from each viewpoint to the next: two steps are 4 m, one is inside of R2R's 3 m
    line = graph_of([[2.0 * i, 0, 0] for i in range(5)], [(i, i + 1) for i in range(4)])
    case = row(0, [1], 2)
    case["start_position"] = [2.0 * start, 0, 0]
    for leaf, place in zip(case["leaves"], leaves, strict=True):
        leaf["goals"] = [[2.0 * place, 0, 0]]
    found = r2r_episode(case, line)
    assert found == reason if reason else isinstance(found, dict)


@pytest.fixture(scope="module")
def scan(real_data: Path) -> tuple[str, Path]:
    name = "YmJkqBEsHnH"
    return name, real_data / "mp3d" / "connectivity" / f"{name}_connectivity.json"


def test_r2r_export_on_a_real_graph(scan: tuple[str, Path], tmp_path: Path) -> None:
    name, path = scan
    graph = GraphPathfinder.load(path)
    rng = np.random.default_rng(0)
    made = made_snapshot({"mp3d": [name]}, per_category=100)
    episodes = made.tables["mp3d"]["episodes"].to_pylist()

    def place() -> dict[str, float]:
        near = graph.graph.positions[rng.integers(len(graph.graph.ids))] + rng.normal(0, 0.1, 3)
        return dict(zip("xyz", (round(float(v), 3) for v in near), strict=True))

    for episode in episodes:
        episode["start_position"] = place()
        for leaf in episode["leaves"]:
            leaf["goals"] = [place()]
            for subgoal in leaf["subgoals"]:
                subgoal["position"] = place()
    changed = pa.Table.from_pylist(episodes, made.tables["mp3d"]["episodes"].schema)
    tables = MemoryTables("r2r", {"mp3d": {**made.tables["mp3d"], "episodes": changed}})
    report = export_snapshot(tables, tmp_path, graphs={name: graph})
    assert report.r2r_episodes > 20
    assert {path for path in report.files if path.startswith("r2r/")} == {f"r2r/R2R_{split}.json" for split in SPLITS}
    assert "| `r2r/` |" in (tmp_path / "README.md").read_text()
    assert report.r2r_episodes + sum(report.r2r_left_out.values()) == sum(report.episodes.values())
    known = read_connectivity(path)
    edges = {frozenset((known.ids[a], known.ids[b])) for a, b in known.edges}
    length = {frozenset((known.ids[a], known.ids[b])): w for (a, b), w in zip(known.edges, known.lengths, strict=True)}
    headings = {e["episode_id"]: e["start_heading_degrees"] for e in episodes}
    count = 0
    for split in SPLITS:
        file = tmp_path / "r2r" / f"R2R_{split}.json"
        for item in json.loads(file.read_text()):
            steps = [frozenset(pair) for pair in zip(item["path"], item["path"][1:], strict=False)]
            assert set(steps) <= edges
            assert item["distance"] == pytest.approx(sum(length[step] for step in steps))
            assert math.degrees(item["heading"]) == pytest.approx(headings[item["path_id"]])
            assert len(set(item["instructions"])) == 1
            count += 1
        items = read_graph_episodes(file)
        # Matterport3DSimulator's eval.py asks for three instructions of each path, and agents walk those of the file.
        paths = [item["path_id"] for item in json.loads(file.read_text())]
        asked = [f"{path:d}_{number}" for path in paths for number in range(3)]
        assert [item.instruction_id for item in items] == asked
        perfect = [GraphPrediction(item.instruction_id, item.path) for item in items]
        for score in evaluate_graph(items, perfect, {name: GraphPathfinder(known)}).values():
            assert (score.success, score.ndtw) == (1, 1)
    assert count == report.r2r_episodes


def test_scans_without_a_graph_are_counted(tmp_path: Path) -> None:
    former = tmp_path / "r2r" / "R2R_train.json"
    former.parent.mkdir()
    former.write_text("[]")
    (tmp_path / "export.json").write_text('{"files": {"r2r/R2R_train.json": {}}, "snapshot": ""}')
    report = export_snapshot(made_snapshot({"mp3d": ["17DRP5sb8fy"]}), tmp_path, graphs={"other": ring()})
    assert report.r2r_left_out == {"no connectivity graph of its scan": sum(report.episodes.values())}
    # No path in any split: no files, not even a former export's, and none is named.
    assert not list(tmp_path.rglob("R2R_*"))
    assert not [path for path in report.files if path.startswith("r2r/")]
    told = [path for suffix in ("md", "json", "yaml") for path in tmp_path.rglob(f"*.{suffix}")]
    assert len(told) > 10
    assert not [path for path in told if b"r2r/" in path.read_bytes()]
