"""``condvln export --compose`` in every form: the files that the episodes of an export name, and the ways in them."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from rich.console import Console

from condvln.export.splits import SPLITS
from condvln.navigation.pathfinder import Pathfinder
from jobs.compose import compose_all
from jobs.generate import run_generate
from schemas.config import Config, SourceConfig
from tests.jobs.test_compose_all import config_of, files, source_of
from tests.strict_loader import AnsrEpisode, Episode, RxRInstruction, load_split

SCENES = 2
QUICK, SLOW = ("replicacad", "procthor", "ai2thor-hab"), ("ithor", "robothor")
DRAWN = {"procthor", "ithor", "robothor"}
"""Forms whose composed scene has the very navmesh of its episodes; the others' parts are rounded as they are placed."""


@dataclass(frozen=True)
class Made:
    """A form's made scenes, their export, and the folder of scene datasets that was composed."""

    form: str
    config: Config
    folder: Path
    document: dict[str, Any]

    @property
    def export(self) -> Path:
        assert self.config.export is not None
        return self.config.export


@pytest.fixture(scope="module", params=[*QUICK, *(pytest.param(form, marks=pytest.mark.soak) for form in SLOW)])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp(request.param)
    config = config_of(folder, source_of(request.param, folder / "data", SCENES))
    assert run_generate(config, inline=True, console=Console(file=io.StringIO())).exit_code == 0
    report = compose_all(config, folder / "scene_datasets")
    assert report.exit_code == 0
    return Made(request.param, config, folder / "scene_datasets", report.document)


def variants(export: Path) -> Iterator[tuple[str, list[Episode]]]:
    """Every episode file of an export, as a strict loader gives it."""
    for split in SPLITS:
        for variant, stem, kind, instruction in (
            ("vlnce", split, Episode, None),
            ("ansr", split, AnsrEpisode, None),
            ("oracle", split, Episode, None),
            ("rxr", f"{split}_guide", Episode, RxRInstruction),
        ):
            path = export / variant / split / f"{stem}.json.gz"
            yield variant, load_split(path, kind, *([] if instruction is None else [instruction]))


def episodes_of(export: Path) -> list[Episode]:
    return [episode for variant, episodes in variants(export) if variant == "vlnce" for episode in episodes]


def named(folder: Path, episode: Episode) -> Path:
    """The scene's file, as a loader whose scenes_dir is ``data/scene_datasets/`` joins it."""
    return folder / episode.scene_id.removeprefix("data/scene_datasets/")


def off(folder: Path, episodes: list[Episode]) -> np.ndarray:
    """(n,) metres between geodesic distances on the composed scenes' navmeshes and those that the episodes tell."""
    differences = []
    for episode in episodes:
        nav = Pathfinder.load(named(folder, episode).with_suffix(".navmesh"))
        assert nav.is_navigable(episode.start_position), episode.episode_id
        goals = [goal.position for goal in episode.goals or []]
        found = nav.geodesic_distances(np.repeat([episode.start_position], len(goals), axis=0), goals).min()
        differences.append(found - episode.info["geodesic_distance"])
    return np.abs(differences)


def test_every_episode_of_every_variant_finds_its_scene(made: Made) -> None:
    scenes: set[Path] = set()
    for _, episodes in variants(made.export):
        scenes |= {named(made.folder, episode) for episode in episodes}
    assert len(scenes) == made.document["written"] == made.document["scenes"] >= 2
    there = {path for path in made.folder.rglob("*") if path.is_file()}
    assert there == scenes | {path.with_suffix(".navmesh") for path in scenes}
    for entry in made.document["composed"]:
        path = made.folder / entry["scene_id"]
        assert path.stat().st_size == entry["bytes"]
        loaded = trimesh.load_scene(path)
        assert sum(len(loaded.geometry[loaded.graph[n][1]].faces) for n in loaded.graph.nodes_geometry) > 100
        assert (entry["left_out"], entry["textures_left_out"], entry["navmesh"]) == (0, 0, "built")


def test_episodes_start_and_lead_there_as_they_were_placed(made: Made) -> None:
    episodes = episodes_of(made.export)
    assert len(episodes) >= 6
    away = off(made.folder, episodes)
    if made.form in DRAWN:
        np.testing.assert_allclose(away, 0, atol=1e-6)
    else:  # as two navmeshes of one apartment differ: see the tests of composed scenes
        assert np.median(away) < 0.05
        assert (away < 0.15).mean() >= 0.9


def test_on_the_navmesh_of_the_episodes_distances_hold_to_the_last_digit(made: Made, tmp_path: Path) -> None:
    report = compose_all(made.config, tmp_path, own_navmesh=True)
    origin = "dataset" if made.form == "replicacad" else "export"
    assert {entry["navmesh"] for entry in report.document["composed"]} == {origin}
    np.testing.assert_allclose(off(tmp_path, episodes_of(made.export)), 0, atol=1e-6)
    for entry in report.document["composed"]:
        assert (tmp_path / entry["scene_id"]).read_bytes() == (made.folder / entry["scene_id"]).read_bytes()


def test_what_is_there_is_left_and_what_is_damaged_is_mended(made: Made, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(made.folder, tmp_path / "scene_datasets"))
    before = files(folder)
    report = compose_all(made.config, folder)
    assert (report.document["written"], report.document["unchanged"]) == (0, made.document["scenes"])
    assert files(folder) == before
    first, *others = [folder / entry["scene_id"] for entry in made.document["composed"]]
    first.write_bytes(first.read_bytes()[:-40])
    others[0].with_suffix(".navmesh").unlink()
    report = compose_all(made.config, folder)
    assert (report.document["written"], report.document["unchanged"]) == (2, made.document["scenes"] - 2)
    assert {name: data for name, (data, _) in files(folder).items()} == {n: data for n, (data, _) in before.items()}


@pytest.mark.soak
def test_real_houses_and_floor_plans_are_where_their_episodes_are(real_data: Path, tmp_path: Path) -> None:
    """Of ReplicaCAD the stages' meshes are not at hand: each of its scenes is told, in a line of its own."""
    chosen = {"replicacad": ("v3_sc0_staging_0[01]",), "procthor": ("houses60-1?",), "ithor": ("*",)}
    sources = [SourceConfig(family=f, root=real_data / f, scenes=names) for f, names in chosen.items()]  # type: ignore[arg-type]
    config = config_of(tmp_path, *sources)
    assert run_generate(config, inline=True, console=Console(file=io.StringIO())).exit_code == 0
    report = compose_all(config, tmp_path / "scenes")
    assert report.exit_code == 3
    failed = [f"replicacad/v3_sc0_staging_{k:02d}" for k in range(2)]
    assert [one["scene"] for one in report.document["failed"]] == failed
    assert [line.split(".")[0] for line in report.lines[1:3]] == [
        f"{scene}: the scene has neither a mesh nor walls to compose" for scene in failed
    ]
    episodes = [e for e in episodes_of(config.export or tmp_path) if "/replicacad/" not in e.scene_id]
    assert {e.scene_id.split("/")[2] for e in episodes} == {"procthor", "ithor"}
    assert len({e.scene_id for e in episodes}) == len(report.document["composed"]) >= 12
    np.testing.assert_allclose(off(tmp_path / "scenes", episodes), 0, atol=1e-6)
    for entry in report.document["composed"]:
        assert trimesh.load_scene(tmp_path / "scenes" / entry["scene_id"]).triangles.shape[0] > 100
