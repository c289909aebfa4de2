"""``condvln export --compose``: the files it writes, and what it says when it can't."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from condvln.formats.glb import read_glb
from condvln.navigation.pathfinder import Pathfinder
from condvln.samples import make_samples
from jobs.command import app
from jobs.compose import compose
from schemas.config import AgentConfig, Config, SourceConfig
from schemas.errors import InputError, UsageError

Datasets = dict[str, Path]


@pytest.fixture(scope="module")
def datasets(tmp_path_factory: pytest.TempPathFactory) -> Datasets:
    root = tmp_path_factory.mktemp("datasets")
    for family in ("replicacad", "procthor", "gibson", "mp3d"):
        make_samples(root / family, family, 1, 8)
    return {folder.name: folder for folder in root.iterdir()}


def configured(folder: Path, datasets: Datasets, *families: str) -> Config:
    sources = tuple(SourceConfig(family=f, root=datasets[f]) for f in families)  # type: ignore[arg-type]
    return Config(name="made", store=folder / "store", sources=sources)


@pytest.mark.parametrize(
    ("family", "scene"), [("replicacad", "made_000"), ("procthor", "houses-0"), ("gibson", "verified/made_000")]
)
def test_both_files_are_written_and_again_the_same(tmp_path: Path, datasets: Datasets, family: str, scene: str) -> None:
    config = configured(tmp_path, datasets, family)
    out = tmp_path / "scene_datasets" / "a" / "a.glb"
    report = compose(config, scene, out)
    first = {file.name: file.read_bytes() for file in out.parent.iterdir()}
    assert set(first) == {"a.glb", "a.navmesh"}
    assert not (tmp_path / "store").exists()
    said = report.document
    assert (said["bytes"], said["scene"]) == (len(first["a.glb"]), f"{family}/{scene}")
    name = scene.removeprefix("verified/")
    assert said["scene_id"] == f"{family}/{name}/{name}.glb"
    assert said["triangles"] >= len(read_glb(first["a.glb"], "a.glb").faces)
    nav = Pathfinder.load(out.with_suffix(".navmesh"))
    assert said["navigable_area"] == nav.navigable_area
    assert nav.settings.agent_radius == pytest.approx(config.agent.radius)
    compose(config, f"{family}/{scene}", out)
    assert {file.name: file.read_bytes() for file in out.parent.iterdir()} == first


def test_the_datasets_own_navmesh_may_be_kept(tmp_path: Path, datasets: Datasets) -> None:
    config = configured(tmp_path, datasets, "replicacad", "procthor")
    report = compose(config, "made_000", tmp_path / "a.glb", own_navmesh=True)
    shipped = datasets["replicacad"] / "navmeshes_default" / "made_000.navmesh"
    assert (tmp_path / "a.navmesh").read_bytes() == shipped.read_bytes()
    assert report.document["navmesh_built"] is False
    with pytest.raises(UsageError, match="ships no navmesh of procthor/houses-0"):
        compose(config, "houses-0", tmp_path / "b.glb", own_navmesh=True)
    assert not (tmp_path / "b.glb").exists()


def test_the_navmesh_fits_the_configured_agent(tmp_path: Path, datasets: Datasets) -> None:
    config = configured(tmp_path, datasets, "procthor").model_copy(
        update={"agent": AgentConfig(radius=0.3, height=0.9)}
    )
    compose(config, "houses-0", tmp_path / "a.glb")
    wide = Pathfinder.load(tmp_path / "a.navmesh")
    assert wide.settings.fits(0.3, 0.9, 0.2, 45.0)
    compose(configured(tmp_path, datasets, "procthor"), "houses-0", tmp_path / "b.glb")
    assert wide.navigable_area < Pathfinder.load(tmp_path / "b.navmesh").navigable_area
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


def test_a_scene_of_several_sources_is_to_be_named_with_its_family(tmp_path: Path, datasets: Datasets) -> None:
    config = configured(tmp_path, datasets, "replicacad", "mp3d")
    with pytest.raises(UsageError, match="several sources have this scene: replicacad/made_000, mp3d/made_000"):
        compose(config, "made_000", tmp_path / "a.glb")
    assert compose(config, "mp3d/made_000", tmp_path / "a.glb").document["scene"] == "mp3d/made_000"


@pytest.mark.parametrize(
    ("scene", "out", "message"), [("nowhere", "a.glb", "no source has"), ("x", "a.ply", "not a .glb")]
)
def test_wrong_use_is_told_and_nothing_is_written(
    tmp_path: Path, datasets: Datasets, scene: str, out: str, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        compose(configured(tmp_path, datasets, "replicacad"), scene, tmp_path / out)
    assert list(tmp_path.iterdir()) == []


def test_a_scene_without_surfaces_leaves_what_was_there(tmp_path: Path) -> None:
    make_samples(tmp_path / "data", "mp3d", 1, 8)
    (tmp_path / "data/made_000/made_000.glb").unlink()
    (tmp_path / "a.glb").write_bytes(b"before")
    config = configured(tmp_path, {"mp3d": tmp_path / "data"}, "mp3d")
    with pytest.raises(InputError, match="neither a mesh nor walls"):
        compose(config, "made_000", tmp_path / "a.glb")
    assert (tmp_path / "a.glb").read_bytes() == b"before"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.glb", "data"]


def test_the_command_says_where_loaders_look_for_it(tmp_path: Path, datasets: Datasets) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(f"name: made\nstore: store\nsources: [{{family: procthor, root: '{datasets['procthor']}'}}]\n")
    words = ["export", str(config), "houses-0", "--compose", str(tmp_path / "a.glb")]
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0
    said = json.loads(result.stdout)
    assert (said["scene_id"], said["approximate"], said["exit_code"]) == ("procthor/houses-0/houses-0.glb", True, 0)
    shown = CliRunner().invoke(app, words)
    assert "procthor/houses-0/houses-0.glb" in shown.stdout
