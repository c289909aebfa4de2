"""``condvln export --compose``: what is told of scenes that can't be composed, and what is never overwritten."""

from __future__ import annotations

import gzip
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import trimesh
from typer.testing import CliRunner

from condvln.export.vlnce import scene_file
from condvln.samples import make_layouts, make_samples
from jobs.command import app
from jobs.compose import compose_all
from schemas.config import Config, InstructionsConfig, SourceConfig
from schemas.errors import FormatError, PathEscapeError, UsageError
from tests.condvln.voxelised import voxelise

SEED = 3


def source_of(form: str, folder: Path, scenes: int) -> SourceConfig:
    report = make_samples(folder, form, scenes, SEED)
    if form == "replicacad":
        voxelise(folder, make_layouts(scenes, SEED))
    return SourceConfig(family=report.family, **report.parts)  # type: ignore[arg-type]


def config_of(folder: Path, *sources: SourceConfig) -> Config:
    return Config(
        name="made",
        store=folder / "store",
        export=folder / "export",
        sources=sources,
        instructions=InstructionsConfig(per_category={"simple": 4, "nested": 4}, counterfactual_groups=0),
    )


def files(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Every file by path, with its time of change: what is not written keeps it."""
    return {p.relative_to(folder).as_posix(): (p.read_bytes(), p.stat().st_mtime_ns) for p in folder.rglob("*.*")}


@pytest.fixture(scope="module")
def houses(tmp_path_factory: pytest.TempPathFactory) -> Config:
    """Three houses, of which an export tells; read only."""
    folder = tmp_path_factory.mktemp("houses")
    config = config_of(folder, source_of("procthor", folder / "data", 3))
    told(config, "procthor/houses-0", "procthor/houses-1", "procthor/houses-2")
    return config


def told(config: Config, *scenes: str, **changes: Any) -> None:
    """An export's record, by itself: all that is read of it."""
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
    assert all("was not written by condvln export --compose" in one["message"] for one in report.document["failed"])
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
    result = CliRunner().invoke(app, ["export", str(config_file), "houses-0", "--compose", inside])
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
        with pytest.raises(error, match="leads out of the dataset"):
            compose_all(config, tmp_path / "scenes")
    else:
        assert compose_all(config, tmp_path / "scenes").document["composed"] == []
    assert not (tmp_path / "scenes").exists()


@pytest.mark.parametrize("text", ["", "[]", '{"scenes": 5, "files": {}}', '{"scenes": {"train": 5}, "files": {}}', "{"])
def test_a_damaged_record_is_one_error(houses: Config, tmp_path: Path, text: str) -> None:
    config = elsewhere(houses, tmp_path)
    told(config)
    (tmp_path / "export/export.json").write_text(text)
    with pytest.raises(FormatError, match=r"export\.json: not the record of an export .*Export again"):
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


def test_the_place_of_a_scan_is_told_as_its_episodes_name_it(tmp_path: Path) -> None:
    """HM3D's folder is ``<number>-<scan>``, and only the scan's own name is that of the file."""
    source = source_of("hm3d", tmp_path / "scans", 1)
    told(config := config_of(tmp_path, source), "hm3d/val/00800-TEEsavR23oF")
    report = compose_all(config, tmp_path / "scenes")
    assert report.document["single_files"] == ["hm3d"]
    (line,) = [line for line in report.lines if "one file each" in line]
    pattern = line.rpartition("scenes/")[2]
    assert pattern == "hm3d/<split>/<number>-<scan>/<scan>.basis.glb"
    for word, value in (("<split>", "val"), ("<number>", "00800"), ("<scan>", "TEEsavR23oF")):
        pattern = pattern.replace(word, value)
    assert pattern == scene_file("hm3d", "val/00800-TEEsavR23oF")


def test_the_command_takes_one_scene_or_all(houses: Config, tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text(houses.model_dump_json())
    runner = CliRunner()
    folder = str(tmp_path / "scenes")
    result = runner.invoke(app, ["export", str(config), "--compose", folder, "--json"])
    assert result.exit_code == 0
    said = json.loads(result.stdout)
    assert (said["scenes"], said["written"], said["exit_code"]) == (3, 3, 0)
    shown = runner.invoke(app, ["export", str(config), "--compose", folder])
    assert "0 written, 3 unchanged" in " ".join(shown.stdout.split())  # lines are folded
    for words in (["houses-0"], ["--oracle"], ["houses-0", "--oracle", "--compose", folder]):
        wrong = runner.invoke(app, ["export", str(config), *words])
        assert isinstance(wrong.exception, UsageError)
        assert "neither an export, nor a twin, nor composed scenes" in str(wrong.exception)
