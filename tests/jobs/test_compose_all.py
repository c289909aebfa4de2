"""``condvln compose --all``: the files that the episodes of an export name, and what is told of those that are not."""

from __future__ import annotations

import gzip
import io
import json
import shutil
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from rich.console import Console
from typer.testing import CliRunner

from condvln.export.splits import SPLITS
from condvln.navigation.pathfinder import Pathfinder
from condvln.samples import make_layouts, make_samples, write_replicacad
from jobs import compose_all as module
from jobs.command import app
from jobs.compose_all import compose_all
from jobs.generate import run_generate
from schemas.config import Config, InstructionsConfig, SourceConfig
from schemas.errors import FormatError, PathEscapeError, UsageError
from tests.strict_loader import AnsrEpisode, Episode, RxRInstruction, load_split

SCENES, SEED = 2, 3
FORMS = ("replicacad", "procthor", "ithor", "robothor", "ai2thor-hab")
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


def source_of(form: str, folder: Path, scenes: int = SCENES) -> SourceConfig:
    if form == "replicacad":
        report = write_replicacad(folder, make_layouts(scenes, SEED), navmesh="recast")
    else:
        report = make_samples(folder, form, scenes, SEED)
    return SourceConfig(family=report.family, **report.parts)  # type: ignore[arg-type]


def config_of(folder: Path, *sources: SourceConfig) -> Config:
    return Config(
        name="made",
        store=folder / "store",
        export=folder / "export",
        sources=sources,
        instructions=InstructionsConfig(per_category={"simple": 4, "nested": 4}, counterfactual_groups=0),
    )


QUICK = ("replicacad", "procthor", "ai2thor-hab")


@pytest.fixture(scope="module", params=[f if f in QUICK else pytest.param(f, marks=pytest.mark.soak) for f in FORMS])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp(request.param)
    config = config_of(folder, source_of(request.param, folder / "data"))
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
        assert episode.info is not None
        found = nav.geodesic_distances(np.repeat([episode.start_position], len(goals), axis=0), goals).min()
        differences.append(found - episode.info["geodesic_distance"])
    return np.abs(differences)


def files(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Every file by path, with its time of change: what is not written keeps it."""
    return {p.relative_to(folder).as_posix(): (p.read_bytes(), p.stat().st_mtime_ns) for p in folder.rglob("*.*")}


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


# --- one form for what is the same in all


@pytest.fixture(scope="module")
def houses(tmp_path_factory: pytest.TempPathFactory) -> Config:
    """Three houses, of which an export tells; read only."""
    folder = tmp_path_factory.mktemp("houses")
    config = config_of(folder, source_of("procthor", folder / "data", 3))
    told(config, "procthor/houses-0", "procthor/houses-1", "procthor/houses-2")
    return config


def told(config: Config, *scenes: str, **changes: Any) -> None:
    """An export's record, by itself: all that is read of it."""
    assert config.export is not None
    config.export.mkdir(exist_ok=True)
    record = {"snapshot": "made", "scenes": {"train": [*scenes]}, "files": {}, **changes}
    (config.export / "export.json").write_text(json.dumps(record))


def elsewhere(config: Config, folder: Path) -> Config:
    """The same with an export of the test's own."""
    return config.model_copy(update={"export": folder / "export"})


def test_a_scene_that_can_not_be_composed_is_told_and_the_others_are_written(houses: Config, tmp_path: Path) -> None:
    root = Path(shutil.copytree(houses.sources[0].root, tmp_path / "data"))
    lines = gzip.decompress((root / "houses.jsonl.gz").read_bytes()).splitlines()
    broken = json.loads(lines[1])
    broken["rooms"][0]["floorPolygon"] = "round"
    (root / "houses.jsonl.gz").write_bytes(gzip.compress(b"\n".join([lines[0], json.dumps(broken).encode(), lines[2]])))
    source = houses.sources[0].model_copy(update={"root": root})
    config = elsewhere(houses.model_copy(update={"sources": (source,)}), tmp_path)
    told(config, "procthor/houses-0", "procthor/houses-1", "procthor/houses-2", "procthor/houses-9")
    report = compose_all(config, tmp_path / "scenes")
    assert report.exit_code == 3
    assert [one["scene"] for one in report.document["failed"]] == ["procthor/houses-1", "procthor/houses-9"]
    assert "floorPolygon" in report.document["failed"][0]["message"]
    assert report.document["failed"][1]["message"].startswith("no source has this scene. ")
    about = [line for line in report.lines if line.startswith("procthor/")]
    assert [line.split(":")[0] for line in about] == ["procthor/houses-1", "procthor/houses-9"]
    assert sorted(p.name for p in (tmp_path / "scenes").rglob("*.glb")) == ["houses-0.glb", "houses-2.glb"]


def test_what_others_put_there_is_left(houses: Config, tmp_path: Path) -> None:
    theirs = tmp_path / "procthor/houses-1/houses-1.glb"
    theirs.parent.mkdir(parents=True)
    theirs.write_bytes(trimesh.creation.box().export(file_type="glb"))
    (tmp_path / "procthor/houses-2/houses-2.glb").mkdir(parents=True)
    before = theirs.read_bytes()
    report = compose_all(houses, tmp_path)
    assert report.exit_code == 3
    assert [one["scene"] for one in report.document["failed"]] == ["procthor/houses-1", "procthor/houses-2"]
    assert all("did not write" in one["message"] for one in report.document["failed"])
    assert theirs.read_bytes() == before
    assert not theirs.with_suffix(".navmesh").exists()


def test_nothing_is_written_into_an_export(houses: Config, tmp_path: Path) -> None:
    config = elsewhere(houses, tmp_path)
    told(config, "procthor/houses-0")
    assert config.export is not None
    (tmp_path / "link").symlink_to(config.export)
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes/procthor").symlink_to(config.export)
    before = files(tmp_path)
    for folder in (config.export, config.export / "a/b", tmp_path / "link", tmp_path / "link/c", tmp_path / "scenes"):
        with pytest.raises(UsageError, match="lies in the export"):
            compose_all(config, folder)
    assert files(tmp_path) == before
    config_file = tmp_path / "run.yaml"
    config_file.write_text(config.model_dump_json())
    inside = str(config.export / "a.glb")
    result = CliRunner().invoke(app, ["compose", str(config_file), "houses-0", inside])
    assert isinstance(result.exception, UsageError)
    assert not Path(inside).exists()


@pytest.mark.parametrize(
    ("scenes", "error"),
    [
        (["procthor/../../../outside"], PathEscapeError),
        ([5], None),
        ([["procthor/houses-0"]], None),
        ("procthor", None),
    ],
)
def test_a_hostile_record_leads_nowhere(houses: Config, tmp_path: Path, scenes: Any, error: Any) -> None:
    config = elsewhere(houses, tmp_path)
    told(config, scenes={"train": scenes})
    if error is not None:
        with pytest.raises(error, match="climbs out"):
            compose_all(config, tmp_path / "scenes")
    else:
        assert compose_all(config, tmp_path / "scenes").document["composed"] == []
    assert not (tmp_path / "scenes").exists()


@pytest.mark.parametrize("text", ["", "[]", '{"scenes": 5, "files": {}}', '{"scenes": {"train": 5}, "files": {}}', "{"])
def test_a_damaged_record_is_one_error(houses: Config, tmp_path: Path, text: str) -> None:
    config = elsewhere(houses, tmp_path)
    told(config)
    (tmp_path / "export/export.json").write_text(text)
    with pytest.raises(FormatError, match=r"export\.json: no record of an export .*Export again"):
        compose_all(config, tmp_path / "scenes")


def test_a_navmesh_that_the_export_lost_is_its_scenes_fault(houses: Config, tmp_path: Path) -> None:
    config = elsewhere(houses, tmp_path)
    kept = {"navmeshes/procthor/houses-0.navmesh": {"bytes": 3, "sha256": "0" * 64}}
    told(config, "procthor/houses-0", "procthor/houses-1", files=kept)
    report = compose_all(config, tmp_path / "scenes", own_navmesh=True)
    assert [one["scene"] for one in report.document["failed"]] == ["procthor/houses-0"]
    assert "missing or changed" in report.document["failed"][0]["message"]
    assert [entry["navmesh"] for entry in report.document["composed"]] == ["built"]


def test_without_an_export_the_sources_tell_and_scans_stay_as_they_are(houses: Config, tmp_path: Path) -> None:
    scan = source_of("mp3d", tmp_path / "scans", 1)
    config = elsewhere(houses, tmp_path).model_copy(update={"sources": (scan, *houses.sources)})
    theirs = tmp_path / "scenes/mp3d/made_000/made_000.glb"
    theirs.parent.mkdir(parents=True)
    theirs.write_bytes((tmp_path / "scans/made_000/made_000.glb").read_bytes())
    report = compose_all(config, tmp_path / "scenes")
    assert report.exit_code == 0
    assert report.document["single_files"] == ["mp3d"]
    assert any("one file each" in line and "mp3d/<scene>/<scene>.glb" in line for line in report.lines)
    assert [entry["scene"] for entry in report.document["composed"]] == [f"procthor/houses-{k}" for k in range(3)]
    assert theirs.read_bytes() == (tmp_path / "scans/made_000/made_000.glb").read_bytes()
    assert [p.name for p in (tmp_path / "scenes/mp3d").rglob("*") if p.is_file()] == ["made_000.glb"]


def test_one_scene_is_in_memory(houses: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where scenes fail: an error that was kept would keep its scene."""
    alive: list[weakref.ref[Any]] = []
    real, refuse = module.compose_scene, module.write_changed

    def watched(scene: Any, geometry: Any, agent: Any) -> Any:
        assert [one for one in alive if one() is not None] == []
        composed = real(scene, geometry, agent)
        alive.extend((weakref.ref(geometry), weakref.ref(composed)))
        return composed

    def failing(path: Path, data: bytes) -> bool:
        if path.name == "houses-1.glb":
            raise FormatError("made to fail", where=path)
        return refuse(path, data)

    monkeypatch.setattr(module, "compose_scene", watched)
    monkeypatch.setattr(module, "write_changed", failing)
    report = compose_all(houses, tmp_path)
    assert len(alive) == 6
    assert [one["scene"] for one in report.document["failed"]] == ["procthor/houses-1"]


def test_the_command_takes_one_scene_or_all(houses: Config, tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text(houses.model_dump_json())
    runner = CliRunner()
    folder = str(tmp_path / "scenes")
    result = runner.invoke(app, ["compose", str(config), "--all", folder, "--json"])
    assert result.exit_code == 0
    said = json.loads(result.stdout)
    assert (said["scenes"], said["written"], said["exit_code"]) == (3, 3, 0)
    shown = runner.invoke(app, ["compose", str(config), "--all", folder])
    assert "0 written, 3 as they were" in " ".join(shown.stdout.split())  # lines are folded
    for words in ([], ["houses-0"], ["houses-0", "a.glb", "--all", folder], ["houses-0", "--all", folder]):
        wrong = runner.invoke(app, ["compose", str(config), *words])
        assert isinstance(wrong.exception, UsageError)
        assert "either one scene is composed, or all are" in str(wrong.exception)


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
