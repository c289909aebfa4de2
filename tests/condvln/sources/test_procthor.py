"""ProcTHOR houses made by hand: their frame, rooms, doors and faults."""

from __future__ import annotations

import gzip
import json
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.scene.boxes import box_corners
from condvln.scene.tables import scene_tables
from condvln.sources.registry import open_source
from schemas.config import AgentConfig
from schemas.errors import ConfigError, FormatError, InputError, MissingFileError
from tests.broken_bytes import broken
from tests.condvln.sources.procthor_houses import (
    DATABASE,
    House_,
    floor,
    house,
    leads_out,
    parsed,
    passages_of,
    write,
    xyz,
)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "asset-database.json").write_text(json.dumps(DATABASE))
    return tmp_path


def test_a_house_is_mirrored_into_habitats_frame(root: Path) -> None:
    scene = write(root, house()).read("train-0")
    assert [(r.room_id, r.label, r.annotation, r.complete, r.floor_y, r.ceiling_y) for r in scene.rooms] == [
        ("room|2", "kitchen", "dataset", True, 0.0, 3.0),
        ("room|3", "bedroom", "dataset", True, 0.0, 3.0),
    ]
    assert scene.rooms[0].polygon.tolist() == [[0, 0], [0, -3], [4, -3], [4, 0]]
    assert shapely.LinearRing(scene.rooms[0].polygon).is_ccw
    table = scene.object_of["2|0"]
    assert (table.label, table.raw_label, table.room_id, table.static) == (
        "dining table",
        "DiningTable",
        "room|2",
        True,
    )
    assert table.center.tolist() == [2, 0.4, -1]
    # Turned by 90°: its sides are swapped.
    assert table.aabb.tolist() == [[1.5, 0.0, -1.8], [2.5, 0.8, -0.2]]
    assert [w.code for w in scene.warnings] == []


def test_a_tilted_thing_is_turned_as_unity_turns_it(root: Path) -> None:
    bat = write(root, house()).read("train-0").object_of["3|1"]
    # Unity: pitch by 270° about x lays the bat's own y along −z (left-handed), then yaw by 30° clockwise from above.
    along = np.array([-np.sin(np.radians(30)), 0, np.cos(np.radians(30))])
    assert abs(bat.obb.rotation[:, 1] @ along) == pytest.approx(1, abs=1e-8)
    assert bat.aabb[:, 1].tolist() == [0.98, 1.02]
    reach = np.abs(box_corners(bat.obb) - bat.center).max(axis=0)
    np.testing.assert_allclose(bat.aabb[1] - bat.center, reach, atol=0.0011)


def test_children_are_in_their_parents_room(root: Path) -> None:
    made = house()
    made["objects"][0]["children"][0]["position"] = xyz(4.05, 0.85, 1)
    scene = write(root, made).read("train-0")
    assert scene.object_of["2|0|0"].room_id == "room|2"


def test_doors_stand_in_the_world_along_their_first_wall() -> None:
    read = parsed(house())
    door, window = read.openings
    # wall0 runs from z 3 to z 0, so 0.5–1.5 along it is z 2.5–1.5; in Habitat −2.5 … −1.5.
    assert (door.start.tolist(), door.end.tolist()) == ([4, -2.5], [4, -1.5])
    assert (door.bottom, door.top, door.kind, door.passable, leads_out(door)) == (0, 2, "door", True, False)
    # An exterior wall lists its upper corners first.
    assert (window.start.tolist(), window.end.tolist(), window.bottom) == ([1, 0], [3, 0], 1)
    assert (window.kind, window.passable, leads_out(window)) == ("window", False, True)
    assert passages_of(read) == {("room|2", "room|3")}


@pytest.mark.parametrize(
    ("change", "passages"),
    [
        ({"openness": 0}, set()),
        ({"openness": 0, "assetId": "Doorframe_2"}, {("room|2", "room|3")}),
        ({"openness": None}, set()),
        ({"openness": None, "assetId": "Doorframe_Double_3"}, {("room|2", "room|3")}),
        ({"openness": None, "open": None}, set()),
        ({"openness": None, "open": False}, set()),
        ({"openness": None, "open": True}, {("room|2", "room|3")}),
        ({"openness": None, "open": False, "assetId": "Doorframe_2"}, {("room|2", "room|3")}),
        ({"openness": 1, "open": False}, {("room|2", "room|3")}),
        ({"openness": 0, "open": True}, set()),
        ({"openness": 1e-9, "open": False}, {("room|2", "room|3")}),
        ({"openness": -1}, set()),
        ({"room1": "room|2"}, set()),
        ({"room1": None, "wall1": None}, set()),
        ({"room0": None}, set()),
    ],
)
@pytest.mark.parametrize("absent", [False, True])
def test_a_closed_or_outer_door_is_no_passage(change: House_, passages: set[tuple[str, str]], absent: bool) -> None:
    made = house()
    made["doors"][0] |= change
    if absent:  # a key that is not there says what null says
        made["doors"][0] = {key: value for key, value in made["doors"][0].items() if value is not None}
    assert passages_of(parsed(made)) == passages
    assert parsed(made).openings[0].passable == (bool(passages) or "openness" not in change)


def test_a_wall_taken_away_is_a_passage_without_a_door() -> None:
    made = house()
    made["doors"] = []
    assert passages_of(parsed(made)) == set()
    for face in made["walls"][:2]:
        face["empty"] = True
    assert passages_of(parsed(made)) == {("room|2", "room|3")}


def test_the_older_schema_says_the_same() -> None:
    new, old = house(), house()
    del old["metadata"]
    for opening in old["doors"] + old["windows"]:
        low, high = opening.pop("holePolygon")
        opening.pop("assetPosition")
        opening |= {"boundingBox": {"min": low, "max": high}, "assetOffset": xyz(0, 0, 0)}
    for face in old["walls"]:
        face["material"] = "RedDrywall"
    for a, b in zip(parsed(new).openings, parsed(old).openings, strict=True):
        assert (a.opening_id, a.rooms, a.bottom, a.top, a.passable) == (
            b.opening_id,
            b.rooms,
            b.bottom,
            b.top,
            b.passable,
        )
        assert (a.start.tolist(), a.end.tolist()) == (b.start.tolist(), b.end.tolist())


def test_an_asset_that_the_database_lacks_has_no_extent(root: Path) -> None:
    made = house()
    made["objects"][1] |= {"assetId": "0123abcd" * 4}
    made["objects"].append({"id": "Dresser|3|7", "assetId": "ff", "position": xyz(5, 0.5, 1), "rotation": xyz(0, 0, 0)})
    scene = write(root, made).read("train-0")
    unknown, dresser = scene.object_of["3|1"], scene.object_of["Dresser|3|7"]
    assert (unknown.geometry, unknown.label) == ("none", "unknown")
    assert (dresser.geometry, dresser.label) == ("none", "dresser")
    assert Counter(w.code for w in scene.warnings) == {"unknown_asset": 2}
    # An unnamed thing could be anything: nothing may be said to be absent beside it.
    assert {r.room_id: r.complete for r in scene.rooms} == {"room|2": True, "room|3": False}
    made["objects"][1]["objectType"] = "Bed"
    assert write(root, made).read("train-0").object_of["3|1"].label == "bed"


def test_the_generators_own_warning_is_kept(root: Path) -> None:
    made = house()
    made["metadata"]["warnings"] = {"RoomsNotNavigable": "Rooms [2] / 3 are not navigable."}
    (warning,) = sorted(write(root, made).read("train-0").warnings, key=lambda w: w.code, reverse=True)
    assert (warning.code, warning.message) == ("rooms_not_navigable", "Rooms [2] / 3 are not navigable.")


def test_a_shipped_navmesh_is_found(root: Path, made: Any) -> None:
    source = write(root, house())
    made.navmesh("n/x.navmesh", 0.1)
    (root / "navmeshes").mkdir()
    (root / "navmeshes" / "train-0.navmesh").write_bytes((made.root / "n/x.navmesh").read_bytes())
    scene = with_shipped_navmesh(source.read("train-0"), AgentConfig())
    assert (scene.navmesh.path, scene.navmesh.fits) == ("navmeshes/train-0.navmesh", True)
    assert "navmeshes/train-0.navmesh" in {i.path for i in source.handles()[0].inputs}


@pytest.mark.parametrize("name", ["train.jsonl", "train.jsonl.gz", "sub/train.jsonl"])
def test_files_of_lines_are_found_and_read(root: Path, name: str) -> None:
    (root / "sub").mkdir()
    source = write(root, house(), house() | {"rooms": []}, house(), name=name)
    stem = name.removesuffix(".gz").removesuffix(".jsonl")
    handles = source.handles()
    assert [h.scene_id for h in handles] == [f"{stem}-0", f"{stem}-1", f"{stem}-2"]
    assert {i.path for i in handles[2].inputs} == {
        f"{name}#2", *(f"asset-database.json#{a}" for a in ("Table_1", "Mug_1", "Bat_1"))
    }  # fmt: skip
    assert source.read(f"{stem}-1").objects == ()
    assert len(source.read(f"{stem}-2").objects) == 3
    for wrong in (f"{stem}-3", f"{stem}-02", f"{stem}", "other-0"):
        with pytest.raises(MissingFileError):
            source.read(wrong)


@pytest.mark.parametrize("begin", [b"", b"\xef\xbb\xbf", b" \n"])
def test_a_list_of_houses_in_one_file(root: Path, begin: bytes) -> None:
    houses = [house(), house() | {"doors": [{}]}, house()]
    text = json.dumps(houses).replace('"kinematic": true', '"kinematic": true, "kinematic": true')
    (root / "hall.json").write_bytes(begin + text.encode())
    (root / "list.json").write_text("[1, {}]")
    source = open_source("procthor", root)
    assert [h.scene_id for h in source.handles()] == ["hall-0", "hall-1", "hall-2"]
    assert ("list.json", "none of its 2 entries is a house") in source.passed_over()
    # What is wrong with one house costs this house, and a repeated key each that has it.
    with pytest.raises(FormatError, match=r"hall.json#1.*kinematic.*twice"):
        source.read("hall-1")
    (root / "hall.json").write_bytes(begin + json.dumps(houses).encode())
    with pytest.raises(FormatError, match=r"hall.json#1.*doors\[0\]"):
        source.read("hall-1")
    assert len(source.read("hall-2").objects) == 3
    assert source.handles()[0].inputs[0].path == "asset-database.json#Bat_1"
    assert {i.path for i in source.handles()[2].inputs if "hall" in i.path} == {"hall.json#2"}
    for wrong in ("hall-3", "hall-02", "other-0"):
        with pytest.raises(MissingFileError):
            source.read(wrong)


def test_a_changed_house_of_a_list_is_stale_alone(root: Path) -> None:
    (root / "hall.json").write_text(json.dumps([house(), house()]))
    source = open_source("procthor", root)
    before = {h.scene_id: h.inputs for h in source.handles()}
    changed = house()
    changed["objects"][0]["position"]["x"] = 2.5
    (root / "hall.json").write_text(json.dumps([house(), changed]))
    after = {h.scene_id: h.inputs for h in source.handles()}
    assert [s for s in before if before[s] != after[s]] == ["hall-1"]


def test_a_name_that_is_not_read_is_said(root: Path) -> None:
    (root / "a.json.gz").write_bytes(gzip.compress(json.dumps(house()).encode()))
    source = write(root, house())
    source.handles()
    assert source.passed_over() == [("a.json.gz", "its name does not end in .json, .jsonl or .jsonl.gz")]


def test_one_changed_line_makes_one_house_stale(root: Path) -> None:
    before = {h.scene_id: h.inputs for h in write(root, house(), house(), house()).handles()}
    changed = house()
    changed["objects"][0]["position"]["x"] = 2.5
    after = {h.scene_id: h.inputs for h in write(root, house(), changed, house()).handles()}
    assert [s for s in before if before[s] != after[s]] == ["train-1"]
    other = json.loads(json.dumps(DATABASE))
    other["Mug"].append({"assetId": "Mug_2", "objectType": "Mug", "boundingBox": xyz(1, 1, 1)})
    (root / "asset-database.json").write_text(json.dumps(other))
    assert {h.scene_id: h.inputs for h in write(root, house(), changed, house()).handles()} == after


# --- bad input


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rooms": {}}, "rooms: an array is expected"),
        ({"metadata": {"schema": "2.0.0"}}, "houses of schema '2.0.0' are not read, only those of 0.0.1 and 1.0.0"),
        ({"objects": [{"id": "a"}]}, r"objects\[0\]: the key"),
        ({"objects": [house()["objects"][1]] * 2}, "two of the objects have the id '3|1'"),
        ({"rooms": [house()["rooms"][0]] * 2}, "two of the rooms have the id 'room|2'"),
        ({"doors": [house()["doors"][0] | {"wall0": "wall|9"}]}, "there is no wall 'wall|9'"),
        ({"rooms": [house()["rooms"][0] | {"floorPolygon": floor(0, 0, 0, 3)}]}, "not simple"),
        ({"rooms": [house()["rooms"][0] | {"floorPolygon": []}]}, "at least three corners"),
        ({"objects": [house()["objects"][1] | {"position": xyz(0, 1e9, 0)}]}, "beyond"),
    ],
)
def test_a_broken_house_is_its_fault_alone(root: Path, change: House_, message: str) -> None:
    source = write(root, house(), house() | change)
    assert [h.scene_id for h in source.handles()] == ["train-0", "train-1"]
    with pytest.raises(FormatError, match=message.replace("|", r"\|")) as caught:
        source.read("train-1")
    assert caught.value.where == f"{root / 'train.jsonl'}#1"
    assert len(source.read("train-0").objects) == 3


def test_a_missing_database_is_named(root: Path) -> None:
    (root / "asset-database.json").unlink()
    source = write(root, house())
    # Once for the source, not once a scene.
    with pytest.raises(ConfigError, match="the asset database does not exist") as caught:
        source.handles()
    assert "asset-database.json" in caught.value.where
    with pytest.raises(MissingFileError, match="the asset database does not exist"):
        source.read("train-0")
    (root / "asset-database.json").write_text(json.dumps(DATABASE))
    assert source.handles()[0].fault is None
    assert len(source.read("train-0").objects) == 3


def test_a_folder_without_houses_is_one_clear_error(root: Path) -> None:
    with pytest.raises(ConfigError, match="no houses"):
        open_source("procthor", root)


TOKENS = [b"-1", b"1e999", b"null", b"true", b"{}", b"[]", b'""', b"NaN", b"0", b"9" * 30, b'"\\ud800"', b"\\u0000"]


@pytest.mark.rounds(25)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_broken_bytes_give_a_house_or_our_error(root: Path, data: st.DataObject) -> None:
    bad = broken(data, json.dumps(house()).encode(), TOKENS, 8)
    (root / "a.jsonl").write_bytes(bad.replace(b"\n", b" "))
    source = open_source("procthor", root)
    for handle in source.handles():
        with suppress(InputError):
            scene = source.read(handle.scene_id)
            assert handle.fault is None
            scene_tables(scene)
            source.geometry(scene)
