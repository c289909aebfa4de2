"""The sixty real houses of ProcTHOR: every measured fact that they can tell again."""

from __future__ import annotations

import gzip
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from condvln.scene import Scene
from condvln.sources.procthor import ProcthorSource
from condvln.sources.procthor_house import House
from condvln.sources.registry import open_source


@pytest.fixture(scope="module")
def real(real_data: Path) -> ProcthorSource:
    source = open_source("procthor", real_data / "procthor")
    assert isinstance(source, ProcthorSource)
    return source


@pytest.fixture(scope="module")
def scenes(real: ProcthorSource) -> dict[str, Scene]:
    return {h.scene_id: real.read(h.scene_id) for h in real.handles()}


@pytest.fixture(scope="module")
def houses(real: ProcthorSource, scenes: dict[str, Scene]) -> dict[str, House]:
    return {scene_id: real.house(scene_id) for scene_id in scenes}


@pytest.fixture(scope="module")
def raw(real_data: Path) -> dict[str, Any]:
    with gzip.open(real_data / "procthor" / "houses60.jsonl.gz") as lines:
        return {f"houses60-{i}": json.loads(line) for i, line in enumerate(lines)}


@pytest.fixture(scope="module")
def boxes(real_data: Path) -> dict[str, dict[str, float]]:
    database = json.loads((real_data / "procthor" / "asset-database.json").read_text())
    return {a["assetId"]: a["boundingBox"] for assets in database.values() for a in assets}


def test_all_houses_are_read_whole(scenes: dict[str, Scene], raw: dict[str, Any], boxes: dict[str, Any]) -> None:
    assert len(scenes) == 60
    assert sum(len(s.rooms) for s in scenes.values()) == 296
    assert sum(len(s.objects) for s in scenes.values()) == 5396
    assert len(boxes) == 1653
    assert Counter(o.geometry for s in scenes.values() for o in s.objects) == {"obb": 5396}
    assert not [w.code for s in scenes.values() for w in s.warnings]
    assert all(r.complete for s in scenes.values() for r in s.rooms)
    assert {h["metadata"]["schema"] for h in raw.values()} == {"1.0.0"}
    counted = Counter(r.label for s in scenes.values() for r in s.rooms)
    assert counted == {"bedroom": 102, "bathroom": 75, "living room": 69, "kitchen": 50}


def test_each_top_level_object_is_inside_exactly_the_room_that_its_id_names(
    scenes: dict[str, Scene], houses: dict[str, House]
) -> None:
    inside, named = Counter(), 0
    for scene_id, scene in scenes.items():
        polygons = {r.room_id: shapely.Polygon(r.polygon) for r in scene.rooms}
        for item in houses[scene_id].objects:
            if item.parent_id is None:
                spot = shapely.Point(item.position[[0, 2]])
                inside[sum(p.contains(spot) for p in polygons.values())] += 1
                named += scene.object_of[item.object_id].room_id.split("|")[1] in item.object_id.split("|")
    assert (inside, named) == ({1: 2147}, 2147)


def test_sides_are_swapped_at_a_quarter_turn(
    scenes: dict[str, Scene], raw: dict[str, Any], boxes: dict[str, dict[str, float]]
) -> None:
    fits = Counter()
    for scene_id, scene in scenes.items():
        for item in raw[scene_id]["objects"]:
            box, rotation = boxes[item["assetId"]], item["rotation"]
            if abs(rotation["y"] % 180 - 90) > 1e-3 or rotation["x"] != 0 or abs(box["x"] - box["z"]) < 0.01:
                continue
            own = scene.object_of[item["id"]]
            room = shapely.Polygon(scene.room_of[own.room_id].polygon).buffer(0.01)
            x, z, half = own.center[0], own.center[2], (box["x"] / 2, box["z"] / 2)
            fits["read", bool(room.contains(shapely.box(*own.aabb[0][[0, 2]], *own.aabb[1][[0, 2]])))] += 1
            unturned = shapely.box(x - half[0], z - half[1], x + half[0], z + half[1])
            fits["unturned", bool(room.contains(unturned))] += 1
    assert fits == {("read", True): 772, ("unturned", True): 198, ("unturned", False): 574}


def test_positions_are_box_centres(scenes: dict[str, Scene], houses: dict[str, House]) -> None:
    bottoms = []
    for scene_id, scene in scenes.items():
        tops = [o.object_id for o in houses[scene_id].objects if o.parent_id is None]
        bottoms += [scene.object_of[i].aabb[0, 1] for i in tops]  # type: ignore[index]
    on_floor = np.abs(bottoms) < 1e-3
    assert len(bottoms) == 2147
    assert np.median(bottoms) == 0.0
    assert on_floor.mean() > 0.8
    # What is not on the floor hangs on a wall, a metre and more above it.
    labels = Counter(
        o.label for s in scenes.values() for o in s.objects if o.aabb is not None and o.aabb[0, 1] > 0.1
        and o.object_id in {h.object_id for h in houses[s.scene_id].objects if h.parent_id is None}
    )  # fmt: skip
    assert set(labels) == {"painting", "television"}


def test_doors_are_where_nothing_stands_before_them(scenes: dict[str, Scene], houses: dict[str, House]) -> None:
    blocked = Counter()
    for scene_id, scene in scenes.items():
        walls = {w.wall_id: w for w in houses[scene_id].walls}
        low = [
            shapely.box(*o.aabb[0][[0, 2]], *o.aabb[1][[0, 2]])
            for o in scene.objects
            if o.aabb is not None and o.aabb[0, 1] < 0.05 and o.aabb[1, 1] > 0.1
        ]
        for door in houses[scene_id].openings:
            if door.kind == "door":
                wall_ = walls[door.wall_id]
                turned = [wall_.start + wall_.end - door.start, wall_.start + wall_.end - door.end]
                for name, ends in (("read", [door.start, door.end]), ("from the other end", turned)):
                    swept = shapely.LineString(ends).buffer(0.45, cap_style="flat")
                    blocked[name] += any(swept.intersects(box) for box in low)
    assert blocked == {"read": 4, "from the other end": 98}
