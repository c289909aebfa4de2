"""AI2-THOR's scenes, made by hand: rooms, boxes, and what is broken."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from condvln.formats.json_document import parse_json
from condvln.scene.boxes import box_corners
from condvln.scene.rotations import to_matrix
from condvln.scene.tables import scene_tables
from condvln.sources.registry import open_source
from condvln.sources.thor import room_type
from condvln.sources.thor_metadata import read_objects
from schemas.errors import ConfigError, FormatError, InputError, MissingFileError, PathEscapeError
from tests.broken_bytes import broken, spoiled
from tests.condvln.sources.thor_plans import Document, apartment, corner_points, plan, thing, write


def test_a_plan_is_one_room_of_the_type_of_its_number(tmp_path: Path) -> None:
    scene = write(tmp_path, plan()).read("FloorPlan207")
    (room,) = scene.rooms
    assert (room.room_id, room.raw_label, room.label, room.annotation) == (
        "room",
        "LivingRoom",
        "living room",
        "dataset",
    )
    assert (room.floor_y, room.ceiling_y, room.complete) == (0.0, 2.0, True)
    assert room.polygon.tolist() == [[-1, -5], [-1, 1], [3, 1], [3, -5]]
    sofa = scene.object_of["Sofa|+01.00"]
    assert sofa.center.tolist() == [1, 0.4, -3]
    assert sofa.aabb.tolist() == [[0, 0, -3.5], [2, 0.8, -2.5]]
    assert (sofa.label, sofa.static, sofa.geometry) == ("sofa", False, "aabb")
    assert scene.object_of["Window|+01.00"].static
    assert {o.room_id for o in scene.objects} == {"room"}
    assert not scene.warnings


@pytest.mark.parametrize(
    ("name", "label"),
    [
        *((f"FloorPlan{n}", "Kitchen") for n in (1, 6, 30)),
        *((f"FloorPlan{n}", "LivingRoom") for n in (201, 230)),
        *((f"FloorPlan{n}", "Bedroom") for n in (301, 330)),
        *((f"FloorPlan{n}", "Bathroom") for n in (401, 430)),
        *((n, "unknown") for n in ("FloorPlan31", "FloorPlan0", "FloorPlan231", "FloorPlan_Train1_1", "x")),
    ],
)
def test_room_types_by_number(name: str, label: str) -> None:
    assert room_type(name) == label


def test_robothor_has_no_rooms(tmp_path: Path) -> None:
    scene = write(tmp_path, plan("FloorPlan_Val1_1_physics"), "FloorPlan_Val1_1.json", "robothor").read(
        "FloorPlan_Val1_1"
    )
    assert [(r.label, r.annotation) for r in scene.rooms] == [("apartment", "scene")]


def test_drawn_rooms_take_the_place_of_the_one(tmp_path: Path) -> None:
    write(tmp_path, plan())
    zones = [
        {"name": "a", "label": "kitchen", "poly_loop": [[-1, 0, -5], [3, 0, -5], [3, 0, -4], [-1, 0, -4]]},
        {"name": "b", "label": "living room", "poly_loop": [[-1, 0, -4], [3, 0, -4], [3, 0, 1], [-1, 0, 1]]},
    ]
    (tmp_path / "zones.json").write_text(json.dumps({"region_annotations": zones}))
    source = open_source("ithor", tmp_path, regions=tmp_path / "zones.json")
    scene = source.read("FloorPlan207")
    assert [(r.room_id, r.annotation) for r in scene.rooms] == [("a", "user"), ("b", "user")]
    assert scene.object_of["Sofa|+01.00"].room_id == "b"
    assert "regions/zones.json#region_annotations" in {i.path for i in source.handles()[0].inputs}


sides = st.floats(0, 3).map(lambda v: round(v, 3))
turns = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(v * v for v in q) > 0.01)


@given(st.tuples(sides, sides, sides).filter(lambda s: max(s) > 0.05), turns)
def test_oriented_boxes_are_those_of_the_corners(size: tuple[float, float, float], turn: tuple[float, ...]) -> None:
    edges = (to_matrix(turn) * np.array(size)).T
    centre = np.array([1.0, 2.0, 3.0])
    corners = corner_points(centre, edges)
    reach = (np.max(corners, axis=0) - np.min(corners, axis=0)).tolist()
    item = thing("a", "Box", (1, 2, 3), tuple(reach), objectOrientedBoundingBox={"cornerPoints": corners})
    document = parse_json(json.dumps({"objects": [item]}).encode(), "x.json")
    (read,) = read_objects(document, "ithor")
    expected = np.array(corners) * [1, 1, -1]
    got = box_corners(read.obb)
    assert np.linalg.norm(expected[:, None] - got[None], axis=2).min(axis=1).max() < 0.003
    assert np.linalg.det(read.obb.rotation) == pytest.approx(1)


def test_eight_points_that_are_no_box_are_passed_over(tmp_path: Path) -> None:
    sheared = corner_points(np.zeros(3), np.array([[1, 0, 0], [0.5, 1, 0], [0, 0, 1]]))
    bent = corner_points(np.zeros(3), np.eye(3))
    bent[6] = [5, 5, 5]
    document = plan()
    for item, corners in zip(document["objects"], (sheared, bent), strict=False):
        item["objectOrientedBoundingBox"] = {"cornerPoints": corners}
    scene = write(tmp_path, document).read("FloorPlan207")
    assert [o.geometry for o in scene.objects] == ["aabb"] * 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"objects": [plan()["objects"][0]] * 2}, r"two objects have the id 'Floor|+00.00'"),
        ({"objects": [{"objectId": "axisAlignedBoundingBox"}]}, "'objectType' is missing"),
        ({"objects": [thing("a", "Door", (1, 1, 1), (1, -1, 1))]}, "negative"),
        ({"objects": [thing("a", "Box", (1, 1, 1), (1, 1, 1), moveable=3)]}, "true or false"),
        (
            {"objects": [thing("a", "Box", (1, 1, 1), (1, 1, 1), objectOrientedBoundingBox={"cornerPoints": []})]},
            "eight corners are expected, not 0",
        ),
        ({"sceneName": 3}, "text is expected"),
    ],
)
def test_a_broken_scene_is_its_fault_alone(tmp_path: Path, change: Document, message: str) -> None:
    write(tmp_path, plan("FloorPlan1"), "FloorPlan1.json")
    source = write(tmp_path, plan() | change)
    with pytest.raises(FormatError, match=message.replace("|", r"\|").replace("+", r"\+")) as caught:
        source.read("FloorPlan207")
    assert caught.value.where == str(tmp_path / "FloorPlan207.json")
    assert len(source.read("FloorPlan1").objects) == 3
    assert [h.scene_id for h in source.handles()] == ["FloorPlan1", "FloorPlan207"]


def test_a_thing_of_negative_size_costs_its_extent_alone(tmp_path: Path) -> None:
    document = plan()
    document["objects"].append(thing("a", "Box", (1, 1, 1), (1, -1, 1)))
    source = write(tmp_path, document)
    scene = source.read("FloorPlan207")
    assert len(scene.objects) == 4
    spoilt = scene.object_of["a"]
    assert (spoilt.aabb, spoilt.obb, spoilt.size, spoilt.radius) == (None, None, None, None)
    assert spoilt.center.tolist() == [1, 1, -1]
    assert [(w.code, w.where) for w in scene.warnings] == [("no_box", "a")]
    source.geometry(scene)
    scene_tables(scene)


def test_a_scene_cut_short_emptied_or_out_of_reach_is_neither_passed_over_nor_the_end_of_the_others(
    tmp_path: Path,
) -> None:
    root = tmp_path / "data"
    root.mkdir()
    source = write(root, plan("FloorPlan1"), "FloorPlan1.json")
    (root / "FloorPlan2.json").write_text('{"objects": [{"objectId": "a')
    (root / "FloorPlan3.json").write_text(json.dumps(plan("FloorPlan3") | {"objects": []}))
    (tmp_path / "elsewhere.json").write_text("{}")
    (root / "FloorPlan4.json").symlink_to(tmp_path / "elsewhere.json")
    (root / "mine.json").symlink_to(tmp_path / "elsewhere.json")
    (root / "FloorPlan5.json").mkdir()
    (root / "FloorPlan1-notes.json").write_text("{}")
    faults = {handle.scene_id: handle.fault for handle in source.handles()}
    assert [*faults] == ["FloorPlan1", "FloorPlan2", "FloorPlan3", "FloorPlan4", "mine"]
    assert {scene for scene, fault in faults.items() if isinstance(fault, PathEscapeError)} == {"FloorPlan4", "mine"}
    with pytest.raises(FormatError, match=r"FloorPlan2\.json.*not JSON"):
        source.read("FloorPlan2")
    assert source.read("FloorPlan3").objects == ()
    assert len(source.read("FloorPlan1").objects) == 3


def test_other_json_is_not_listed(tmp_path: Path) -> None:
    (tmp_path / "episodes.json").write_text("[]")
    with pytest.raises(ConfigError, match="no controller metadata"):
        open_source("ithor", tmp_path)
    source = write(tmp_path, plan())
    assert [h.scene_id for h in source.handles()] == ["FloorPlan207"]
    with pytest.raises(MissingFileError):
        source.read("episodes")


TOKENS = [b"null", b"-1", b"9e999", b"[]", b'""', b"{}", b"NaN", b"", b"\xff", b"\\u", b'"', b"\0"]

# A scene of each family: iTHOR's one room; RoboTHOR's panels, one of them turned, from which its walls are built.
BROKEN = {
    "ithor": ("FloorPlan2", plan("FloorPlan2")),
    "robothor": ("FloorPlan_Val1_1", apartment("FloorPlan_Val1_1")),
}


@pytest.fixture
def outcomes() -> Iterator[Counter[str]]:
    """Of one property: some of its files are read, and some are refused."""
    found = Counter[str]()
    yield found
    assert min(found["read"], found["refused"]) > 5, found


@pytest.mark.rounds(13)
@pytest.mark.parametrize("family", sorted(BROKEN))
@settings(max_examples=120, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_broken_files_give_a_scene_or_our_error(
    tmp_path: Path, family: str, outcomes: Counter[str], data: st.DataObject
) -> None:
    name, document = BROKEN[family]
    in_bytes = data.draw(st.booleans())
    bad = json.dumps(document if in_bytes else spoiled(document, data)).encode()
    write(tmp_path, plan())
    (tmp_path / f"{name}.json").write_bytes(broken(data, bad, TOKENS) if in_bytes else bad)
    try:
        source = open_source(family, tmp_path)
        scene = source.read(name)
        outcomes["read"] += 1
        scene_tables(scene)
        source.geometry(scene)
    except InputError:
        outcomes["refused"] += 1
