"""GLB geometry: against closed forms, against another walk of the same bytes, and against broken files."""

from __future__ import annotations

import copy
import io
import json
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.formats.glb import read_glb
from condvln.formats.gltf_tree import MAX_NODE_DEPTH
from schemas.errors import DeadlineError, FormatError

Tree = dict[str, Any]

# One triangle (0 0 0, 1 0 0, 0 2 0) with 16-bit indices, in a binary chunk of 44 bytes.
BINARY = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0]], "<f4").tobytes() + np.array([0, 1, 2, 0], "<u2").tobytes()
TRIANGLE: Tree = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
    ],
    "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 8}],
    "buffers": [{"byteLength": 44}],
}


def glb(tree: Tree | bytes, binary: bytes = BINARY) -> bytes:
    text = tree if isinstance(tree, bytes) else json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def changed(*path: str | int, to: Any) -> Tree:
    """The triangle's tree with one value replaced."""
    tree = copy.deepcopy(TRIANGLE)
    at: Any = tree
    for step in path[:-1]:
        at = at[step]
    at[path[-1]] = to
    return tree


def test_a_triangle_is_read_as_it_is() -> None:
    geometry = read_glb(glb(TRIANGLE), "t.glb")
    triangle = geometry.vertices[geometry.faces[0]]
    np.testing.assert_array_equal(np.roll(triangle, 0, axis=0), [[0, 0, 0], [1, 0, 0], [0, 2, 0]])
    assert not geometry.watertight
    assert geometry.vertices.dtype == np.float64
    assert geometry.faces.dtype == np.int32


def test_node_transforms_apply_along_the_way_and_meshes_are_instanced() -> None:
    tree = changed(
        "nodes",
        to=[
            {"translation": [10, 0, 0], "children": [1, 2]},
            {"rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "mesh": 0},
            {"scale": [1, 1, -1], "translation": [0, 0, 5], "mesh": 0},
        ],
    )
    geometry = read_glb(glb(tree), "t.glb")
    triangles = geometry.vertices[geometry.faces]
    np.testing.assert_allclose(triangles[0], [[10, 0, 0], [10, 1, 0], [8, 0, 0]], atol=1e-15)
    # The mirrored copy keeps its outside outside: its corners run the other way round.
    np.testing.assert_allclose(triangles[1], [[10, 2, 5], [11, 0, 5], [10, 0, 5]], atol=1e-15)


def test_transforms_are_double_precision() -> None:
    matrix = np.eye(4)
    matrix[0, 3] = 1 / 3
    geometry = read_glb(glb(changed("nodes", 0, "matrix", to=matrix.T.ravel().tolist())), "t.glb")
    assert geometry.vertices[:, 0].min() == 1 / 3


def test_only_the_default_scene_is_read_and_without_scenes_all_roots() -> None:
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [0, 0, 7]}]
    tree = {**changed("nodes", to=nodes), "scenes": [{"nodes": [0]}, {"nodes": [1]}], "scene": 1}
    assert read_glb(glb(tree), "t.glb").vertices[:, 2].tolist() == [7, 7, 7]
    del tree["scenes"], tree["scene"]
    assert len(read_glb(glb(tree), "t.glb").faces) == 2


def test_indices_are_optional_and_strips_are_cut() -> None:
    plain = changed("meshes", 0, "primitives", 0, to={"attributes": {"POSITION": 0}})
    assert read_glb(glb(plain), "t.glb").faces.shape == (1, 3)
    strip = changed("meshes", 0, "primitives", 0, "mode", to=5)
    assert read_glb(glb(strip), "t.glb").faces.shape == (1, 3)


def test_interleaved_vertices_are_read() -> None:
    rows = np.zeros((3, 6), "<f4")
    rows[:, :3] = [[0, 0, 0], [1, 0, 0], [0, 2, 0]]
    tree = changed(
        "bufferViews", to=[{"buffer": 0, "byteLength": 72, "byteStride": 24}, {"buffer": 0, "byteLength": 8}]
    )
    tree["bufferViews"][1]["byteOffset"] = 72
    data = glb(tree, rows.tobytes() + BINARY[36:])
    np.testing.assert_array_equal(read_glb(data, "t.glb").vertices.max(axis=0), [1, 2, 0])


def test_points_lines_and_materials_are_passed_over() -> None:
    tree = copy.deepcopy(TRIANGLE)
    tree["meshes"][0]["primitives"] += [{"attributes": {"POSITION": 0}, "mode": 0}, {"attributes": {}, "mode": 1}]
    tree |= {"images": [{"uri": "../../../etc/passwd"}], "textures": [{"source": 99}], "materials": "nonsense"}
    assert len(read_glb(glb(tree), "t.glb").faces) == 1


def test_a_box_is_closed_and_has_its_volume(glb_of_box: Callable[..., bytes]) -> None:
    geometry = read_glb(glb_of_box([1, 2, 3], [0.5, 0, 0]), "box.glb")
    assert geometry.watertight
    assert len(geometry.vertices) == 8
    assert trimesh.Trimesh(geometry.vertices, geometry.faces).volume == pytest.approx(6)
    np.testing.assert_allclose([geometry.vertices.min(0), geometry.vertices.max(0)], [[0, -1, -1.5], [1, 1, 1.5]])
    opened = trimesh.Trimesh(geometry.vertices, geometry.faces[1:])
    assert not read_glb(bytes(opened.export(file_type="glb")), "open.glb").watertight


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (changed("accessors", 0, "count", to=10**15), r"accessors\[0\]: 1000000000000000 items of 12 bytes"),
        (changed("accessors", 0, "count", to=4), "4 items of 12 bytes do not fit"),
        (changed("accessors", 0, "count", to=-1), "not a count"),
        (changed("accessors", 0, "count", to=1.5), "whole number"),
        (changed("accessors", 0, "byteOffset", to=1), "do not fit"),
        (changed("accessors", 0, "bufferView", to=7), "out of range: there are 2 entries"),
        (changed("accessors", 0, "componentType", to=5122), "is not allowed here"),
        (changed("accessors", 0, "type", to="VEC2"), "is not allowed here"),
        (changed("accessors", 0, "sparse", to={"count": 1}), "sparse"),
        (changed("accessors", 1, "componentType", to=5126), "is not allowed here"),
        (changed("accessors", 1, "count", to=2), "not a multiple of three"),
        (changed("bufferViews", 0, "byteLength", to=10 << 30), "the binary chunk has 44"),
        (changed("bufferViews", 0, "byteOffset", to=-4), "not a count"),
        (changed("bufferViews", 0, "buffer", to=1), "out of range: there are 1 entries"),
        (changed("bufferViews", 0, "byteStride", to=2), "the stride must be 4 to 252 bytes, got 2"),
        (changed("bufferViews", 0, "byteStride", to=1 << 40), "got 1099511627776"),
        (changed("buffers", 0, "uri", to="../../other.bin"), "outside the file's own binary chunk"),
        (changed("buffers", 0, "uri", to="http://example.org/a.bin"), "outside the file's own binary chunk"),
        (changed("meshes", 0, "primitives", 0, "attributes", "POSITION", to=True), "whole number"),
        (changed("meshes", 0, "primitives", 0, "mode", to=6), "triangle fans"),
        (changed("meshes", 0, "primitives", 0, "mode", to=1), "no triangles"),
        (changed("meshes", 0, "primitives", 0, "extensions", to={"KHR_draco_mesh_compression": {}}), "draco"),
        (changed("extensionsRequired", to=["KHR_draco_mesh_compression"]), "draco"),
        (changed("nodes", 0, "children", to=[0]), "its own ancestor"),
        (changed("nodes", 0, "children", to=[9]), "out of range: there are 1 entries"),
        (changed("nodes", 0, "matrix", to=[1, 2]), "16 numbers"),
        (changed("nodes", 0, "rotation", to=[0, 0, 0, 0]), "not a rotation"),
        (changed("nodes", 0, "scale", to=[1e300, 1, 1]), "beyond"),
        (changed("nodes", 0, "translation", to=[1e6, 0, 0]), "beyond ±100000 m"),
        (changed("scenes", 0, "nodes", to=[]), "no triangles"),
        (changed("scene", to=3), "out of range: there are 1 entries"),
        (
            changed("nodes", to=[{"children": [i + 1]} for i in range(100)] + [{"mesh": 0}]),
            f"more than {MAX_NODE_DEPTH}",
        ),
        (changed("nodes", to=[{"children": [1, 2]}, {"children": [3]}, {"children": [3]}, {"mesh": 0}]), "two parents"),
        (b"[" * 10_000 + b"]" * 10_000, "10000 levels"),
        (b'{"asset": 1, "asset": 2}', "'asset' occurs twice"),
        ({}, "no triangles"),
        ([], "an object is expected"),
    ],
)
def test_what_is_refused_and_how(tree: Any, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        read_glb(glb(tree), "folder/bad.glb")
    assert caught.value.where == "folder/bad.glb"
    assert caught.value.remedy


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_vertices_that_are_nowhere_are_refused(value: float) -> None:
    binary = np.array([value], "<f4").tobytes() + BINARY[4:]
    with pytest.raises(FormatError, match="NaN, infinite or beyond"):
        read_glb(glb(TRIANGLE, binary), "t.glb")


def test_an_index_beyond_the_vertices_is_refused() -> None:
    with pytest.raises(FormatError, match="can't be decoded"):
        read_glb(glb(TRIANGLE, BINARY[:36] + np.array([0, 1, 3, 0], "<u2").tobytes()), "t.glb")


def test_a_bomb_of_instances_is_refused() -> None:
    nodes: list[Tree] = [{"children": list(range(1, 100_001))}] + [{"mesh": 0} for _ in range(100_000)]
    primitives = [{"attributes": {"POSITION": 0}, "indices": 1}] * 300
    with pytest.raises(FormatError, match="more than 10000000 triangles"):
        read_glb(glb({**changed("nodes", to=nodes), "meshes": [{"primitives": primitives}]}), "bomb.glb")


def test_every_truncation_is_refused() -> None:
    data = glb(TRIANGLE)
    for length in range(len(data)):
        with pytest.raises(FormatError):
            read_glb(data[:length], "cut.glb")


@pytest.mark.parametrize(
    ("at", "bytes_", "message"),
    [
        (0, b"glTG", "not a GLB"),
        (4, b"\x01\0\0\0", "not a GLB file of version 2"),
        (8, b"\xff\xff\xff\x7f", "the header claims 2147483647 bytes"),
        (12, b"\xff\xff\xff\xff", "a chunk claims 4294967295 bytes"),
        (16, b"BIN\0", "the first chunk is not JSON"),
    ],
)
def test_a_false_header_is_refused(at: int, bytes_: bytes, message: str) -> None:
    data = bytearray(glb(TRIANGLE))
    data[at : at + 4] = bytes_
    with pytest.raises(FormatError, match=message):
        read_glb(bytes(data), "t.glb")


def _mutate(data: st.DataObject, sound: bytes) -> bytes:
    bad = bytearray(sound)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(bad) - 1))
        bad[at] = data.draw(st.integers(0, 255) | st.sampled_from(b'0123456789-"[]{},'))
    return bytes(bad[: data.draw(st.integers(0, len(bad)) | st.just(len(bad)))])


def _check_mutation(data: st.DataObject) -> None:
    with suppress(FormatError):
        geometry = read_glb(_mutate(data, glb(TRIANGLE)), "m.glb")
        assert np.isfinite(geometry.vertices).all()
        assert geometry.faces.max(initial=-1) < len(geometry.vertices)


@given(st.data())
def test_mutations_give_geometry_or_our_error(data: st.DataObject) -> None:
    _check_mutation(data)


@pytest.mark.soak
@settings(max_examples=5000)
@given(st.data())
def test_mutations_at_full_count(data: st.DataObject) -> None:
    _check_mutation(data)


def _walk(data: bytes) -> np.ndarray:
    """All corner points of a GLB of plain indexed triangles and matrix nodes: read with struct and numpy alone."""
    (size,) = struct.unpack_from("<I", data, 12)
    tree, binary = json.loads(data[20 : 20 + size]), data[20 + size + 8 :]

    def array(accessor: int) -> np.ndarray:
        a = tree["accessors"][accessor]
        view = tree["bufferViews"][a["bufferView"]]
        kind, width = {5125: "<u4", 5126: "<f4", 5123: "<u2"}[a["componentType"]], {"SCALAR": 1, "VEC3": 3}[a["type"]]
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        return np.frombuffer(binary, kind, a["count"] * width, start).reshape(-1, width)

    points = []

    def visit(index: int, parent: np.ndarray) -> None:
        node = tree["nodes"][index]
        matrix = parent @ np.array(node.get("matrix", np.eye(4).ravel()), dtype=np.float64).reshape(4, 4).T
        for primitive in tree["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ():
            corners = array(primitive["attributes"]["POSITION"])[array(primitive["indices"])[:, 0]].astype(np.float64)
            points.append(corners @ matrix[:3, :3].T + matrix[:3, 3])
        for child in node.get("children", ()):
            visit(child, matrix)

    for root in tree["scenes"][tree["scene"]]["nodes"]:
        visit(root, np.eye(4))
    return np.concatenate(points)


def test_all_real_files_agree_with_another_walk(real_data: Path) -> None:
    files = sorted((real_data / "replicacad").rglob("*.glb"))
    assert len(files) == 189
    for file in files:
        data = file.read_bytes()
        geometry = read_glb(data, str(file))
        expected = _walk(data)
        got = geometry.vertices[np.unique(geometry.faces)] if len(geometry.faces) else geometry.vertices
        np.testing.assert_allclose(geometry.vertices.min(0), expected.min(0), rtol=0, atol=1e-12, err_msg=str(file))
        np.testing.assert_allclose(geometry.vertices.max(0), expected.max(0), rtol=0, atol=1e-12, err_msg=str(file))
        assert len(got) <= len(expected)


def test_a_real_box_is_not_centred_on_its_origin(real_data: Path) -> None:
    file = real_data / "replicacad" / "objects" / "frl_apartment_chair_05.glb"
    geometry = read_glb(file.read_bytes(), str(file))
    assert geometry.vertices[:, 1].min() == pytest.approx(-0.571, abs=5e-4)
    assert geometry.vertices[:, 1].max() == pytest.approx(0.329, abs=5e-4)


def test_a_bomb_of_overlapping_accessors_is_refused() -> None:
    tree = copy.deepcopy(TRIANGLE)
    tree["accessors"] += [tree["accessors"][0]] * 50
    tree["meshes"][0]["primitives"] += [{"attributes": {"POSITION": i}, "indices": 1} for i in range(2, 52)]
    with pytest.raises(FormatError, match="the same bytes more than 4 times"):
        read_glb(glb(tree), "bomb.glb")


@pytest.mark.parametrize(
    "fault", [MemoryError("no room"), DeadlineError("the unit ran longer than its deadline of 9 s")]
)
def test_a_fault_that_is_not_of_the_file_is_not_told_as_one(
    fault: Exception, glb_of_box: Callable[..., bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise fault

    monkeypatch.setattr(trimesh, "load_scene", fail)
    with pytest.raises(type(fault)):
        read_glb(glb_of_box((1.0, 1.0, 1.0)), "a.glb")


def test_textures_are_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    load = trimesh.load_scene

    def counted(file: io.BytesIO, **more: Any) -> Any:
        seen.append(len(file.getvalue()))
        return load(file, **more)

    monkeypatch.setattr(trimesh, "load_scene", counted)
    texture = bytes(1 << 20)
    tree = changed("buffers", 0, "byteLength", to=44 + len(texture))
    tree["bufferViews"].append({"buffer": 0, "byteOffset": 44, "byteLength": len(texture)})
    tree["images"] = [{"bufferView": 2, "mimeType": "image/png"}]
    np.testing.assert_array_equal(read_glb(glb(tree, BINARY + texture), "t.glb").vertices.max(axis=0), [1, 2, 0])
    assert seen[0] < 2000
