"""Gibson buildings made by hand, in both formats."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.scene.tables import scene_tables
from condvln.sources import scene_graph
from condvln.sources.registry import open_source
from condvln.sources.scene_graph import read_npz
from schemas.config import AgentConfig
from schemas.errors import ConfigError, MissingFileError
from tests.condvln.sources.gibson_buildings import as_npz, building, write


def test_a_building_is_turned_upright(tmp_path: Path) -> None:
    scene = write(tmp_path, building()).read("verified/Made")
    assert [(r.room_id, r.label, r.level, r.floor_y, r.ceiling_y, r.complete) for r in scene.rooms] == [
        ("bedroom_1", "bedroom", 0, 0.0, 2.5, True),
        ("dining_room_2", "dining room", 1, 3.0, 5.5, True),
    ]
    assert [scene.rooms[0].polygon.min(0).tolist(), scene.rooms[0].polygon.max(0).tolist()] == [[-1, -5], [3, 1]]
    bed = scene.object_of["bed_1"]
    assert (bed.room_id, bed.label, bed.geometry) == ("bedroom_1", "bed", "aabb")
    assert bed.center.tolist() == [1, 0.5, -2]
    assert bed.aabb.tolist() == [[0, 0, -2.75], [2, 1, -1.25]]
    assert bed.size.tolist() == [2, 1, 1.5]
    assert bed.radius == 1.347


def test_without_a_parent_the_room_is_the_one_around_it(tmp_path: Path) -> None:
    scene = write(tmp_path, building()).read("verified/Made")
    assert scene.object_of["vase_3"].room_id == "dining_room_2"
    assert [(w.code, w.where) for w in scene.warnings] == [("no_parent_room", "vase_3")]
    outside = building()
    outside["objects"][2]["location"] = [90, 0, 0]
    scene = write(tmp_path, outside).read("verified/Made")
    assert "vase_3" not in scene.object_of
    assert ("object_outside_rooms", "vase_3") in {(w.code, w.where) for w in scene.warnings}


def test_the_parent_decides_even_where_the_place_does_not(tmp_path: Path) -> None:
    moved = building()
    moved["objects"][0]["location"] = [1, 2, 3.5]
    assert write(tmp_path, moved).read("verified/Made").object_of["bed_1"].room_id == "bedroom_1"


@pytest.mark.parametrize(("folder", "floor"), [("automated", 0.0), ("verified", -1.2)])
def test_a_box_that_no_person_checked_does_not_lower_its_rooms_floor(tmp_path: Path, folder: str, floor: float) -> None:
    document = building()
    document["rooms"] = [
        {"id": k, "scene_category": label, "location": [5.0 * k, 2, z], "size": [4, 6, height], "floor_number": "A"}
        for k, (label, z, height) in enumerate(
            [
                ("bedroom", 1.25, 2.5),
                ("dining_room", 1.25, 2.5),
                ("kitchen", 0.65, 3.7),
                ("bathroom", 1.0, 2.5),
                ("bedroom", 1.25, 2.5),
            ]
        )
    ]
    for item in document["objects"]:
        item["parent_room"] = 0
    scene = write(tmp_path, document, f"{folder}/Made.scn").read(f"{folder}/Made")
    assert {room.room_id: room.floor_y for room in scene.rooms} == {
        "bedroom_0": 0.0, "dining_room_1": 0.0, "kitchen_2": floor, "bathroom_3": -0.25, "bedroom_4": 0.0
    }  # fmt: skip
    off = [(w.where, w.message) for w in scene.warnings if w.code == "room_off_level"]
    said = "its box begins at -1.2 m: its floor is set to 0 m, as in its level's rooms"
    assert off == ([("kitchen_2", said)] if folder == "automated" else [])


def floors_of(
    tmp_path: Path, boxes: list[tuple[float, float]], levels: list[str | None]
) -> tuple[list[float], list[tuple[str, str]]]:
    """Floors of an automated building's rooms, and the warnings about them; `boxes` are (lowest, highest), metres."""
    document = building()
    document["rooms"] = [
        {"id": k, "scene_category": "bedroom", "location": [5.0 * k, 2, (low + high) / 2], "size": [4, 6, high - low]}
        | ({} if level is None else {"floor_number": level})
        for k, ((low, high), level) in enumerate(zip(boxes, levels, strict=True))
    ]
    for item in document["objects"]:
        item["parent_room"] = 0
    scene = write(tmp_path, document, "automated/Made.scn").read("automated/Made")
    assert all(room.floor_y < room.ceiling_y for room in scene.rooms)
    off = [(w.where, w.message) for w in scene.warnings if w.code == "room_off_level"]
    return [scene.room_of[f"bedroom_{k}"].floor_y for k in range(len(boxes))], off


def test_floors_of_two_storeys_in_one_level_stay(tmp_path: Path) -> None:
    """Their median is a height at which there is no floor."""
    boxes = [(0.0, 2.5), (0.0, 2.5), (-3.0, -0.5), (-3.0, -0.5)]
    assert floors_of(tmp_path, boxes, ["A"] * 4) == ([0.0, 0.0, -3.0, -3.0], [])


def test_rooms_whose_level_is_not_named_keep_their_floors(tmp_path: Path) -> None:
    """Without a name, all storeys of a building count as its lowest level."""
    boxes = [(0.0, 2.5), (0.0, 2.5), (0.0, 2.5), (2.8, 5.0)]
    assert floors_of(tmp_path, boxes, [None] * 4) == ([0.0, 0.0, 0.0, 2.8], [])
    floors, off = floors_of(tmp_path / "named", boxes, ["A"] * 4)
    assert floors == [0.0] * 4
    assert [where for where, _ in off] == ["bedroom_3"]


def test_a_box_below_the_floor_of_its_level_keeps_a_height_and_is_named(tmp_path: Path) -> None:
    floors, off = floors_of(tmp_path, [(0.0, 2.5), (0.0, 2.5), (0.1, 2.5), (-3.0, -0.5)], ["A"] * 4)
    assert floors == [0.0, 0.0, 0.1, -3.0]
    assert off == [("bedroom_3", "its box ends at -0.5 m, below the floor of its level's rooms, 0 m")]


def test_both_formats_give_the_same_scene(tmp_path: Path) -> None:
    json_ = write(tmp_path / "a", building()).read("verified/Made")
    npz = write(tmp_path / "b", building(), "verified/3DSceneGraph_Made.npz").read("verified/Made")
    tables, again = scene_tables(json_), scene_tables(npz)
    assert all(tables[name].equals(again[name]) for name in tables)


def test_real_buildings_survive_the_original_format(real_data: Path) -> None:
    for file in sorted((real_data / "gibson").glob("*/*.scn")):
        document = json.loads(file.read_text())
        again = read_npz(as_npz(document), "x.npz").value
        keys = {"objects": scene_graph.OBJECT_KEYS, "rooms": scene_graph.ROOM_KEYS}
        assert again == {part: [{k: e[k] for k in keys[part]} for e in document[part]] for part in again}


def test_buildings_are_found_in_every_layout(tmp_path: Path) -> None:
    write(tmp_path, building(), "automated_graph/3DSceneGraph_A.npz")
    write(tmp_path, building(), "verified_graph/3DSceneGraph_A.npz")
    write(tmp_path, building(), "verified_graph/A.scn")
    source = write(tmp_path, building(), "B.scn")
    handles = source.handles()
    assert [(h.scene_id, h.inputs[0].path) for h in handles] == [
        ("B", "B.scn"),
        ("automated/A", "automated_graph/3DSceneGraph_A.npz"),
        ("verified/A", "verified_graph/A.scn"),
    ]
    # Nobody checked the automated annotation: absence can't be claimed there.
    assert {r.complete for r in source.read("automated/A").rooms} == {False}
    assert {r.complete for r in source.read("verified/A").rooms} == {True}
    with pytest.raises(MissingFileError):
        source.read("verified/B")


def test_mesh_and_navmesh_beside_it_are_taken(tmp_path: Path, made: Any, glb_of_box: Callable[..., bytes]) -> None:
    source = write(tmp_path, building(), "Made.scn")
    (tmp_path / "Made.glb").write_bytes(glb_of_box([1, 2, 3]))
    (tmp_path / "Made.navmesh").write_bytes((made.root / "navmeshes_default/flat.navmesh").read_bytes())
    scene = with_shipped_navmesh(source.read("Made"), AgentConfig())
    assert (scene.navmesh.path, scene.navmesh.fits) == ("Made.navmesh", True)
    (part,) = scene.stage
    assert part.path == "Made.glb"
    np.testing.assert_array_equal(part.transform[:3, :3] @ [1, 2, 3], [1, 3, -2])
    assert [i.path for i in source.handles()[0].inputs] == ["Made.glb", "Made.navmesh", "Made.scn"]


def test_rooms_are_optional(tmp_path: Path) -> None:
    bare = building()
    del bare["rooms"]
    bare["objects"].append({"id": 4, "class_": "oven"})
    scene = write(tmp_path, bare).read("verified/Made")
    assert [(r.room_id, r.annotation) for r in scene.rooms] == [("building", "scene")]
    assert {o.object_id: o.room_id for o in scene.objects} == dict.fromkeys(
        ["bed_1", "dining table_2", "vase_3"], "building"
    )
    assert "object_without_place" in {w.code for w in scene.warnings}


def test_habitats_own_sample(real_data: Path, tmp_path: Path) -> None:
    file = real_data / "habitat_test_assets" / "dataset_tests" / "GibsonSceneTest" / "GibsonTestScene.scn"
    (tmp_path / "GibsonTestScene.scn").write_bytes(file.read_bytes())
    scene = open_source("gibson", tmp_path).read("GibsonTestScene")
    (microwave,) = scene.objects
    assert (microwave.object_id, microwave.label) == ("microwave_1", "microwave")
    assert sorted(w.code for w in scene.warnings) == ["object_without_place", "object_without_place"]


def test_a_folder_without_buildings_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no buildings"):
        open_source("gibson", tmp_path)
