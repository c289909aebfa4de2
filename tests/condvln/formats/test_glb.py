"""GLB geometry: against closed forms, against another walk of the same bytes, and against broken files."""

from __future__ import annotations

import copy
import json
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from condvln.formats import gltf_tree
from condvln.formats.glb import read_glb
from condvln.formats.gltf_tree import MAX_NODE_DEPTH, packed_glb
from condvln.formats.triangles import glb_triangles
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
    return packed_glb(tree if isinstance(tree, bytes) else json.dumps(tree).encode(), binary)


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
        (changed("accessors", 0, "count", to=-1), "not a count"),
        (changed("accessors", 0, "bufferView", to=7), "out of range: there are 2 entries"),
        (changed("accessors", 0, "componentType", to=5122), "is not allowed for"),
        (changed("accessors", 0, "sparse", to={"count": 1}), "sparse"),
        (changed("accessors", 1, "count", to=2), "not a multiple of three"),
        (changed("bufferViews", 0, "byteLength", to=10 << 30), "the binary chunk has 44"),
        (changed("bufferViews", 0, "byteOffset", to=-4), "not a count"),
        (changed("bufferViews", 0, "byteStride", to=2), "the stride must be 4 to 252 bytes, got 2"),
        (changed("buffers", 0, "uri", to="../../other.bin"), "outside the file's own binary chunk"),
        (changed("meshes", 0, "primitives", 0, "attributes", "POSITION", to=True), "whole number"),
        (changed("meshes", 0, "primitives", 0, "mode", to=1), "no triangles"),
        (changed("meshes", 0, "primitives", 0, "extensions", to={"EXT_meshopt_compression": {}}), "meshopt"),
        (changed("extensionsRequired", to=["EXT_mesh_gpu_instancing"]), "gpu_instancing"),
        (changed("nodes", 0, "children", to=[0]), "its own ancestor"),
        (changed("nodes", 0, "matrix", to=[1, 2]), "16 numbers"),
        (changed("nodes", 0, "rotation", to=[0, 0, 0, 0]), "not a rotation"),
        (changed("nodes", 0, "scale", to=[1e300, 1, 1]), "beyond"),
        (changed("scenes", 0, "nodes", to=[]), "no triangles"),
        (
            changed("nodes", to=[{"children": [i + 1]} for i in range(100)] + [{"mesh": 0}]),
            f"more than {MAX_NODE_DEPTH}",
        ),
        (changed("nodes", to=[{"children": [1, 2]}, {"children": [3]}, {"children": [3]}, {"mesh": 0}]), "two parents"),
        (b"[" * 10_000 + b"]" * 10_000, "more than 64 levels"),
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


def test_bytes_after_the_stated_length_and_nul_after_the_json_are_ignored() -> None:
    text = json.dumps(TRIANGLE).encode()
    text += b"\0" * (4 + -len(text) % 4)
    for data in (glb(TRIANGLE) + b"more", glb(text)):
        np.testing.assert_array_equal(read_glb(data, "t.glb").vertices, read_glb(glb(TRIANGLE), "t.glb").vertices)


def test_a_fan_is_read_as_its_triangles() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-1, 1, 0]], "<f4").tobytes()
    tree = changed("accessors", 0, "count", to=5)
    tree["meshes"][0]["primitives"][0] = {"attributes": {"POSITION": 0}, "mode": 6}
    tree["bufferViews"][0]["byteLength"] = 60
    expected = [
        [[0, 0, 0], [1, 0, 0], [1, 1, 0]],
        [[0, 0, 0], [1, 1, 0], [0, 1, 0]],
        [[0, 0, 0], [0, 1, 0], [-1, 1, 0]],
    ]
    geometry = read_glb(glb(tree, points), "t.glb")
    np.testing.assert_array_equal(geometry.vertices[geometry.faces], expected)
    # With indices, from the last vertex.
    order = np.array([4, 3, 2, 1, 0, 0], "<u2").tobytes()
    tree["accessors"][1]["count"] = 4
    tree["bufferViews"][1] = {"buffer": 0, "byteOffset": 60, "byteLength": 12}
    tree["meshes"][0]["primitives"][0]["indices"] = 1
    geometry = read_glb(glb(tree, points + order), "t.glb")
    expected = [[[-1, 1, 0], [0, 1, 0], [1, 1, 0]], [[-1, 1, 0], [1, 1, 0], [1, 0, 0]]]
    np.testing.assert_array_equal(geometry.vertices[geometry.faces], expected)


def sparse(base: bool, places: Sequence[int] = (1,), count: int = 1) -> tuple[Tree, bytes]:
    """The triangle, whose second vertex is moved to (3, 4, 5) by a sparse accessor."""
    values = np.array([[3, 4, 5]] * len(places), "<f4").tobytes()
    binary = BINARY + np.array(places, "<u2").tobytes().ljust(4, b"\0") + values
    tree = changed("buffers", 0, "byteLength", to=len(binary))
    tree["bufferViews"] += [
        {"buffer": 0, "byteOffset": 44, "byteLength": 4},
        {"buffer": 0, "byteOffset": 48, "byteLength": len(values)},
    ]
    accessor = tree["accessors"][0]
    accessor["sparse"] = {
        "count": count,
        "indices": {"bufferView": 2, "componentType": 5123},
        "values": {"bufferView": 3},
    }
    if not base:
        del accessor["bufferView"]
    return tree, binary


@pytest.mark.parametrize("base", [True, False])
def test_sparse_accessors_are_read(base: bool) -> None:
    geometry = read_glb(glb(*sparse(base, (0, 1), 2)), "t.glb")
    last = [0, 2, 0] if base else [0, 0, 0]
    if base:
        assert len(geometry.faces) == 0  # two corners are the same
    tree, binary = sparse(base)
    geometry = read_glb(glb(tree, binary), "t.glb")
    corners = {tuple(v) for v in geometry.vertices.tolist()}
    assert corners == {(0, 0, 0), (3, 4, 5), tuple(last)}


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (sparse(True, (7,)), "the index 7 is out of range: there are 3 entries"),
        (sparse(True, count=3), "3 items of 2 bytes do not fit into the view's 4 bytes"),
        (sparse(True, count=10**12), "do not fit"),
        (sparse(False, count=-1), "not a count"),
    ],
)
def test_a_false_sparse_accessor_is_refused(made: tuple[Tree, bytes], message: str) -> None:
    with pytest.raises(FormatError, match=message):
        read_glb(glb(*made), "t.glb")


def test_a_sparse_accessor_that_claims_memory_is_refused() -> None:
    tree, binary = sparse(False)
    tree["accessors"][0]["count"] = 10**9
    with pytest.raises(FormatError, match="that are not stored as such"):
        read_glb(glb(tree, binary), "t.glb")


@pytest.mark.parametrize(
    ("kind", "component", "normalized", "unit"),
    [("<i2", 5122, True, 32767), ("<u2", 5123, True, 65535), ("<i1", 5120, True, 127), ("<i2", 5122, False, 1)],
)
def test_quantized_positions_are_read(kind: str, component: int, normalized: bool, unit: int) -> None:
    rows = np.zeros((3, 4), kind)
    rows[1, 0], rows[2, 1] = unit, -unit if kind[1] == "i" else unit
    tree = changed("extensionsRequired", to=["KHR_mesh_quantization"])
    tree["accessors"][0] |= {"componentType": component, "normalized": normalized}
    tree["bufferViews"] = [
        {"buffer": 0, "byteLength": rows.nbytes, "byteStride": rows.strides[0]},
        {"buffer": 0, "byteOffset": rows.nbytes, "byteLength": 8},
    ]
    geometry = read_glb(glb(tree, rows.tobytes() + BINARY[36:]), "t.glb")
    np.testing.assert_array_equal(
        geometry.vertices[geometry.faces[0]], [[0, 0, 0], [1, 0, 0], [0, -1 if kind[1] == "i" else 1, 0]]
    )
    del tree["extensionsRequired"]
    with pytest.raises(FormatError, match="is not allowed for"):
        read_glb(glb(tree, rows.tobytes() + BINARY[36:]), "t.glb")


def draco(required: bool, stored: bool) -> Tree:
    tree = changed("bufferViews", to=TRIANGLE["bufferViews"] + [{"buffer": 0, "byteLength": 40}])
    tree["meshes"][0]["primitives"][0]["extensions"] = {
        "KHR_draco_mesh_compression": {"bufferView": 2, "attributes": {"POSITION": 5, "JOINTS_0": 6}}
    }
    if not stored:
        for accessor in tree["accessors"]:
            del accessor["bufferView"]
    tree["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    if required:
        tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return tree


def test_draco_with_the_numbers_beside_it_needs_no_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gltf_tree, "find_spec", lambda _: None)
    assert len(read_glb(glb(draco(required=False, stored=True)), "t.glb").faces) == 1
    for tree in (draco(required=True, stored=True), draco(required=False, stored=False)):
        with pytest.raises(FormatError, match=r"Draco, and DracoPy is not installed\. Install DracoPy"):
            read_glb(glb(tree), "t.glb")


def test_draco_is_read_by_its_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    """The decoder is a stand-in, since DracoPy is not a dependency."""
    rows = np.array([[0, 0, 0], [0, 3, 0], [0, 0, 4]], np.float32)
    seen: list[bytes] = []

    def decode(data: bytes) -> Any:
        seen.append(bytes(data))
        return SimpleNamespace(attributes=[{"unique_id": 5, "data": rows}], faces=np.array([[0, 1, 2]], np.uint32))

    monkeypatch.setattr(gltf_tree, "find_spec", lambda name: name)
    monkeypatch.setitem(sys.modules, "DracoPy", SimpleNamespace(decode=decode))
    geometry = read_glb(glb(draco(required=True, stored=False)), "t.glb")
    np.testing.assert_array_equal(geometry.vertices[geometry.faces[0]], rows)
    assert seen == [BINARY[:40]]

    def damaged(data: bytes) -> Any:
        raise ValueError("no Draco")

    monkeypatch.setitem(sys.modules, "DracoPy", SimpleNamespace(decode=damaged))
    with pytest.raises(FormatError, match="the Draco data is damaged"):
        read_glb(glb(draco(required=True, stored=False)), "t.glb")
    claiming = draco(required=True, stored=False)
    claiming["accessors"][0]["count"] = 10**9
    with pytest.raises(FormatError, match="that are not stored as such"):
        read_glb(glb(claiming), "t.glb")


@pytest.mark.parametrize(
    ("points", "faces", "says"),
    [
        ([[0, 0, 0], [0, 3, 0], [0, 0, 4.001]], [[0, 1, 2]], None),
        ([[0, 0, 0], [0, 3, 0], [0, 0, 4.2]], [[0, 1, 2]], "beyond their stated box"),
        ([[0, 0, 0], [0, 3, 0], [0, 0, np.nan]], [[0, 1, 2]], "beyond their stated box"),
        ([[0, 0, 0], [0, 3, 0], [0, 0, 4], [0, 0, 4]], [[0, 1, 2]], "4 vertices and 3 corners, not 3 and 3"),
        ([[0, 0, 0], [0, 3, 0], [0, 0, 4]], [[0, 1, 2], [0, 1, 2]], "3 vertices and 6 corners, not 3 and 3"),
    ],
)
def test_damage_of_draco_data_that_its_decoder_does_not_notice(
    monkeypatch: pytest.MonkeyPatch, points: list[list[float]], faces: list[list[int]], says: str | None
) -> None:
    """Draco has no checksum: what it decodes is compared with what the file says of it."""
    made = SimpleNamespace(
        attributes=[{"unique_id": 5, "data": np.array(points, np.float32)}], faces=np.array(faces, np.uint32)
    )
    monkeypatch.setattr(gltf_tree, "find_spec", lambda name: name)
    monkeypatch.setitem(sys.modules, "DracoPy", SimpleNamespace(decode=lambda _: made))
    tree = draco(required=True, stored=False)
    tree["accessors"][0] |= {"min": [0, 0, 0], "max": [0, 3, 4]}
    if says is None:
        assert len(read_glb(glb(tree), "t.glb").faces) == 1
        return
    with pytest.raises(FormatError, match=says):
        read_glb(glb(tree), "t.glb")


def test_several_primitives_of_a_mesh_keep_their_order() -> None:
    tree = copy.deepcopy(TRIANGLE)
    tree["meshes"][0]["primitives"] *= 12
    vertices, faces = glb_triangles(glb(tree), "t.glb", np.eye(4))
    assert faces[:, 0].tolist() == list(range(0, 36, 3))
    np.testing.assert_array_equal(vertices[3:6], [[0, 0, 0], [1, 0, 0], [0, 2, 0]])


def _mutate(data: st.DataObject, sound: bytes) -> bytes:
    bad = bytearray(sound)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(bad) - 1))
        bad[at] = data.draw(st.integers(0, 255) | st.sampled_from(b'0123456789-"[]{},'))
    return bytes(bad[: data.draw(st.integers(0, len(bad)) | st.just(len(bad)))])


@pytest.mark.rounds(15)
@given(st.data())
def test_mutations_give_geometry_or_our_error(data: st.DataObject) -> None:
    with suppress(FormatError):
        geometry = read_glb(_mutate(data, glb(TRIANGLE)), "m.glb")
        assert np.isfinite(geometry.vertices).all()
        assert geometry.faces.max(initial=-1) < len(geometry.vertices)


def test_all_real_files_agree_with_trimesh_alone(real_data: Path) -> None:
    files = sorted((real_data / "replicacad").rglob("*.glb"))
    assert len(files) == 189
    for file in files:
        geometry = read_glb(file.read_bytes(), str(file))
        bounds = [geometry.vertices.min(0), geometry.vertices.max(0)]
        np.testing.assert_allclose(bounds, trimesh.load_scene(file).bounds, rtol=0, atol=1e-12, err_msg=str(file))


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
