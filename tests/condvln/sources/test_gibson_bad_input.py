"""Bad input in buildings: each is its own fault alone, and no pickle acts."""

from __future__ import annotations

import io
import json
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from condvln.scene.tables import scene_tables
from condvln.sources.registry import open_source
from condvln.sources.scene_graph import read_npz
from schemas.errors import FormatError, InputError
from tests.broken_bytes import broken
from tests.condvln.sources.gibson_buildings import Document, as_npz, building, write


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"objects": {}}, "objects: an array is expected"),
        ({"objects": [{"class_": "bed"}]}, r"objects\[0\]: the key 'id' is missing"),
        ({"objects": [building()["objects"][0]] * 2}, "two objects have the id 1"),
        ({"rooms": [building()["rooms"][0]] * 2}, "two rooms have the id 1"),
        ({"objects": [building()["objects"][0] | {"parent_room": 9}]}, "there is no room 9"),
        ({"objects": [building()["objects"][0] | {"location": [1, 1]}]}, "3 numbers are expected"),
        ({"objects": [building()["objects"][0] | {"location": [1, 1, None]}]}, "a number is expected"),
        ({"rooms": [{"id": 1, "scene_category": "bedroom"}]}, "rooms: no room has a box"),
        ({"rooms": [building()["rooms"][0] | {"size": [1, -1, 1]}]}, "rooms: no room has a box"),
    ],
)
def test_a_broken_building_is_its_fault_alone(tmp_path: Path, change: Document, message: str) -> None:
    write(tmp_path, building(), "verified/Other.scn")
    source = write(tmp_path, building() | change)
    with pytest.raises(FormatError, match=message) as caught:
        source.read("verified/Made")
    assert caught.value.where == str(tmp_path / "verified/Made.scn")
    assert len(source.read("verified/Other").objects) == 3


def test_an_object_of_negative_size_costs_its_extent_alone(tmp_path: Path) -> None:
    made = building()
    expected = write(tmp_path, made).read("verified/Made")
    made["objects"][0]["size"][1] = -1
    scene = write(tmp_path, made).read("verified/Made")
    (spoilt,) = [o for o in scene.objects if o.aabb is None]
    assert (spoilt.size, spoilt.radius) == (None, None)
    assert [o.object_id for o in scene.objects] == [o.object_id for o in expected.objects]
    assert [(w.code, w.message) for w in scene.warnings if w.where == spoilt.object_id] == [
        ("no_box", "its size is negative: extent unknown")
    ]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"size": [1, 2, -1]}, "its size is negative: left out"),
        ({"size": None}, "it has no size: left out"),
        ({"location": None, "size": None}, "it has no location and no size: left out"),
    ],
)
def test_a_room_without_a_box_costs_this_room_alone(tmp_path: Path, change: Document, why: str) -> None:
    made = building()
    whole = write(tmp_path, made).read("verified/Made")
    spoilt = made["rooms"][0] | {"id": 77} | change
    made["rooms"].append(spoilt)
    made["objects"].append(made["objects"][0] | {"id": 78, "parent_room": 77})
    scene = write(tmp_path, made).read("verified/Made")
    assert [r.room_id for r in scene.rooms] == [r.room_id for r in whole.rooms]
    said = {(w.code, w.where): w.message for w in scene.warnings}
    assert said["room_without_box", f"{spoilt['scene_category']}_77"] == why
    # What is in it counts to the room around its centre.
    (moved,) = [o for o in scene.objects if o.object_id.endswith("_78")]
    assert moved.room_id == next(o.room_id for o in scene.objects if np.array_equal(o.center, moved.center))
    assert ("no_parent_room", moved.object_id) in said


def npz_of(member: bytes, name: str = "output.npy", method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        archive.writestr(name, member)
    return buffer.getvalue()


def npy_of(value: Any) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, value, allow_pickle=True)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a valid npz"),
        (b"PK\x03\x04 nonsense", "not a valid npz"),
        (npz_of(b"x", "other.npy"), "holds no output.npy"),
        (npz_of(b"x"), "not a numpy array"),
        (npz_of(b"\x93NUMPY\x01\x00\xff\xff{  }"), "header claims 65535"),
        (npz_of(b"\x93NUMPY\x01\x00\x06\x00[1, 2]"), "header can't be read"),
        (npz_of(npy_of(np.zeros(3))), "not hold exactly one object"),
        (npz_of(npy_of(np.array([1, 2], dtype=object))), "not hold exactly one object"),
        (npz_of(npy_of(np.array({"room": {}}, dtype=object))), "not hold a dictionary for each object"),
        (npz_of(npy_of(np.array({"object": {1: {"id": [1] * 9}}, "room": {}}, dtype=object))), "a field is list"),
        (npz_of(npy_of(np.array({"object": {1: {"size": np.zeros(9)}}, "room": {}}, dtype=object))), "9 items"),
        (as_npz(building())[:-30], "not a valid npz"),
    ],
)
def test_a_broken_npz_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        read_npz(data, "folder/x.npz")
    assert caught.value.where == "folder/x.npz"


TOKENS = [b"null", b"-1", b"9e999", b"[]", b'""', b"{}"]


@pytest.mark.rounds(15)
@given(st.data())
def test_broken_bytes_of_a_pickle_give_a_document_or_our_error(data: st.DataObject) -> None:
    # Under the checksum of the zip: the member itself is broken, then packed.
    with zipfile.ZipFile(io.BytesIO(as_npz(building()))) as archive:
        bad = broken(data, archive.read("output.npy"), TOKENS)
    with suppress(FormatError):
        read_npz(npz_of(bad), "x.npz")


@pytest.mark.rounds(15)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_broken_bytes_give_a_building_or_our_error(tmp_path: Path, data: st.DataObject) -> None:
    (tmp_path / "B.scn").write_bytes(broken(data, json.dumps(building()).encode(), TOKENS))
    with suppress(InputError):
        scene_tables(open_source("gibson", tmp_path).read("B"))
