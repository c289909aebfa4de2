"""Every family's made scenes through the whole line: generated, exported with the navmeshes it needs, and proven."""

from __future__ import annotations

import hashlib
import io
import re
from pathlib import Path

import orjson
import pytest
from rich.console import Console

from condvln.navigation.navmesh_file import read_navmesh
from condvln.samples import FAMILIES
from jobs.generate import run_generate
from jobs.verify import verify_export
from jobs.workspace import published
from schemas.config import Config, SourceConfig
from tests.jobs.conftest import made_config, remove

BUILT = {"boxes", "procthor", "ithor", "robothor"}
"""Families that never ship a navmesh."""


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_a_family_yields_and_is_proven(family: str, tmp_path: Path) -> None:
    config = made_config(tmp_path, family, 1, episodes=4)
    report = run_generate(config, inline=True, console=Console(file=io.StringIO()))
    assert report.exit_code == 0
    snapshot = published(config)
    episodes = snapshot.table("episodes")
    assert episodes.num_rows >= 10
    scenes = {row["scene_id"]: row for row in snapshot.table("scenes").to_pylist()}
    assert all(row["navmesh_built"] == (family in BUILT) for row in scenes.values())
    assert verify_export(config, tmp_path / "export").exit_code == 0
    rows = [
        orjson.loads(line) for path in sorted((tmp_path / "export/manifest").glob("*.jsonl")) for line in path.open()
    ]
    assert len(rows) > 0
    for row in rows:
        shipped = tmp_path / "export" / row["navmesh"]
        assert shipped.is_file() == (family in BUILT)
        path = shipped if family in BUILT else tmp_path / "data" / row["navmesh"]
        assert hashlib.sha256(path.read_bytes()).hexdigest() == row["navmesh_sha256"]
        own = read_navmesh(path).known_settings
        assert own.fits(config.agent.radius, config.agent.height, config.agent.max_climb, config.agent.max_slope)


def test_the_documented_scene_of_boxes_yields_by_default(tmp_path: Path, repository: Path) -> None:
    (text,) = re.findall(r"^```json\n(.*?)^```", (repository / "docs/boxes.md").read_text(), re.M | re.S)
    (tmp_path / "data").mkdir()
    (tmp_path / "data/lab.json").write_text(text)
    source = SourceConfig(family="boxes", root=tmp_path / "data")
    config = Config(name="lab", store=tmp_path / "store", export=tmp_path / "export", sources=(source,))
    assert run_generate(config, inline=True, console=Console(file=io.StringIO())).exit_code == 0
    assert published(config).table("episodes").num_rows >= 20
    assert verify_export(config, tmp_path / "export").exit_code == 0


def test_without_mesh_navmesh_or_walls_there_are_instructions_and_no_episodes(tmp_path: Path) -> None:
    config = made_config(tmp_path, "gibson", 2, episodes=4)
    remove(tmp_path / "data", "*.glb", "*.navmesh")
    report = run_generate(config, inline=True, console=Console(file=io.StringIO()))
    assert report.exit_code == 0
    snapshot = published(config)
    assert snapshot.table("episodes").num_rows == 0
    instructions = snapshot.table("instructions").to_pylist()
    assert len(instructions) > 20
    assert all(row["text"] for row in instructions)
    assert {row["status"] for row in snapshot.table("scenes").to_pylist()} == {"ok"}
    assert all("instructions without episodes" in row["reason"] for row in snapshot.table("scenes").to_pylist())
    refused = [r for r in snapshot.table("rejections").to_pylist() if r["reason"] == "no_navmesh"]
    assert sum(row["count"] for row in refused) >= len(instructions)


def test_a_scan_with_its_mesh_alone_gets_a_navmesh(tmp_path: Path) -> None:
    config = made_config(tmp_path, "mp3d", 1, episodes=4)
    remove(tmp_path / "data", "*.navmesh")
    assert run_generate(config, inline=True, console=Console(file=io.StringIO())).exit_code == 0
    (scene,) = published(config).table("scenes").to_pylist()
    assert scene["navmesh_built"]
    assert published(config).table("episodes").num_rows > 0
    assert verify_export(config, tmp_path / "export").exit_code == 0
