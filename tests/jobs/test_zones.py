"""Rooms that the user drew: the side file takes the place of the dataset's rooms, through the whole line."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from condvln.samples import FAMILIES, make_samples
from condvln.sources.registry import open_source
from jobs.generate import run_generate
from jobs.plan import make_plan
from jobs.verify import verify_export
from jobs.workspace import published
from schemas.config import Config, InstructionsConfig, SourceConfig

# By turns, so that what one kitchen has, another one lacks.
LABELS = ({"west": "kitchen", "east": "bedroom"}, {"west": "bedroom", "east": "kitchen"})


def halves(centres: np.ndarray, labels: dict[str, str]) -> dict[str, Any]:
    """Two zones with one wall, which has half of the objects on each side and cuts through none of their centres."""
    xs = np.sort(centres[:, 0])
    gap = max(range(len(xs) // 3, 2 * len(xs) // 3), key=lambda k: xs[k + 1] - xs[k])
    wall = float(xs[gap] + xs[gap + 1]) / 2
    (x0, _, z0), (x1, _, z1) = centres.min(axis=0) - 3, centres.max(axis=0) + 3
    zones = []
    for name, (low, high) in {"west": (x0, wall), "east": (wall, x1)}.items():
        loop = [[low, 0, z0], [high, 0, z0], [high, 0, z1], [low, 0, z1]]
        zones.append({"name": name, "label": labels[name], "poly_loop": loop, "floor_height": 0.0})
    return {"region_annotations": [zone | {"extrusion_height": 4.0} for zone in zones]}


def configured(folder: Path, family: str, regions: Path | None = None) -> Config:
    return Config(
        name=family,
        store=folder / "store",
        export=folder / "export",
        sources=(
            SourceConfig(family=family, root=folder / "data", regions=regions),  # type: ignore[arg-type]
        ),
        instructions=InstructionsConfig(per_category={"simple": 4, "chain": 2}),
    )


# Two whole apartments, and rooms that are scenes of their own; the others take the same road.
QUICK = ("replicacad", "ithor")


@pytest.mark.parametrize(
    "family", [f if f in QUICK else pytest.param(f, marks=pytest.mark.soak) for f in sorted(FAMILIES)]
)
def test_zones_are_the_rooms_of_a_scene(family: str, tmp_path: Path) -> None:
    make_samples(tmp_path / "data", family, 2, 3)
    scenes, labels = {}, {}
    source = open_source(family, tmp_path / "data")
    (tmp_path / "zones").mkdir()
    for number, handle in enumerate(source.handles()):
        scene = scenes[handle.scene_id] = source.read(handle.scene_id)
        labels[handle.scene_id] = LABELS[number % 2]
        drawn = halves(np.array([item.center for item in scene.objects]), LABELS[number % 2])
        name = handle.scene_id.split("/")[-1]
        (tmp_path / "zones" / f"{name}.semantic_config.json").write_text(json.dumps(drawn))
    config = configured(tmp_path, family, tmp_path / "zones")
    assert run_generate(config, inline=True, console=Console(file=io.StringIO())).exit_code == 0
    snapshot = published(config)
    rooms = snapshot.table("rooms").to_pylist()
    assert {(r["scene_id"], r["room_id"], r["label"], r["annotation"]) for r in rooms} == {
        (scene_id, zone, label, "user") for scene_id in scenes for zone, label in labels[scene_id].items()
    }
    # Every object is in the zone that its place says, and none is lost.
    room_of = {(o["scene_id"], o["object_id"]): o["room_id"] for o in snapshot.table("objects").to_pylist()}
    for scene_id, scene in scenes.items():
        wall = json.loads((tmp_path / "zones" / f"{scene_id.split('/')[-1]}.semantic_config.json").read_text())
        middle = wall["region_annotations"][0]["poly_loop"][1][0]
        for item in scene.objects:
            assert room_of[scene_id, item.object_id] == ("west" if item.center[0] < middle else "east")
    relations = snapshot.table("relations").to_pylist()
    pairs = {(r["scene_id"], r["subject"], r["target"]) for r in relations if r["kind"] != "containment"}
    assert len(pairs) > 100
    for scene_id, subject, target in pairs:
        assert room_of[scene_id, subject] == room_of[scene_id, target]
    # Two rooms make a scene of several rooms, one-room datasets too.
    episodes = snapshot.table("episodes").to_pylist()
    assert len(episodes) >= 5
    assert {row["success_distance"] for row in episodes} == {config.places.success_distance}
    texts = " ".join(row["text"] for row in snapshot.table("instructions").to_pylist())
    assert set(re.findall(r"in the (kitchen|bedroom)", texts)) == {"kitchen", "bedroom"}
    assert verify_export(config, tmp_path / "export").exit_code == 0


def test_a_zone_moved_makes_its_own_scene_stale(tmp_path: Path) -> None:
    make_samples(tmp_path / "data", "gibson", 2, 3)
    source = open_source("gibson", tmp_path / "data")
    (tmp_path / "zones").mkdir()
    for handle in source.handles():
        drawn = halves(np.array([item.center for item in source.read(handle.scene_id).objects]), LABELS[0])
        (tmp_path / "zones" / f"{handle.scene_id.split('/')[-1]}.semantic_config.json").write_text(json.dumps(drawn))
    config = configured(tmp_path, "gibson", tmp_path / "zones").model_copy(update={"export": None})
    assert run_generate(config, inline=True, console=Console(file=io.StringIO())).exit_code == 0
    assert make_plan(config).document["counts"]["FRESH"] == 2
    moved = tmp_path / "zones" / "made_001.semantic_config.json"
    drawn = json.loads(moved.read_text())
    drawn["region_annotations"][0]["extrusion_height"] = 4.5
    moved.write_text(json.dumps(drawn))
    plan = make_plan(config).document
    assert [(e["unit_id"], e["status"]) for e in plan["scenes"] if e["status"] != "FRESH"] == [
        ("gibson/verified/made_001", "STALE")
    ]
    # A broken side file is the fault of its scene alone.
    moved.write_text('{"region_annotations": [{"name": "a"}]}')
    report = run_generate(config, inline=True, console=Console(file=io.StringIO()))
    assert [entry["unit"] for entry in report.document["quarantined"]] == ["gibson/verified/made_001"]
    assert "made_001.semantic_config.json: region_annotations[0]" in report.document["quarantined"][0]["message"]
