"""The real buildings of Gibson: every fact that they can tell again."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from condvln.navigation.navmesh_file import read_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.scene import Scene
from condvln.sources.registry import open_source
from schemas.config import AgentConfig
from tests.condvln.sources.gibson_buildings import Document


@pytest.fixture(scope="module")
def scenes(real_data: Path) -> dict[str, Scene]:
    source = open_source("gibson", real_data / "gibson")
    return {h.scene_id: source.read(h.scene_id) for h in source.handles()}


@pytest.fixture(scope="module")
def raw(real_data: Path) -> dict[str, Document]:
    files = sorted((real_data / "gibson").glob("*/*.scn"))
    return {f"{f.parent.name}/{f.stem}": json.loads(f.read_text()) for f in files}


def test_all_buildings_are_read_whole_or_with_their_reason(scenes: dict[str, Scene], raw: dict[str, Document]) -> None:
    assert len(scenes) == 14
    assert sum(len(s.rooms) for s in scenes.values()) == 247
    assert sum(len(d["objects"]) for d in raw.values()) == 811
    assert sum(len(s.objects) for s in scenes.values()) == 811 - 12
    said = Counter(w.code for s in scenes.values() for w in s.warnings)
    assert said == {"no_parent_room": 17, "nearest_room": 3, "object_outside_rooms": 12, "room_off_level": 1}
    assert len(scenes["verified/Allensville"].objects) == 33
    assert len(scenes["automated/Allensville"].objects) == 36
    assert len({o.raw_label for s in scenes.values() for o in s.objects}) == 30
    assert len({r.raw_label for s in scenes.values() for r in s.rooms}) == 17


def test_objects_lie_in_the_room_that_is_their_parent(scenes: dict[str, Scene], raw: dict[str, Document]) -> None:
    inside, total = 0, 0
    for scene_id, document in raw.items():
        for entry in document["objects"]:
            if entry["parent_room"] is not None:
                item = scenes[scene_id].object_of[f"{entry['class_']}_{entry['id']}"]
                room = scenes[scene_id].room_of[item.room_id]
                assert room.room_id.endswith(f"_{entry['parent_room']}")
                low, high = room.polygon.min(axis=0) - 1e-3, room.polygon.max(axis=0) + 1e-3
                at = item.center[[0, 2]]
                inside += bool(
                    (low <= at).all() and (at <= high).all() and room.floor_y <= item.center[1] <= room.ceiling_y
                )
                total += 1
    assert (inside, total) == (791, 794)


def test_storeys_are_letters_from_the_lowest(scenes: dict[str, Scene], raw: dict[str, Document]) -> None:
    letters = Counter(r["floor_number"] for d in raw.values() for r in d["rooms"])
    assert letters == {"A": 112, "B": 86, "C": 43, "D": 6}
    for scene in scenes.values():
        floors = {
            level: [r.floor_y for r in scene.rooms if r.level == level] for level in {r.level for r in scene.rooms}
        }
        assert sorted(floors) == list(range(len(floors)))
        for level in range(1, len(floors)):
            assert min(floors[level]) > max(floors[level - 1]) + 1.5


def test_oyens_lies_on_its_navmesh(scenes: dict[str, Scene], real_data: Path) -> None:
    scene = with_shipped_navmesh(scenes["automated/Oyens"], AgentConfig())
    assert scene.navmesh.path == "navmesh/Oyens.navmesh"
    pathfinder = Pathfinder.load(real_data / "gibson" / scene.navmesh.path)
    low, high = read_navmesh(real_data / "gibson" / scene.navmesh.path).tile.bounds

    def within(points: list[np.ndarray], margin: float) -> int:
        return sum(bool((low - margin <= p).all() and (p <= high + margin).all()) for p in points)

    def unmirrored(points: list[np.ndarray]) -> list[np.ndarray]:
        return [p * [1, 1, -1] for p in points]

    rooms = [
        np.array([*(r.polygon.min(0) + r.polygon.max(0)) / 2, (r.floor_y + r.ceiling_y) / 2])[[0, 2, 1]]
        for r in scene.rooms
        if r.polygon is not None
    ]
    objects = [o.center for o in scene.objects]
    assert (within(rooms, 0.3), len(rooms)) == (11, 11)
    assert (within(objects, 1.0), len(objects)) == (37, 37)
    assert (within(unmirrored(rooms), 0.3), within(unmirrored(objects), 1.0)) == (3, 13)
    on_mesh = 0
    for centre in rooms:
        at = np.array([centre[0], 0.2, centre[2]])
        snapped = np.asarray(pathfinder.snap_point(at))
        on_mesh += bool(np.hypot(*(snapped - at)[[0, 2]]) < 0.01)
    assert on_mesh == 8
