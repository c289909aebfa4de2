"""Which decoder read the textures is part of the images' key, and what is missing in the images is said."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from condvln.sensors.renderer import Renderer, open_renderer
from condvln.sensors.textures import decoders
from factory.stage import Unit
from jobs.stages import trajectories as stages
from jobs.stages.trajectories import FrameStage
from jobs.trajectories import Request, make_trajectories
from jobs.trajectory_units import other_decoders
from schemas.config import TrajectoryConfig
from tests.jobs.trajectories.made import TINY, proven
from tests.jobs.trajectories.test_recipe import again, recipe

__all__ = ["recipe"]

UNREAD = "textures: 1 can't be read, in a.glb; their surfaces have their material's colour"


def test_the_key_of_images_has_the_decoder_of_ktx2(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    # It is called for every scene, and looks at the files of installed packages: once is enough.
    assert decoders() is decoders()
    unit = Unit(unit_id="made/one", partition="made", inputs=())

    def key(spec: object, version: str) -> str:
        decoders.cache_clear()
        monkeypatch.setattr("condvln.sensors.textures.find_spec", lambda name: spec)
        monkeypatch.setattr("condvln.sensors.textures.metadata.version", lambda name: version)
        stage = FrameStage(tmp_path, tmp_path, {"rgb": TINY}, TrajectoryConfig())
        return json.dumps(stage.parameters(unit))

    monkeypatch.setattr(stages, "encoders", dict)
    try:
        assert len({key(None, "1"), key(object(), "1"), key(object(), "2")}) == 3
        assert decoders()["ktx2"] == "opengl_basisu 2"
    finally:
        decoders.cache_clear()


def test_what_is_missing_in_images_is_said_again_by_a_run_that_finds_all_made(
    asked: Request, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def noted(*given: Any) -> Renderer:
        renderer = open_renderer(*given)
        renderer.notes = (*renderer.notes, UNREAD)
        return renderer

    monkeypatch.setattr(stages, "open_renderer", noted)
    request = again(asked, recipe, tmp_path / "out", recipe_only=True)
    first = make_trajectories(request)
    # A scene whose walks were left out is a unit of the recipe too.
    assert first.document["notes"]
    assert all(UNREAD in notes for notes in first.document["notes"].values())
    # A note that several scenes share is one line.
    (said,) = [line for line in first.lines if UNREAD in line]
    second = make_trajectories(request)
    assert second.document["counts"]["fresh"] == second.document["counts"]["total"]
    assert second.document["notes"] == first.document["notes"]
    assert said in second.lines
    record = json.loads((tmp_path / "out" / "trajectories.json").read_bytes())
    assert record["notes"] == first.document["notes"]
    assert record["decoders"] == dict(decoders())


def test_another_decoder_is_named(asked: Request, made: Path, recipe: Path, tmp_path: Path) -> None:
    record = json.loads((recipe / "trajectories.json").read_bytes())
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    for path in recipe.iterdir():
        (theirs / path.name).write_bytes(path.read_bytes())
    record["decoders"]["ktx2"] = "opengl_basisu 0.0.1"
    (theirs / "trajectories.json").write_text(json.dumps(record | {"images_written": False}))
    (said,) = other_decoders(record["decoders"], decoders())
    assert "opengl_basisu 0.0.1" in said
    assert said in make_trajectories(again(asked, theirs, tmp_path / "out", plan=True)).lines
    assert said in proven(asked, theirs, render_every=0).lines
    assert not other_decoders({}, decoders())
    assert not other_decoders(decoders(), decoders())
