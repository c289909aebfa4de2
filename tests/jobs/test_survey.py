"""What a survey tells of made datasets must be what was written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from condvln.samples import FAMILIES, make_samples
from condvln.sources.family import look_for
from condvln.sources.registry import open_source
from jobs.sources import scene_yield, survey, survey_source
from schemas.config import AgentConfig, Config, SourceConfig
from schemas.errors import ConfigError

NO_MESH = {"boxes", "procthor", "ithor", "robothor"}


@pytest.fixture(scope="module", params=sorted(FAMILIES))
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory):
    root = tmp_path_factory.mktemp(request.param)
    return request.param, root, make_samples(root, family=request.param, scenes=2, seed=1)


def test_counts_are_those_of_what_was_written(made) -> None:
    family, root, report = made
    source = open_source(family, root)
    ticks: list[None] = []
    survey = survey_source(source, source.handles(), AgentConfig(), tick=lambda: ticks.append(None))
    assert len(ticks) == survey.read == survey.scenes
    assert survey.read >= 2
    scenes = [source.read(handle.scene_id) for handle in source.handles()]
    assert survey.rooms == sum(len(scene.rooms) for scene in scenes)
    assert survey.objects == sum(len(scene.objects) for scene in scenes)
    # Some formats list walls and doors as objects too; iTHOR has no room type for a hallway.
    assert survey.objects >= report.objects or family == "ithor"
    assert survey.without_extent == 0
    assert survey.unreadable == []
    assert not survey.skipped
    assert sum(survey.navmeshes.values()) == survey.read
    assert set(survey.navmeshes) == {"to be built" if family in NO_MESH else "shipped, fits"}


def test_whole_samples_miss_nothing_required(made) -> None:
    family, root, _ = made
    assert [
        kind.download.holds for kind in look_for(family, root) if kind.download.need == "required" and not kind.files
    ] == []


def test_a_limit_spreads_over_the_list(tmp_path: Path) -> None:
    make_samples(tmp_path, family="procthor", scenes=6, seed=1)
    source = open_source("procthor", tmp_path)
    handles = source.handles()
    survey = survey_source(source, handles, AgentConfig(), limit=2)
    first, fourth = (source.read(handles[k].scene_id) for k in (0, 3))
    assert (survey.scenes, survey.read) == (6, 2)
    assert survey.objects == len(first.objects) + len(fourth.objects)


def test_a_broken_scene_is_told_and_the_others_are_read(tmp_path: Path) -> None:
    make_samples(tmp_path, family="ithor", scenes=3, seed=1)
    paths = sorted(p for p in tmp_path.rglob("*.json") if b'"sceneName"' in p.read_bytes())
    paths[1].write_bytes(paths[1].read_bytes()[:-100])
    source = open_source("ithor", tmp_path)
    survey = survey_source(source, source.handles(), AgentConfig())
    assert [scene for scene, _ in survey.unreadable] == [paths[1].stem]
    assert survey.read == len(paths) - 1


def test_what_scenes_will_yield_is_said_before_the_run(tmp_path: Path) -> None:
    make_samples(tmp_path, family="gibson", scenes=2, seed=1)
    for path in tmp_path.glob("verified"):
        path.rename(tmp_path / "automated")
    assert (tmp_path / "automated").is_dir()
    for absence, asked in (("complete", False), ("never", True)):
        source = open_source("gibson", tmp_path, absence=absence)
        survey = survey_source(source, source.handles(), AgentConfig())
        assert len(survey.yields) == survey.read >= 2
        assert all((one.nothing == "") == asked for one in survey.yields)
        assert all("absence: never" in one.nothing for one in survey.yields if not asked)
        assert not any(one.absence for one in survey.yields), "nothing is ever said to be absent"


def test_what_a_nameless_object_blocks_is_counted(tmp_path: Path) -> None:
    make_samples(tmp_path, family="procthor", scenes=2, seed=1)
    source = open_source("procthor", tmp_path)
    scene = source.read(source.handles()[0].scene_id)
    plain = scene_yield(scene, 0.4)
    assert (plain.nothing, plain.nameless) == ("", 0)
    assert plain.absence > 0
    strange = replace(scene.objects[0], object_id="strange", raw_label="ObjaZyx", label="obja zyx", aabb=None)
    found = scene_yield(replace(scene, objects=(*scene.objects, strange)), 0.4)
    assert found.nameless == 1
    assert found.blocked > plain.blocked > 0  # a vase may be called a bowl, and so on
    assert found.absence < plain.absence or plain.rooms > 1


def test_a_source_that_yields_nothing_readable_ends_with_an_error(tmp_path: Path) -> None:
    make_samples(tmp_path / "a", family="procthor", scenes=2, seed=1)
    make_samples(tmp_path / "b", family="ithor", scenes=2, seed=1)
    sources = tuple(
        SourceConfig(family=family, root=tmp_path / name) for name, family in (("a", "procthor"), ("b", "ithor"))
    )
    config = Config(name="t", store=tmp_path / "store", sources=sources, export=None)
    assert survey(config).exit_code == 0
    files = sorted((tmp_path / "b").glob("*.json"))
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
    files[0].write_text(pointer)
    assert survey(config).exit_code == 0
    for file in files:
        file.write_text(pointer)
    report = survey(config)
    assert report.exit_code == ConfigError.exit_code
    assert f"files of {len(files)} of {len(files)} scenes were not downloaded" in report.document["sources"][1]["error"]
    assert "git lfs pull" in report.document["sources"][1]["error"]
