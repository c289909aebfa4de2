"""Gibson buildings: made ones by hand, in both formats, and every fact that the real ones can tell again."""

from __future__ import annotations

import io
import json
import zipfile
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from condvln.navigation.navmesh_file import read_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Scene
from condvln.scene.tables import scene_from_tables, scene_tables
from condvln.sources import scene_graph
from condvln.sources.registry import open_source
from condvln.sources.scene_graph import read_npz, read_scn
from condvln.sources.source import Source
from schemas.errors import ConfigError, FormatError, InputError, MissingFileError

Document = dict[str, Any]


def building() -> Document:
    """Two storeys of one room each and an object in each, another without a room; z is up."""
    return {
        "objects": [
            {"id": 1, "class_": "bed", "location": [1, 2, 0.5], "size": [2, 1.5, 1], "parent_room": 1,
             "material": ["fabric", None], "floor_area": 7.0, "tactile_texture": None},
            {"id": 2, "class_": "dining table", "location": [1, 2, 3.5], "size": [1, 1, 1], "parent_room": 2},
            {"id": 3, "class_": "vase", "location": [0.5, 2.5, 3.6], "size": [0.2, 0.2, 0.4], "parent_room": None},
        ],
        "rooms": [
            {"id": 1, "scene_category": "bedroom", "location": [1, 2, 1.25], "size": [4, 6, 2.5], "floor_number": "A"},
            {"id": 2, "scene_category": "dining_room", "location": [1, 2, 4.25], "size": [4, 6, 2.5],
             "floor_number": "B"},
        ],
    }  # fmt: skip


def as_npz(document: Document) -> bytes:
    """The same building as 3DSceneGraph has it: one dictionary of dictionaries, arrays for vectors."""

    def entry(fields: Document) -> Document:
        return {k: np.array(v) if k in ("location", "size") else v for k, v in fields.items()}

    graph = {
        "building": {"id": 67, "name": "Made", "voxel_centers": np.zeros((50, 3))},
        "object": {e["id"]: entry(e) for e in document["objects"]},
        "room": {e["id"]: entry(e) for e in document["rooms"]},
        "camera": {},
        "panorama": None,
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, output=np.array(graph, dtype=object))
    return buffer.getvalue()


def write(root: Path, document: Document, path: str = "verified/Made.scn") -> Source:
    file = root / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(json.dumps(document).encode() if path.endswith(".scn") else as_npz(document))
    return open_source("gibson", root)


def test_a_building_is_turned_upright(tmp_path: Path) -> None:
    scene = write(tmp_path, building()).read("verified/Made")
    assert [(r.room_id, r.label, r.level, r.floor_y, r.ceiling_y, r.complete) for r in scene.rooms] == [
        ("bedroom_1", "bedroom", 0, 0.0, 2.5, True),
        ("dining_room_2", "dining room", 1, 3.0, 5.5, True),
    ]
    assert scene.rooms[0].polygon is not None
    assert [scene.rooms[0].polygon.min(0).tolist(), scene.rooms[0].polygon.max(0).tolist()] == [[-1, -5], [3, 1]]
    bed = scene.object_of["bed_1"]
    assert (bed.room_id, bed.label, bed.geometry) == ("bedroom_1", "bed", "aabb")
    assert bed.center.tolist() == [1, 0.5, -2]
    assert bed.aabb is not None
    assert bed.aabb.tolist() == [[0, 0, -2.75], [2, 1, -1.25]]
    assert bed.size is not None
    assert bed.size.tolist() == [2, 1, 1.5]
    assert bed.radius == 1.347


def test_without_a_parent_the_room_is_the_one_around_it(tmp_path: Path) -> None:
    scene = write(tmp_path, building()).read("verified/Made")
    assert scene.object_of["vase_3"].room_id == "dining_room_2"
    assert [(w.code, w.where) for w in scene.warnings] == [("no_navmesh", "navmesh"), ("no_parent_room", "vase_3")]
    outside = building()
    outside["objects"][2]["location"] = [90, 0, 0]
    scene = write(tmp_path, outside).read("verified/Made")
    assert "vase_3" not in scene.object_of
    assert ("object_outside_rooms", "vase_3") in {(w.code, w.where) for w in scene.warnings}


def test_the_parent_decides_even_where_the_place_does_not(tmp_path: Path) -> None:
    moved = building()
    moved["objects"][0]["location"] = [1, 2, 3.5]
    assert write(tmp_path, moved).read("verified/Made").object_of["bed_1"].room_id == "bedroom_1"


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
    scene = source.read("Made")
    assert scene.navmesh is not None
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
    assert sorted(w.code for w in scene.warnings) == ["no_navmesh", "object_without_place", "object_without_place"]


# --- bad input


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"objects": {}}, "objects: an array is expected"),
        ({"objects": [{"class_": "bed"}]}, r"objects\[0\]: the key 'id' is missing"),
        ({"objects": [building()["objects"][0]] * 2}, "two objects have the id 1"),
        ({"rooms": [building()["rooms"][0]] * 2}, "two rooms have the id 1"),
        ({"objects": [building()["objects"][0] | {"parent_room": 9}]}, "there is no room 9"),
        ({"objects": [building()["objects"][0] | {"size": [1, -1, 1]}]}, "below zero"),
        ({"objects": [building()["objects"][0] | {"location": [1, 1]}]}, "3 numbers are expected"),
        ({"objects": [building()["objects"][0] | {"location": [1, 1, None]}]}, "a number is expected"),
        ({"rooms": [{"id": 1, "scene_category": "bedroom"}]}, "no location or no size"),
    ],
)
def test_a_broken_building_is_its_fault_alone(tmp_path: Path, change: Document, message: str) -> None:
    write(tmp_path, building(), "verified/Other.scn")
    source = write(tmp_path, building() | change)
    with pytest.raises(FormatError, match=message) as caught:
        source.read("verified/Made")
    assert caught.value.where == str(tmp_path / "verified/Made.scn")
    assert len(source.read("verified/Other").objects) == 3


def npz_of(member: bytes, name: str = "output.npy", method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        archive.writestr(name, member)
    return buffer.getvalue()


def npy_of(value: Any) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, value, allow_pickle=True)
    return buffer.getvalue()


class Touches:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a sound npz"),
        (b"PK\x03\x04 nonsense", "not a sound npz"),
        (npz_of(b"x", "other.npy"), "holds no output.npy"),
        (npz_of(b"x"), "not a numpy array"),
        (npz_of(b"\x93NUMPY\x01\x00\xff\xff{  }"), "header claims 65535"),
        (npz_of(b"\x93NUMPY\x01\x00\x06\x00[1, 2]"), "header can't be read"),
        (npz_of(npy_of(np.zeros(3))), "not one object"),
        (npz_of(npy_of(np.array([1, 2], dtype=object))), "not one object"),
        (npz_of(npy_of(np.array({"room": {}}, dtype=object))), "no dictionary of each object"),
        (npz_of(npy_of(np.array({"object": {1: {"id": [1] * 9}}, "room": {}}, dtype=object))), "a field is list"),
        (npz_of(npy_of(np.array({"object": {1: {"size": np.zeros(9)}}, "room": {}}, dtype=object))), "9 items where 3"),
        (as_npz(building())[:-30], "not a sound npz"),
    ],
)
def test_a_broken_npz_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        read_npz(data, "folder/x.npz")
    assert caught.value.where == "folder/x.npz"


def test_a_pickle_that_acts_is_refused(tmp_path: Path) -> None:
    graph = {"object": {1: {"id": Touches(tmp_path / "ran")}}, "room": {}}
    file = tmp_path / "verified" / "3DSceneGraph_Bad.npz"
    file.parent.mkdir()
    file.write_bytes(npz_of(npy_of(np.array(graph, dtype=object))))
    with pytest.raises(FormatError, match="the pickle is refused: it asks for"):
        open_source("gibson", tmp_path).read("verified/Bad")
    assert not (tmp_path / "ran").exists()


def test_a_zip_bomb_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_graph, "MAX_GRAPH_BYTES", 1 << 20)
    with pytest.raises(FormatError, match="unpacks to more than"):
        read_npz(npz_of(bytes(64 << 20)), "bomb.npz")


def test_a_folder_without_buildings_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no buildings"):
        open_source("gibson", tmp_path)


def _check(data: st.DataObject) -> None:
    npz = data.draw(st.booleans())
    if npz:
        # Under the checksum of the zip: the member itself is broken, then packed.
        with zipfile.ZipFile(io.BytesIO(as_npz(building()))) as archive:
            bad = bytearray(archive.read("output.npy"))
    else:
        bad = bytearray(json.dumps(building()).encode())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(bad) - 1))
        bad[at : at + data.draw(st.integers(0, 4))] = data.draw(
            st.sampled_from([b"null", b"-1", b"9e999", b"[]"]) | st.binary(max_size=3)
        )
    with suppress(FormatError):
        _ = read_npz(npz_of(bytes(bad)), "x.npz") if npz else read_scn(bytes(bad), "x.scn")


@given(st.data())
def test_broken_bytes_give_a_document_or_our_error(data: st.DataObject) -> None:
    _check(data)


def _read_broken(root: Path, data: st.DataObject) -> None:
    bad = bytearray(json.dumps(building()).encode())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(bad) - 1))
        bad[at : at + data.draw(st.integers(0, 6))] = data.draw(
            st.sampled_from([b"null", b"-1", b"9e999", b"[]", b'""', b"{}"]) | st.binary(max_size=3)
        )
    (root / "B.scn").write_bytes(bytes(bad))
    with suppress(InputError):
        scene_tables(open_source("gibson", root).read("B"))


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_broken_bytes_give_a_building_or_our_error(tmp_path: Path, data: st.DataObject) -> None:
    _read_broken(tmp_path, data)


@pytest.mark.soak
@settings(max_examples=5000, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_broken_bytes_at_full_count(tmp_path: Path, data: st.DataObject) -> None:
    _check(data)
    _read_broken(tmp_path, data)


# --- the real buildings


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
    assert said == {"no_navmesh": 13, "no_parent_room": 17, "object_outside_rooms": 12}
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
                assert room.polygon is not None
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


def test_what_the_files_call_an_area_is_a_perimeter(raw: dict[str, Document]) -> None:
    ratios = [
        r["floor_area"] / (2 * (r["size"][0] + r["size"][1])) for d in raw.values() for r in d["rooms"]
    ]  # fmt: skip
    assert max(ratios) < 1.0 + 1e-9
    assert np.median(ratios) == pytest.approx(0.92, abs=0.02)


def test_oyens_lies_on_its_navmesh(scenes: dict[str, Scene], real_data: Path) -> None:
    scene = scenes["automated/Oyens"]
    assert scene.navmesh is not None
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


def test_scenes_survive_their_tables(scenes: dict[str, Scene]) -> None:
    for scene in scenes.values():
        tables = scene_tables(scene)
        again = scene_tables(scene_from_tables(tables, scene.root, family="gibson"))
        assert all(again[name].equals(tables[name]) for name in tables)
