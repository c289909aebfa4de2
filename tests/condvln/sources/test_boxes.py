"""Own scenes as boxes: the documented example, both frames, and every fault of a file in one message."""

from __future__ import annotations

import copy
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from condvln.scene.boxes import box_corners
from condvln.scene.scene import STRUCTURE
from condvln.sources.registry import open_source
from schemas.errors import ConfigError, FormatError, InputError
from tests.broken_bytes import broken, spoiled

Document = dict[str, Any]
PAGE = Path(__file__).parents[3] / "docs" / "boxes.md"


@pytest.fixture
def lab() -> Document:
    """The example of docs/boxes.md."""
    (text,) = re.findall(r"^```json\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    return dict(json.loads(text))


def read(folder: Path, document: Document | bytes | str) -> Any:
    data = document if isinstance(document, bytes) else document.encode() if isinstance(document, str) else None
    (folder / "lab.json").write_bytes(json.dumps(document).encode() if data is None else data)
    return open_source("boxes", folder)


def test_the_example_is_read_as_it_is_written(tmp_path: Path, lab: Document) -> None:
    source = read(tmp_path, lab)
    assert source.scene_ids() == ["lab"]
    scene = source.read("lab")
    assert [(room.room_id, room.label) for room in scene.rooms] == [("kitchen 1", "kitchen"), ("office 0", "office")]
    assert len(scene.objects) == len(lab["objects"])
    assert {o.room_id for o in scene.objects if o.center[0] < 5} == {"office 0"}
    shelf = scene.object_of["bookshelf 3"]
    assert shelf.aabb.tolist() == [[0.025, 0.0, 2.2], [0.375, 2.0, 3.4]]
    assert scene.object_of["laptop 1"].support == "desk 0"
    assert not scene.warnings


def turned(lab: Document) -> Document:
    """The same scene with z up."""
    found = copy.deepcopy(lab)
    found["up"] = "z"
    for room in found["rooms"]:
        room["polygon"] = [[x, -z] for x, z in room["polygon"]]
    for door in found["doors"]:
        door["from"][1], door["to"][1] = -door["from"][1], -door["to"][1]
    for item in found["objects"]:
        (x, y, z), (a, b, c) = item["center"], item["size"]
        item["center"], item["size"] = [x, -z, y], [a, c, b]
    return found


def test_z_up_is_the_same_scene(tmp_path: Path, lab: Document) -> None:
    one, source = read(tmp_path, lab).read("lab"), read(tmp_path, turned(lab))
    two = source.read("lab")
    for a, b in zip(one.objects, two.objects, strict=True):
        assert (a.object_id, a.room_id) == (b.object_id, b.room_id)
        np.testing.assert_allclose(box_corners(a.obb), box_corners(b.obb), atol=2e-9)
    for a, b in zip(one.rooms, two.rooms, strict=True):
        assert a.polygon.tolist() == b.polygon.tolist()
    np.testing.assert_allclose(source.geometry(two).vertices, read(tmp_path, lab).geometry(one).vertices, atol=2e-9)


def test_yaw_turns_counter_clockwise_seen_from_above(tmp_path: Path, lab: Document) -> None:
    lab["objects"] = [{"label": "desk", "center": [2, 0.5, 2], "size": [2, 1, 0.2], "yaw": 45}]
    (desk,) = read(tmp_path, lab).read("lab").objects
    corners = box_corners(desk.obb)[:, [0, 2]] - [2, 2]
    # its long side runs from the south-west to the north-east: north is −z
    assert all(x * z < 0 for x, z in corners)


def walls(geometry: Any) -> Any:
    """The ground plan of all upright faces of the structure."""
    own = geometry.vertices[geometry.faces[geometry.owner == STRUCTURE]]
    return shapely.union_all([shapely.LineString(t[:, [0, 2]]) for t in own if np.ptp(t[:, 1]) > 0.1])


@pytest.mark.parametrize("gap", [0.0, 0.2])
def test_doors_open_the_walls_and_floor_them(tmp_path: Path, lab: Document, gap: float) -> None:
    """Whether the rooms meet or leave the thickness of a wall between them."""
    for corner in lab["rooms"][1]["polygon"]:
        corner[0] += gap
    lab["doors"] = [{"from": [5 + gap / 2, 1.5], "to": [5 + gap / 2, 2.5], "height": 2.0}]
    lab["objects"] = []
    source = read(tmp_path, lab)
    geometry = source.geometry(source.read("lab"))
    flat = [
        shapely.Polygon(t[:, [0, 2]])
        for t in geometry.vertices[geometry.faces]
        if np.ptp(t[:, 1]) == 0 and t[0, 1] == 0
    ]
    way = shapely.LineString([(4, 2), (6, 2)])
    assert shapely.union_all(flat).buffer(1e-6).covers(way)
    low = geometry.vertices[geometry.faces][(geometry.vertices[geometry.faces][:, :, 1] < 1).any(axis=1)]
    upright = [shapely.LineString(t[:, [0, 2]]) for t in low if np.ptp(t[:, 1]) > 0.1]
    assert not any(line.intersects(way) for line in upright)
    assert walls(geometry).intersects(shapely.LineString([(4, 1), (6, 1)]))


def test_without_doors_and_walls_rooms_are_open(tmp_path: Path, lab: Document) -> None:
    del lab["doors"]
    source = read(tmp_path, lab)
    scene = source.read("lab")
    assert [w.code for w in scene.warnings] == ["no_walls"]
    assert (source.geometry(scene).owner == STRUCTURE).sum() == 4  # two floors of two triangles
    lab["walls"] = [{"from": [5, 0], "to": [5, 3]}]
    source = read(tmp_path, lab)
    scene = source.read("lab")
    assert not scene.warnings
    assert walls(source.geometry(scene)).bounds == pytest.approx((4.99, 0, 5.01, 3))


def message(folder: Path, document: Document | bytes | str) -> str:
    source = read(folder, document)
    with pytest.raises(FormatError) as caught:
        source.read("lab")
    (handle,) = source.handles()
    assert str(handle.fault) == str(caught.value), "the listing says the same"
    assert str(folder / "lab.json") in str(caught.value)
    assert caught.value.remedy
    return str(caught.value)


def test_all_wrong_keys_of_a_file_are_in_one_message(tmp_path: Path, lab: Document) -> None:
    del lab["rooms"][0]["label"], lab["objects"][2]["size"]
    lab["rooms"][1]["polygon"] = [[0, 0], [1, 1], [1, 0], [0, 1]]
    lab["objects"][0]["center"] = [1, 2]
    lab["objects"][1]["size"] = [1, -1, "2"]
    lab["objects"][3]["colour"] = "red"
    lab["objects"][4]["yaw"] = True
    lab["doors"][0]["to"] = lab["doors"][0]["from"]
    lab["up"] = "x"
    said = message(tmp_path, lab)
    for place in (
        "rooms[0].label: the key is missing",
        "rooms[1].polygon: the polygon is not simple (Self-intersection",
        "objects[0].center[2]: the key is missing",
        "objects[1].size[1]: ",
        "objects[1].size[2]: ",
        "objects[2].size: the key is missing",
        "objects[3].colour: there is no such key",
        "objects[4].yaw: ",
        "doors[0].to: it is shorter than 1 cm",
        "up: ",
    ):
        assert place in said
    assert "pydantic" not in said


def test_all_wrong_references_of_a_file_are_in_one_message(tmp_path: Path, lab: Document) -> None:
    lab["objects"][0]["room"] = "cellar"
    lab["objects"][1]["id"] = "fridge 8"
    lab["rooms"][1]["id"] = "office 0"
    lab["objects"][2]["center"] = [9000, 0, 0]
    said = message(tmp_path, lab)
    assert "objects[0].room: there is no room 'cellar'" in said
    assert "2 of the objects have the id 'fridge 8'" in said
    assert "2 of the rooms have the id 'office 0'" in said
    assert "9000 m long" in said


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999", "1e300", "-1e10", '"1"', "[1]", "true"])
def test_hostile_numbers(tmp_path: Path, lab: Document, number: str) -> None:
    for spot in ("0.375", "2.05", "30"):
        lab["doors"][0]["height"] = 2.05
        message(tmp_path, re.sub(rf"(?<=[ \[]){re.escape(spot)}(?=[,\]}}])", number, json.dumps(lab), count=1))


@pytest.mark.parametrize(
    "data", [b"", b"[]", b"{", b'{"rooms": [], "objects": []}', b'{"objects": []}', b"\xff", b"[" * 100_000]
)
def test_files_that_are_no_scene(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "good").mkdir()
    (tmp_path / "lab.json").write_bytes(data)
    with pytest.raises(InputError):
        open_source("boxes", tmp_path).read("lab")


def test_other_json_is_passed_over_and_a_folder_without_any_is_refused(tmp_path: Path, lab: Document) -> None:
    with pytest.raises(ConfigError, match=r"docs/boxes\.md"):
        open_source("boxes", tmp_path)
    source = read(tmp_path, lab)
    (tmp_path / "notes.json").write_text('{"todo": []}')
    assert source.scene_ids() == ["lab"]
    assert [path for path, _ in source.passed_over()] == ["notes.json"]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_spoiled_file_is_read_or_refused(tmp_path: Path, lab: Document, data: st.DataObject) -> None:
    whole = data.draw(st.booleans())
    if whole:
        source = read(tmp_path, json.dumps(spoiled(lab, data)))
    else:
        source = read(tmp_path, broken(data, json.dumps(lab).encode(), [b"1e9", b"-", b"[", b'"', b"NaN", b"0"]))
    try:
        source.geometry(source.read("lab"))
    except InputError as caught:
        error = caught
    else:
        return
    assert "lab.json" in str(error)
