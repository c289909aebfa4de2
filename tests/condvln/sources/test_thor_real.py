"""The seven real floor plans of AI2-THOR: every measured fact that they can tell again."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from condvln.scene import Scene
from condvln.scene.boxes import box_corners
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
