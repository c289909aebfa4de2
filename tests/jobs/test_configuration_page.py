"""Every key of the configuration is documented, makes stale exactly the stages that its page says, and changes some
output.

A key that is new fails here until it has an entry in CHANGED.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from condvln.relations import relate_room, text_facts
from condvln.samples import make_samples
from condvln.scene import RoomArrays
from condvln.sources.source import hash_file
from jobs.generate import run_generate
from jobs.pipeline import build_pipeline, list_units
from schemas.canonical import canonical_json
from schemas.config import Config
from schemas.errors import CondVLNError
from tests.condvln.relations.layered_rooms import layered_room
from tests.site_parts import part

PAGE = part("configuration")
STAGES = ("scene", "counts", "relations", "visibility", "episodes", "text", "priors")

CHANGED: dict[str, Any] = yaml.safe_load(Path(__file__).with_name("changed_keys.yaml").read_text(encoding="utf-8"))
"""Another value of each key."""

ELSEWHERE = {
    "sources": "its entries' keys",
    "sources.N.family": "tests/jobs/test_families.py",
    "sources.N.root": "tests/jobs/test_rebuild.py",
    "sources.N.regions": "tests/jobs/test_zones.py",
    "sources.N.houses": "tests/condvln/sources/test_procthor_habitat.py",
    "sources.N.connectivity": "tests/jobs/test_viewpoints.py",
}
"""Keys that need another dataset to change, and where that is tested."""

QUOTING = {"origin.json", "export.json"}
"""Files of an export that repeat the configuration, or hashes of those that do."""

WORDING = {"text.preamble", "instructions.language", "instructions.voices", "instructions.length"}
"""Keys that the stage episodes reads only where a cell bounds the number of words."""

BEARINGS = {
    "thresholds.bearing_true",
    "thresholds.bearing_false",
    "thresholds.bearing_distance",
    "sampling.predicates.bearing",
    "sampling.bearings",
}
"""Keys that change nothing unless directions are egocentric."""

RARE = {
    "thresholds.height_false",
    "thresholds.other_way",
    "thresholds.on_gap_true",
    "thresholds.on_footprint_true",
    "thresholds.under_footprint_true",
    "thresholds.in_share_true",
    "thresholds.between_off_true",
    "thresholds.size_ratio",
    "thresholds.size_side",
    "thresholds.held_footprint",
    "thresholds.held_inside",
}
"""Keys that decide about too few pairs of things in made scenes: they are tried in rooms full of such pairs."""

UNUSED = {
    *("sampling.predicates.under", "sampling.predicates.inside", "sampling.predicates.height"),
    "instructions.style",
}
"""Weights of predicates that these made scenes have no use for: nothing lies in an open container or under a table, and
what hangs or stands on top is named by something nearer. ``test_sampling.py`` tries them alone. And the style: it gives
values to keys without one, of which this configuration has none. ``test_configuration.py`` tries it."""

EXEMPT = {"store", "export", "ray", "keep"}
"""Where things lie and how work is spread: they change no row and no file."""


def entry(path: str) -> str:
    return re.sub(r"\.\d+(?=\.|$)", ".N", path)


def said(path: str) -> set[str]:
    """The stages that docs/configuration.md names for a key."""
    (row,) = [
        line for line in PAGE.FILE.read_text(encoding="utf-8").splitlines() if line.startswith(f"| `{entry(path)}` |")
    ]
    return set(re.findall(r"`(\w+)`", row.rpartition(" | ")[2])) & set(STAGES)


def test_the_page_is_up_to_date() -> None:
    assert PAGE.FILE.read_text(encoding="utf-8") == PAGE.configuration_page(), "run: python docs/site/configuration.py"


def test_every_key_is_described_and_tried() -> None:
    found = list(PAGE.keys())
    assert [key.path for key in found if not key.about] == []
    wanted = {key.path for key in found if key.path.partition(".")[0] not in EXEMPT}
    assert {entry(path) for path in CHANGED} | set(ELSEWHERE) == wanted


def changed(document: dict[str, Any], path: str) -> dict[str, Any]:
    """The document with another value of a key."""
    document = Config.model_validate(document).model_dump(mode="json")
    *sections, last = path.split(".")
    at: Any = document
    for key in sections:
        at = at[int(key) if key.isdigit() else key]
    assert at[last] != CHANGED[path]
    at[last] = CHANGED[path]
    return document


@pytest.fixture(scope="session")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], dict[str, Any]]:
    """A configuration over made apartments, houses and a single room, its store and export below a folder."""
    data = tmp_path_factory.mktemp("families")
    families = {"replicacad": 2, "procthor": 2, "ithor": 1}
    for family, scenes in families.items():
        make_samples(data / family, family=family, scenes=scenes, seed=3)
    shutil.copytree(data / "replicacad" / "navmeshes_default", data / "replicacad" / "mine")

    def document(folder: str) -> dict[str, Any]:
        return {
            "name": "made",
            "store": f"{folder}/store",
            "export": f"{folder}/export",
            "sources": [{"family": family, "root": str(data / family)} for family in families],
            "instructions": {
                "per_category": {"simple": 3, "chain": 3, "nested": 2, "long_chain": 1},
                "cells": [{"category": "chain", "count": 2}],
                "counterfactual_groups": 1,
            },
            "sampling": {"predicates": {"far": 0.2}, "usual_places": False},  # else few statements are left
            "episodes": {"max_steps": "proportional"},
        }

    return document


@pytest.mark.parametrize("path", CHANGED)
def test_a_key_makes_stale_what_its_page_says(stock, path: str) -> None:
    def read(document: dict[str, Any]) -> dict[str, bytes]:
        config = Config.model_validate(document)
        pipeline = build_pipeline(config)
        units = list_units(config, hash_file)
        found = {stage.name: b"".join(canonical_json(stage.parameters(u)) for u in units) for stage in pipeline.stages}
        return found | {a.name: canonical_json(a.parameters()) for a in pipeline.aggregates}

    if path in ("sources.0.scenes", "sources.0.exclude"):
        assert said(path) == set(), "other scenes, and no other stage of one"
        return
    document = stock("nowhere")
    if path in WORDING:
        alone, changed_alone = read(document), read(changed(document, path))
        assert {name for name in alone if alone[name] != changed_alone[name]} - {"episodes"} == {"text"}
        document["instructions"]["cells"][0]["words"] = [1, 200]
    before, after = read(document), read(changed(document, path))
    assert {name for name in before if before[name] != after[name]} == said(path)


@pytest.mark.parametrize("path", sorted(RARE))
def test_a_rare_key_changes_what_is_true(stock, path: str) -> None:
    def decided(document: dict[str, Any]) -> list[Any]:
        thresholds = Config.model_validate(document).thresholds
        found: list[Any] = []
        for seed in range(6):
            objects = layered_room(np.random.default_rng(seed), count=20)
            facts = text_facts(relate_room(RoomArrays.of("room", objects, 0.0), thresholds), thresholds)
            alike = np.array([[a.label == b.label and a is not b for b in objects] for a in objects])
            pairs = np.array(list(combinations(range(len(objects)), 2)))
            found += [
                facts.status[p].tolist() for p in ("on", "under", "in", "near", "above", "higher than", "lower than")
            ]
            found += [facts.between(pairs)[0].tolist(), facts.sizes(alike)["bigger"].tolist()]
        return found

    document = stock("nowhere")
    assert decided(document) != decided(changed(document, path))


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """To make everything takes eight seconds: a fifth of the keys is tried, and others with another seed of --draws."""
    if metafunc.function is test_a_key_changes_what_is_made:
        draws = metafunc.config.option.draws
        keys = [path for path in CHANGED if path not in RARE | UNUSED]
        metafunc.parametrize("path", keys[int(draws) % 5 if draws.isdecimal() else 0 :: 5])


@pytest.mark.soak
def test_a_key_changes_what_is_made(stock, request: pytest.FixtureRequest, tmp_path: Path, path: str) -> None:
    folder, before = request.getfixturevalue("egocentric_run" if path in BEARINGS else "stock_run")
    for name in ("units", "pins", "aggregates"):  # what is not stale need not be made again
        shutil.copytree(folder / "store" / name, tmp_path / "store" / name)
    try:
        document = egocentric(stock(str(tmp_path))) if path in BEARINGS else stock(str(tmp_path))
        made = outputs(changed(document, path), tmp_path)
    except CondVLNError:
        return  # refused
    assert made != before


@pytest.mark.soak
def test_how_work_is_spread_changes_nothing(stock, stock_run, tmp_path: Path) -> None:
    document = stock(str(tmp_path)) | {"ray": {"max_failures": 0.4}, "keep": {"snapshots": 5}}
    assert outputs(document, tmp_path) == stock_run[1]


@pytest.fixture(scope="session")
def stock_run(stock, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """A folder with what the configuration makes as it is, and a digest of it."""
    folder = tmp_path_factory.mktemp("stock")
    return folder, outputs(stock(str(folder)), folder)


def egocentric(document: dict[str, Any]) -> dict[str, Any]:
    """The document with things said to lie left and right."""
    return document | {"instructions": document["instructions"] | {"directions": "egocentric"}}


@pytest.fixture(scope="session")
def egocentric_run(stock, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """The same as `stock_run`, with things said to lie left and right."""
    folder = tmp_path_factory.mktemp("egocentric")
    return folder, outputs(egocentric(stock(str(folder))), folder)


def outputs(document: dict[str, Any], folder: Path) -> dict[str, str]:
    """The published ref and snapshot, and SHA-256 of every file of the export that does not quote the configuration."""
    run_generate(Config.model_validate(document), inline=True)
    found = {path.relative_to(folder).as_posix(): "" for path in (folder / "store").glob("refs/*.json")}
    found |= {path.relative_to(folder).as_posix(): "" for path in (folder / "store").glob("snapshots/*/manifest.json")}
    files = sorted(path for path in (folder / "export").rglob("*") if path.is_file() and path.name not in QUOTING)
    return found | {path.relative_to(folder).as_posix(): hash_file(path)[1] for path in files}
