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
from condvln.sources import scene_graph
from condvln.sources.registry import open_source
from condvln.sources.scene_graph import read_npz, read_scn
from schemas.errors import FormatError, InputError
from tests.condvln.sources.gibson_buildings import Document, as_npz, building, write


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"objects": {}}, "objects: an array is expected"),
        ({"objects": [{"class_": "bed"}]}, r"objects\[0\]: the key 'id' is missing"),
        ({"objects": [building()["objects"][0]] * 2}, "two objects have the id 1"),
        ({"rooms": [building()["rooms"][0]] * 2}, "two rooms have the id 1"),
        ({"objects": [building()["objects"][0] | {"parent_room": 9}]}, "there is no room 9"),
        ({"objects": [building()["objects"][0] | {"size": [1, -1, 1]}]}, "negative"),
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


def test_a_pickle_that_acts_is_refused(tmp_path: Path) -> None:
    graph = {"object": {1: {"id": Touches(tmp_path / "ran")}}, "room": {}}
    file = tmp_path / "verified" / "3DSceneGraph_Bad.npz"
    file.parent.mkdir()
    file.write_bytes(npz_of(npy_of(np.array(graph, dtype=object))))
    with pytest.raises(FormatError, match="the pickle is not accepted: the name"):
        open_source("gibson", tmp_path).read("verified/Bad")
    assert not (tmp_path / "ran").exists()


def test_a_zip_bomb_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_graph, "MAX_GRAPH_BYTES", 1 << 20)
    with pytest.raises(FormatError, match="decompresses to more than"):
        read_npz(npz_of(bytes(64 << 20)), "bomb.npz")


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
