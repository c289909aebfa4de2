"""The configuration file: overrides in their order, faults named by key, folders resolved from the file's own."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from jobs.configuration import load_config
from schemas.config import Config
from schemas.errors import ConfigError

MINIMAL = {"name": "toy", "store": "store", "sources": [{"family": "replicacad", "root": "data"}]}


def cell(other: dict[str, object] | None = None, **bounds: object) -> dict[str, object]:
    """A configuration's part that asks for a simple cell of these bounds, and for another."""
    cells = [{"category": "simple", "count": 1, **b} for b in (bounds, other) if b is not None]
    return {"instructions": {"cells": cells}}


@pytest.fixture
def written(tmp_path: Path):
    (tmp_path / "data").mkdir()

    def write(**changes: object) -> Path:
        path = tmp_path / "run.yaml"
        path.write_text(yaml.safe_dump({**MINIMAL, **changes}))
        return path

    return write


def test_folders_count_from_the_file(written, tmp_path: Path) -> None:
    config = load_config(written(export="out"), environment={})
    assert (config.store, config.export) == (tmp_path / "store", tmp_path / "out")
    assert config.sources[0].root == tmp_path / "data"


def test_set_wins_over_environment_wins_over_file(written) -> None:
    path = written(seed=1, ray={"workers": 1})
    environment = {"CONDVLN_SEED": "2", "CONDVLN_RAY__WORKERS": "3", "CONDVLN_REAL_DATA": "/elsewhere"}
    assert load_config(path, environment={}).seed == 1
    assert load_config(path, environment=environment).seed == 2
    config = load_config(path, ["seed=4"], environment)
    assert (config.seed, config.ray.workers) == (4, 3)


def test_set_reaches_into_lists(written, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    assert load_config(written(), ["sources.0.root=other"], {}).sources[0].root == tmp_path / "other"


@pytest.mark.parametrize(
    ("changes", "overrides", "named", "remedy"),
    [
        ({"colour": 1}, [], "colour: unknown key", "Allowed here: name, seed, store"),
        ({"ray": {"cores": 2}}, [], "ray.cores: unknown key", "Allowed here: workers, address"),
        ({"sources": [{"family": "x", "root": "data"}]}, [], "sources.0.family", ""),
        ({"seed": "many"}, [], "seed", ""),
        ({"sources": []}, [], "sources", ""),
        ({"instructions": {"moves": [0.5, 0.5, 0.5]}}, [], "sum to 1", ""),
        ({"thresholds": {"near_true": 2.0}}, [], "near", ""),
        ({"agent": {"radius": float("nan")}}, [], "agent.radius", ""),
        ({}, ["seed"], "not of the form", ""),
        ({}, ["sources.7.root=x"], "not one of the 1 entries", ""),
        ({"sources": [{"family": "replicacad", "root": "nowhere"}]}, [], "no such folder", "sources.0.root=FOLDER"),
        ({"ray": {"workers": True}}, [], "ray.workers: Value error, true and false are no values", ""),
        ({"agent": {"max_slope": 120}}, [], "agent.max_slope", ""),
        ({"name": "x" * 101}, [], "name", ""),
        ({"sources": [{"family": "replicacad", "root": "data", "scenes": []}]}, [], "sources.0.scenes", ""),
        ({"sources": [{"family": "replicacad", "root": "data", "houses": "x"}]}, [], "houses is a key of procthor", ""),
        ({"sources": [{"family": "gibson", "root": "data", "connectivity": "x"}]}, [], "a key of mp3d", ""),
        ({"instructions": {"per_category": {"simple": -5}}}, [], "instructions.per_category.simple", ""),
        ({"instructions": {"per_category": {"simple": 10**12}}}, [], "instructions.per_category.simple", ""),
        ({"instructions": {"cells": [{"category": "simple", "count": 0}]}}, [], "instructions.cells.0.count", ""),
        (cell(route=[15, 5]), [], "instructions.cells.0: Value error, route: [15, 5] is no range", "[least, most]"),
        (cell(route=[-1, 5]), [], "route: [-1, 5] is no range of metres", ""),
        (cell(route=[5, 5]), [], "route: [5, 5] is no range of metres", ""),
        (cell(route=[5, float("inf")]), [], "instructions.cells.0.route.1", ""),
        (cell(route=[True, 5]), [], "instructions.cells.0.route: Value error, true and false are no bounds", ""),
        (cell(route=[0.1, 0.9]), [], "instructions.cells.0.route: none is as short as 0.9 m", ""),
        (cell(route=5), [], "instructions.cells.0.route", ""),
        (cell(words=[60, 20]), [], "words: [60, 20] is no range of numbers of words", ""),
        (cell(words=[0, 20]), [], "words: [0, 20] is no range of numbers of words", ""),
        (cell(words=[20.5, 30]), [], "instructions.cells.0.words.0", ""),
        (cell(words=[20]), [], "instructions.cells.0.words", ""),
        (cell(words=[20, 30], other={"words": [20, 30]}), [], "cells: simple (20, 30) stands there twice", ""),
        ({"instructions": {"counterfactual_groups": 10**12}}, [], "instructions.counterfactual_groups", ""),
        ({"instructions": {"candidates_per_episode": 10**12}}, [], "instructions.candidates_per_episode", ""),
        ({"episodes": {"starts": 10**12}}, [], "episodes.starts", ""),
        ({"episodes": {"path_spacing": 1e-12}}, [], "episodes.path_spacing", ""),
        ({"episodes": {"distance": [30, 2]}}, [], "[30, 2] is no range", ""),
        ({"episodes": {"distance_single_room": [-1, 2]}}, [], "[-1, 2] is no range", ""),
        ({"splits": {"fractions": [0.9, 0.9, 0.9]}}, [], "fractions: the three shares must sum to 1", ""),
        ({"store": "data"}, [], "store", "a folder of its own"),
        ({"store": "data/../data/store"}, [], "sources.0.root", "a folder of its own"),
        ({"export": "data/export"}, [], "export", "a folder of its own"),
        ({"export": "store/export"}, [], "is in store", "a folder of its own"),
    ],
)
def test_faults_name_the_key_and_what_is_allowed(written, changes, overrides, named, remedy) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(written(**changes), overrides, {})
    assert named in str(caught.value)
    assert remedy in str(caught.value)


def test_bounds_of_cells_are_taken_as_written(written) -> None:
    config = load_config(written(**cell(route=[5, 12.5], words=[30, 30], other={"route": [5, 12]})), [], {})
    first, second = config.instructions.cells
    assert (first.route, first.words) == ((5.0, 12.5), (30, 30))
    assert (second.route, second.words) == ((5.0, 12.0), None)


@pytest.mark.parametrize("text", ["", "- 1", "a: [", "name: x\nname: y", "\x00"])
def test_what_is_no_mapping_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_config(path, environment={})
    assert "run.yaml" in str(caught.value)


def test_shipped_configurations_are_valid(repository: Path) -> None:
    paths = sorted((repository / "configs").glob("*.yaml"))
    assert paths
    for path in paths:
        assert isinstance(load_config(path, environment={}, check_roots=False), Config)


def test_a_value_that_is_endless_when_written_out_is_told_by_its_beginning(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(
        "a0: &a0 [x]\n" + "".join(f"a{k + 1}: &a{k + 1} [{f'*a{k}, ' * 9}]\n" for k in range(30)) + "seed: *a30"
    )
    with pytest.raises(ConfigError, match="seed") as caught:
        load_config(path, environment={})
    assert len(str(caught.value)) < 10_000
