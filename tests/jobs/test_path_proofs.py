"""``condvln verify`` of paths over viewpoints: all are proven, their mutants are caught, lost ones are noticed."""

from __future__ import annotations

import copy
import json
import math
import shutil
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
from pydantic import ValidationError

from condvln.navigation.graph_pathfinder import read_connectivity
from condvln.sources.registry import open_source
from condvln.verify.certificate import Certificate, VerifierRules
from condvln.verify.viewpoint_paths import ProvenScan, ViewpointMap
from jobs.export import run_export
from jobs.verify import verify_export
from schemas.config import Config
from schemas.evaluation import ManifestEpisode
from tests.jobs.conftest import made_scans
from tests.once import made_once

Document = dict[str, Any]
LEAST = 0.99


@pytest.fixture(scope="module")
def alone(scans_alone: Config) -> Config:
    return scans_alone


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Config:
    return made_once(tmp_path_factory, "scans with meshes", partial(made_scans, meshes=True))


@pytest.fixture
def folder(alone: Config, tmp_path: Path) -> Path:
    assert alone.export is not None
    return Path(shutil.copytree(alone.export, tmp_path / "export"))


# -- whole exports -----------------------------------------------------------------------------------------------------


def test_all_paths_over_viewpoints_are_proven(alone: Config, folder: Path) -> None:
    report = verify_export(alone, folder)
    assert report.exit_code == 0, report.lines
    items = json.loads((folder / "viewpoints/R2R_test.json").read_bytes())
    assert report.document["paths"] == {"paths": len(items), "proven": len(items)}
    assert len(items) >= 20
    certificates = [json.loads(line) for line in (folder / "certificates/paths.jsonl").read_text().splitlines()]
    assert {one["episode_id"] for one in certificates} == {item["path_id"] for item in items}
    assert all({"seeable", "goal_side", "observability"} <= set(one["unproven"]) for one in certificates)


def test_all_paths_of_r2r_are_proven_beside_the_episodes(both: Config) -> None:
    assert both.export is not None
    report = verify_export(both, both.export)
    assert report.exit_code == 0, report.lines
    items = json.loads((both.export / "r2r/R2R_test.json").read_bytes())
    assert items
    assert report.document["paths"] == {"paths": len(items), "proven": len(items)}
    assert report.document["episodes"] == report.document["proven"] > 0


# -- mutants -----------------------------------------------------------------------------------------------------------

Mutator = Callable[[Document, Document, np.random.Generator, ViewpointMap], bool]
"""Puts one fault into a manifest row and its R2R item; False where it does not apply."""

OF_ITEMS: dict[str, Mutator] = {}
OF_ROWS: dict[str, Mutator] = {}


def of_item(function: Mutator) -> Mutator:
    OF_ITEMS[function.__name__] = function
    return function


def of_row(function: Mutator) -> Mutator:
    OF_ROWS[function.__name__] = function
    return function


@of_item
def skip_a_viewpoint(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    """A step that is no edge, or a shorter way than the stops need."""
    if len(item["path"]) < 3:
        return False
    del item["path"][int(rng.integers(1, len(item["path"]) - 1))]
    return True


@of_item
def shorten(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    """The last viewpoint is lost, and the distance follows."""
    if len(item["path"]) < 3:
        return False
    del item["path"][-1]
    item["distance"] = scan.length(item["path"])
    return True


@of_item
def begin_later(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    if len(item["path"]) < 3:
        return False
    del item["path"][0]
    item["distance"] = scan.length(item["path"])
    return True


@of_item
def walk_on(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    """A step beyond the goal, along an edge."""
    item["path"].append(sorted(scan.ways[item["path"][-1]])[0])
    item["distance"] = scan.length(item["path"])
    return True


@of_item
def go_back_and_forth(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["path"] = [*item["path"][:2], *item["path"]]
    item["distance"] = scan.length(item["path"])
    return True


@of_item
def turn_round(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["path"] = item["path"][::-1]
    return True


@of_item
def wrong_distance(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["distance"] += float(rng.choice([-0.5, 0.01, 2.0]))
    return True


@of_item
def no_distance(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["distance"] = None
    return True


@of_item
def wrong_heading(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["heading"] = (item["heading"] + float(rng.uniform(0.01, 6.0))) % (2 * math.pi)
    return True


@of_item
def heading_in_degrees(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["heading"] = math.degrees(item["heading"])
    return item["heading"] != 0


@of_item
def other_panorama(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    """One viewpoint of the path is another one."""
    k = int(rng.integers(len(item["path"])))
    item["path"][k] = str(rng.choice([name for name in scan.graph.ids if name != item["path"][k]]))
    return True


@of_item
def unknown_panorama(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["path"][int(rng.integers(len(item["path"])))] = "0" * 32
    return True


@of_item
def wrong_scan(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["scan"] = item["scan"][::-1]
    return True


@of_item
def changed_id(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["path_id"] += 1
    return True


@of_item
def other_text(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["instructions"][0] = item["instructions"][0].replace("the ", "a ", 1)
    return True


@of_item
def no_text(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    item["instructions"] = []
    return True


@of_row
def goal_elsewhere(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    """A leaf's goal is at a viewpoint that is too far from its object; the way there is right."""
    leaf = row["leaves"][int(rng.integers(len(row["leaves"])))]
    return _end_at(row, item, leaf, rng, scan)


def _end_at(row: Document, item: Document, leaf: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    names = [scan.at(point) for point in leaf["reference_path"]]
    away = [name for name in scan.graph.ids if scan.between(str(names[-1]), name) > 3.0]
    if not away or leaf["subgoals"]:
        return False
    end = str(rng.choice(away))
    if not math.isfinite(scan.between(str(names[0]), end)):
        return False
    way = nx.dijkstra_path(scan.ways, names[0], end, weight="length")
    order = {name: k for k, name in enumerate(scan.graph.ids)}
    leaf["reference_path"] = [scan.places[order[name]].tolist() for name in way]
    leaf["goals"] = [leaf["reference_path"][-1]]
    leaf["geodesic_distance"] = leaf["route_length"] = scan.length(way)
    if leaf is row["leaves"][row["gold_leaf"]]:
        row["geodesic_distance"] = row["route_length"] = scan.length(way)
        item["path"], item["distance"] = way, scan.length(way)
    return True


@of_row
def skip_a_stop(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    for leaf in row["leaves"]:
        if leaf["subgoals"]:
            del leaf["subgoals"][0]
            return True
    return False


@of_row
def exchange_leaves(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    row["leaves"] = row["leaves"][::-1]
    return len({leaf["object_id"] for leaf in row["leaves"]}) > 1


@of_row
def other_gold(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    row["gold_leaf"] = (row["gold_leaf"] + 1) % len(row["leaves"])
    return True


@of_row
def flip_a_truth(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    condition = row["program"]["conditions"][int(rng.integers(len(row["program"]["conditions"])))]
    condition["truth"] = not condition["truth"]
    return True


@of_row
def start_off_the_graph(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    row["start_position"][0] += 0.1
    return True


@of_row
def longer_lengths(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    leaf = row["leaves"][int(rng.integers(len(row["leaves"])))]
    leaf["route_length"] += 0.5
    leaf["geodesic_distance"] += 0.5
    return True


@of_row
def cut_a_reference_path(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    leaf = row["leaves"][int(rng.integers(len(row["leaves"])))]
    if len(leaf["reference_path"]) < 3:
        return False
    del leaf["reference_path"][int(rng.integers(1, len(leaf["reference_path"]) - 1))]
    return True


@of_row
def other_budget(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    row["max_steps"] += 1
    return True


@of_row
def other_graph(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    row["navmesh_sha256"] = "0" * 64
    return True


@of_row
def wider_success(row: Document, item: Document, rng: np.random.Generator, scan: ViewpointMap) -> bool:
    row["success_distance"] = 6.0
    return True


@pytest.mark.parametrize("is_alone", [True, False])
@pytest.mark.parametrize("most", [12, pytest.param(1000, marks=pytest.mark.soak)])
def test_mutants_of_paths_are_caught(alone: Config, request: pytest.FixtureRequest, is_alone: bool, most: int) -> None:
    """At most `most` rows, each with one mutant of each kind: `base` has the manifest and `r2r` the items."""
    config = alone if is_alone else request.getfixturevalue("both")
    base, r2r = (config.export / name for name in (("viewpoints", "viewpoints") if is_alone else ("", "r2r")))
    root = Path(config.sources[0].root)
    source, rules, rng = open_source("mp3d", root), VerifierRules.of(config), np.random.default_rng(most)
    items = {str(item["path_id"]): item for item in json.loads((r2r / "R2R_test.json").read_bytes())}
    lines = (base / "manifest/test.jsonl").read_text().splitlines()
    rows = [row for line in lines if str((row := json.loads(line))["episode_id"]) in items][:most]
    kinds = OF_ITEMS | OF_ROWS if is_alone else OF_ITEMS
    scans: dict[str, tuple[ViewpointMap, ProvenScan]] = {}
    tried: Counter[str] = Counter()
    survivors = []
    for row in rows:
        scan = row["scene_id"]
        if scan not in scans:
            house = source.house(scan)
            places = {p.name: (float(p.position[0]), -float(p.position[1])) for p in house.panoramas}
            name = f"connectivity/{scan}_connectivity.json"
            viewpoints = ViewpointMap(read_connectivity(root / name), name, places or None)
            scans[scan] = viewpoints, ProvenScan(source.read(scan), viewpoints, rules)
        viewpoints, prover = scans[scan]
        sound = Certificate(row["episode_id"], "mp3d", scan, "test", kind="path")
        prover.check(ManifestEpisode.model_validate(row), items[str(row["episode_id"])], sound, alone=is_alone)
        assert sound.proven, sound.disagreements
        for kind, mutate in kinds.items():
            changed, item = copy.deepcopy(row), copy.deepcopy(items[str(row["episode_id"])])
            if not mutate(changed, item, rng, viewpoints):
                continue
            if (changed, item) == (row, items[str(row["episode_id"])]):
                continue
            tried[kind] += 1
            certificate = Certificate(row["episode_id"], "mp3d", scan, "test", kind="path")
            try:
                mutant = ManifestEpisode.model_validate(changed)
            except ValidationError:
                continue
            if len(mutant.leaves) != len(mutant.program.leaves):
                continue  # refused where the manifest is read
            prover.check(mutant, item, certificate, alone=is_alone)
            if certificate.proven:
                survivors.append((kind, row["episode_id"]))
    print(f"\n{tried.total()} mutants of {len(tried)} kinds, {len(survivors)} not caught: {Counter(survivors)}")
    assert set(tried) == set(kinds), "every kind of fault was tried"
    assert tried.total() - len(survivors) >= LEAST * tried.total()
    assert not survivors


# -- what is lost ------------------------------------------------------------------------------------------------------


def faults(config: Config, folder: Path, *, without_store: bool = False) -> str:
    report = verify_export(config, folder, without_store=without_store)
    assert report.exit_code == 3
    return " ".join(fault["what"] for fault in report.document["faults"])


@pytest.mark.parametrize("without_store", [False, True])
def test_a_path_that_is_lost_from_both_files_is_noticed(alone: Config, folder: Path, without_store: bool) -> None:
    manifest, file = folder / "viewpoints/manifest/test.jsonl", folder / "viewpoints/R2R_test.json"
    lines, items = manifest.read_text().splitlines(), json.loads(file.read_bytes())
    gone = json.loads(lines.pop())["episode_id"]
    manifest.write_text("".join(f"{line}\n" for line in lines))
    file.write_text(json.dumps([item for item in items if item["path_id"] != gone]))
    assert f"holds {len(lines)} paths, export.json says {len(items)}" in faults(
        alone, folder, without_store=without_store
    )


def test_a_record_or_a_folder_that_is_lost_is_noticed(alone: Config, folder: Path) -> None:
    index = folder / "viewpoints/export.json"
    index.write_text(index.read_text().replace('"test"', '"train"'))
    assert all("digest differs" in faults(alone, folder, without_store=without) for without in (False, True))
    index.unlink()
    assert all("is missing or truncated" in faults(alone, folder, without_store=without) for without in (False, True))
    shutil.rmtree(folder / "viewpoints")
    assert "is missing or truncated" in faults(alone, folder)


def test_certificates_of_paths_alone_are_kept_where_the_files_stay_the_same(alone: Config, folder: Path) -> None:
    config = alone.model_copy(update={"export": folder})
    assert verify_export(config, folder).exit_code == 0
    run_export(config)
    assert (folder / "certificates/paths.jsonl").is_file()
    index = folder / "certificates/summary.json"
    index.write_text(index.read_text().replace('"viewpoints/R2R_test.json": "', '"viewpoints/R2R_test.json": "0'))
    run_export(config)
    assert not (folder / "certificates/paths.jsonl").exists()
