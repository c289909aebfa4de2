"""The seven real floor plans of AI2-THOR: every measured fact that they can tell again."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from condvln.scene import Scene
from condvln.scene.boxes import box_corners
from condvln.scene.tables import scene_from_tables, scene_tables
from condvln.sources.registry import open_source
from tests.condvln.sources.thor_plans import Document


@pytest.fixture(scope="module")
def scenes(real_data: Path) -> dict[str, Scene]:
    source = open_source("ithor", real_data / "ithor")
    return {h.scene_id: source.read(h.scene_id) for h in source.handles()}


@pytest.fixture(scope="module")
def raw(real_data: Path) -> dict[str, list[Document]]:
    files = sorted((real_data / "ithor").glob("*.json"))
    return {f.stem: json.loads(f.read_text())["objects"] for f in files}


def test_all_plans_are_read_whole(scenes: dict[str, Scene], raw: dict[str, list[Document]]) -> None:
    assert {name: (len(s.objects), s.rooms[0].label) for name, s in scenes.items()} == {
        "FloorPlan207": (37, "living room"),
        "FloorPlan21": (61, "kitchen"),
        "FloorPlan306": (29, "bedroom"),
        "FloorPlan320": (36, "bedroom"),
        "FloorPlan404": (32, "bathroom"),
        "FloorPlan6": (68, "kitchen"),
        "FloorPlan9": (85, "kitchen"),
    }
    assert all(o.aabb is not None for s in scenes.values() for o in s.objects)
    assert sum(o["assetId"] == "" for objects in raw.values() for o in objects) == 154


def test_oriented_boxes_are_there_for_what_can_be_moved(
    scenes: dict[str, Scene], raw: dict[str, list[Document]]
) -> None:
    count = Counter()
    for name, objects in raw.items():
        for entry in objects:
            item = scenes[name].object_of[entry["objectId"]]
            movable = entry["pickupable"] or entry["moveable"]
            assert (
                (item.obb is not None)
                == (entry["objectOrientedBoundingBox"] is not None)
                == movable
                == (not item.static)
            )
            count[item.geometry] += 1
            if item.obb is not None:
                corners = np.array(entry["objectOrientedBoundingBox"]["cornerPoints"]) * [1, 1, -1]
                off = np.linalg.norm(corners[:, None] - box_corners(item.obb)[None], axis=2).min(axis=1)
                assert off.max() < 0.002
    assert count == {"obb": 168, "aabb": 180}


def test_positions_are_pivots_and_not_centres(raw: dict[str, list[Document]]) -> None:
    near = sum(
        max(abs(o["position"][c] - o["axisAlignedBoundingBox"]["center"][c]) for c in "xyz") < 0.02
        for objects in raw.values()
        for o in objects
    )
    assert near == 99


def test_reachable_places_are_outside_of_furniture_and_on_the_floor(real_data: Path, scenes: dict[str, Scene]) -> None:
    solid = {"Fridge", "CounterTop", "Bed", "Sofa", "Toilet", "Desk", "DiningTable", "Dresser"}
    total, inside = 0, {}
    for name, scene in scenes.items():
        reachable = np.load(real_data / "ithor" / f"{name}-reachable.npy") * [1, -1]
        total += len(reachable)
        assert np.allclose(reachable / 0.25, np.round(reachable / 0.25))
        outline = scene.rooms[0].polygon
        assert outline is not None
        assert ((outline.min(0) <= reachable) & (reachable <= outline.max(0))).all()
        for item in scene.objects:
            if item.raw_label in solid and item.aabb is not None:
                low, high = item.aabb[:, [0, 2]]
                inside[name, item.object_id] = int(((low < reachable) & (reachable < high)).all(axis=1).sum())
    assert (total, len(inside)) == (663, 22)
    # One counter runs round a corner: its box holds the floor before it.
    assert {key: n for key, n in inside.items() if n} == {("FloorPlan6", "CounterTop|+00.47|+00.95|-01.63"): 7}


def test_scenes_survive_their_tables(scenes: dict[str, Scene]) -> None:
    for scene in scenes.values():
        tables = scene_tables(scene)
        again = scene_tables(scene_from_tables(tables, scene.root, family="ithor"))
        assert all(again[name].equals(tables[name]) for name in tables)
