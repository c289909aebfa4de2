"""``condvln render``: sheets, clips and frames of scenes and episodes, and what it says when it can't."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from condvln.sensors import cameras_of
from condvln.sources.source import hash_file
from condvln.world import open_world
from jobs.command import app
from jobs.compose import found_scene
from jobs.pipeline import open_configured
from jobs.render import render
from jobs.report import Report
from jobs.workspace import published
from schemas.config import Config
from schemas.errors import UsageError

Run = tuple[Config, Report]


@pytest.fixture(scope="module")
def named(made_run: Run) -> str:
    """A scene of the run."""
    config, _ = made_run
    scenes = published(config).table("scenes").to_pylist()
    return next(f"{row['source']}/{row['scene_id']}" for row in scenes if row["navmesh_path"])


def test_a_scene_s_frames_are_what_its_renderer_draws(made_run: Run, named: str, tmp_path: Path) -> None:
    config, _ = made_run
    source, scene_id = found_scene(config, named)
    world = open_world(source, scene_id, config.agent)
    world.pathfinder.seed(5)
    place = tuple(round(float(v), 3) for v in world.pathfinder.get_random_navigable_point())
    report = render(config, named, tmp_path / "frames", camera="vlnce", position=place, heading=90.0)
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == [
        "000_depth.png",
        "000_instance.png",
        "000_rgb.png",
    ]
    cameras = cameras_of("vlnce")
    # East is to the right of north: a quarter turn clockwise.
    rgb, depth = (world.renderer.look(cameras[name], place, -math.pi / 2) for name in ("rgb", "depth"))
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "frames" / "000_rgb.png")), rgb.rgb)
    stored = np.asarray(Image.open(tmp_path / "frames" / "000_depth.png"))
    np.testing.assert_allclose(stored / 1000, depth.depth, atol=5.1e-4)
    instances = np.asarray(Image.open(tmp_path / "frames" / "000_instance.png"))
    np.testing.assert_array_equal(instances, depth.instance)
    assert report.document["notes"] == list(world.renderer.notes)


def test_a_sheet_shows_the_four_quarters_and_repeats(made_run: Run, named: str, tmp_path: Path) -> None:
    config, _ = made_run
    for name in ("a.png", "b.png"):
        assert render(config, named, tmp_path / name).document["poses"] == 4
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    sheet = Image.open(tmp_path / "a.png")
    assert sheet.width == 3 * 320
    assert len(sheet.getcolors(1 << 24)) > 10
    with pytest.raises(UsageError, match="no camera preset"):
        render(config, named, tmp_path / "c.png", camera="eagle")
    with pytest.raises(UsageError, match=r"neither \.png nor \.gif"):
        render(config, named, tmp_path / "c.mp4")


def test_an_episode_is_shown_along_its_right_way(made_run: Run, tmp_path: Path) -> None:
    config, _ = made_run
    row = published(config).table("episodes").to_pylist()[0]
    name = str(row["episode_id"])
    report = render(config, name, tmp_path / "episode.gif")
    with Image.open(tmp_path / "episode.gif") as clip:
        # Equal frames that follow each other are one in the file.
        assert 2 <= clip.n_frames <= report.document["poses"]  # type: ignore[attr-defined]
        first = np.asarray(clip.convert("RGB")).astype(int)
    found = next(one for one in config.sources if one.family == row["source"])
    world = open_world(open_configured(config, found, hash_file), row["scene_id"], config.agent)
    start = [row["start_position"][axis] for axis in "xyz"]
    seen = world.renderer.look(cameras_of("streamvln")["rgb"], start, -math.radians(row["start_heading_degrees"])).rgb
    assert np.abs(first - seen).mean() < 3, "colours of a clip are few"
    runner = CliRunner()
    path = tmp_path / "made.yaml"
    path.write_text(config.model_dump_json(exclude_defaults=True), encoding="utf-8")
    done = runner.invoke(app, ["render", str(path), name, str(tmp_path / "sheet.png"), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.output)["poses"] == report.document["poses"]
    assert (tmp_path / "sheet.png").is_file()
    with pytest.raises(UsageError, match="no pose can be given"):
        render(config, name, tmp_path / "x.png", heading=3.0)
    with pytest.raises(UsageError, match="no source has a scene 'nothing', and no episode id begins with it"):
        render(config, "nothing", tmp_path / "x.png")


def test_frames_never_go_into_an_export(made_run: Run, named: str, tmp_path: Path) -> None:
    config = made_run[0].model_copy(update={"export": tmp_path / "export"})
    for out in (tmp_path / "export" / "a.png", tmp_path / "export" / "frames"):
        with pytest.raises(UsageError, match="must not hold meshes or images"):
            render(config, named, out)
