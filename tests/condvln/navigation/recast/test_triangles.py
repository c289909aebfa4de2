"""Triangles of files and scenes."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
import trimesh

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.recast import Z_UP, PlacedMesh, build_navmesh, build_scene_navmesh, mesh_triangles
from condvln.navigation.settings import NavMeshSettings
from schemas.errors import FormatError, InputError, MissingFileError


@pytest.fixture
def scene(plate, box) -> trimesh.Scene:
    """A floor, and on it a table whose top hangs from a turned and scaled frame."""

    def mesh(part) -> trimesh.Trimesh:
        return trimesh.Trimesh(*part, process=False)

    made = trimesh.Scene(base_frame="world")
    made.add_geometry(mesh(plate(0, 0, 4, 4)), node_name="floor", geom_name="floor")
    turned = trimesh.transformations.rotation_matrix(np.radians(30), [0, 1, 0]) @ np.diag([2.0, 1.0, 2.0, 1.0])
    turned[:3, 3] = [2, 0, 2]
    made.graph.update(frame_from="world", frame_to="table", matrix=turned)
    made.add_geometry(
        mesh(box([-0.2, 0, -0.2], [0.2, 0.1, 0.2])),
        node_name="top",
        geom_name="top",
        parent_node_name="table",
        transform=trimesh.transformations.translation_matrix([0, 0.6, 0]),
    )
    return made


def test_whole_transforms_are_applied(scene: trimesh.Scene) -> None:
    vertices, faces = mesh_triangles([scene])
    assert vertices.dtype == np.float32
    assert faces.dtype == np.int32
    expected = scene.to_geometry()
    np.testing.assert_allclose(vertices[faces], expected.triangles, atol=1e-6)
    np.testing.assert_array_equal(vertices[:4], scene.geometry["floor"].vertices)  # at rest nothing is rounded


def test_nodes_come_depth_first(box) -> None:
    made = trimesh.Scene(base_frame="world")
    part = trimesh.Trimesh(*box([0, 0, 0], [1, 1, 1]), process=False)
    for name, parent in [("a", "world"), ("b", "world"), ("a1", "a"), ("b1", "b"), ("a2", "a")]:
        shift = trimesh.transformations.translation_matrix([10.0 ** {"a": 1, "b": 2}.get(name, 0), 0, 0])
        made.add_geometry(part, node_name=name, geom_name=name, parent_node_name=parent, transform=shift)
    vertices, _ = mesh_triangles([made])
    np.testing.assert_array_equal(vertices.reshape(5, 8, 3)[:, 0, 0], [10, 11, 11, 100, 101])


def test_files_give_what_scenes_give(scene: trimesh.Scene, tmp_path: Path) -> None:
    path = tmp_path / "room.glb"
    path.write_bytes(scene.export(file_type="glb"))
    assert build_scene_navmesh(path).to_bytes() == build_scene_navmesh(str(path)).to_bytes()
    from_file, from_scene = mesh_triangles([path]), mesh_triangles([scene])
    np.testing.assert_allclose(from_file[0][from_file[1]], from_scene[0][from_scene[1]], atol=1e-6)


def test_z_up_files(scene: trimesh.Scene) -> None:
    turned = scene.copy()
    turned.apply_transform(np.linalg.inv(Z_UP))
    assert build_scene_navmesh(PlacedMesh(turned, Z_UP)).to_bytes() == build_scene_navmesh(scene).to_bytes()


def test_static_objects_are_included_as_asked(plate, box) -> None:
    stage = trimesh.Trimesh(*plate(0, 0, 4, 4), process=False)
    pillar = trimesh.Trimesh(*box([0, 0, 0], [0.5, 2.5, 0.5]), process=False)
    placed = PlacedMesh(pillar, trimesh.transformations.translation_matrix([1.76, 0, 1.76]))
    bare = build_scene_navmesh(stage, static_objects=[placed])
    assert bare.to_bytes() == build_navmesh(*plate(0, 0, 4, 4)).to_bytes()
    built = build_scene_navmesh(stage, NavMeshSettings(include_static_objects=True), static_objects=[placed])
    assert built.static_objects_byte == 1
    assert Pathfinder(bare).is_navigable([2, 0.2, 2])
    assert not Pathfinder(built).is_navigable([2, 0.2, 2])


def test_bad_files(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"room\.glb: the mesh file does not exist"):
        mesh_triangles([tmp_path / "room.glb"])
    for name, data in [
        ("room.glb", b"glTF\x02\0\0\0"),
        ("room.obj", b"\xff\xfe"),
        ("room.xyz9", b""),
        ("room.ply", b"ply\n"),
    ]:
        (tmp_path / name).write_bytes(data)
        with pytest.raises(FormatError):
            build_scene_navmesh(tmp_path / name)


def gltf(folder: Path, uri: str, *, length: int | None = None) -> Path:
    """A triangle, whose numbers are in a buffer with this address."""
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"uri": uri, "byteLength": 36 if length is None else length}],
        "images": [{"uri": "../secret.png"}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    }
    path = folder / "t.gltf"
    path.write_text(json.dumps(tree))
    return path


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0]], "<f4")


@pytest.mark.parametrize("uri", ["t.bin", "parts/the%20numbers.bin", "data:application/octet-stream;base64,"])
def test_a_gltf_file_is_read_with_its_buffers(tmp_path: Path, uri: str) -> None:
    if uri.startswith("data:"):
        uri += base64.b64encode(TRIANGLE.tobytes()).decode()
    else:
        file = tmp_path / unquote(uri)
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(TRIANGLE.tobytes())
    vertices, faces = mesh_triangles([gltf(tmp_path, uri)])
    np.testing.assert_array_equal(vertices[faces[0]], TRIANGLE)


@pytest.mark.parametrize(
    ("uri", "length", "message"),
    [
        ("../secret.bin", 36, "leads out of the dataset"),
        ("..%2Fsecret.bin", 36, "leads out of the dataset"),
        ("/etc/passwd", 36, "absolute"),
        ("file:///etc/passwd", 36, "a buffer at an address is not read"),
        ("https://example.org/t.bin", 36, "a buffer at an address is not read"),
        ("link.bin", 36, "a symbolic link leads out"),
        ("t.bin", 37, "the file claims 37 bytes, but the buffer has 36"),
        ("none.bin", 36, "the file is not there"),
        ("data:;base64,@@@", 36, "can't be decoded"),
        ("data:text/plain,abc", 36, "must be in base64"),
    ],
)
def test_buffers_that_are_not_beside_the_file_are_refused(tmp_path: Path, uri: str, length: int, message: str) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    for file in (tmp_path / "secret.bin", folder / "t.bin"):
        file.write_bytes(TRIANGLE.tobytes())
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    with pytest.raises(InputError, match=message):
        mesh_triangles([gltf(folder, uri, length=length)])


def test_obj_and_ply_files_open_no_other_file(scene: trimesh.Scene, tmp_path: Path) -> None:
    mesh = scene.to_geometry()
    expected = sorted(map(tuple, np.round(mesh.triangles.reshape(-1, 9), 5).tolist()))
    (tmp_path / "r.obj").write_text(f"mtllib /etc/passwd\n{mesh.export(file_type='obj')}")
    (tmp_path / "r.ply").write_bytes(mesh.export(file_type="ply"))
    (tmp_path / "a.ply").write_bytes(mesh.export(file_type="ply", encoding="ascii"))
    for name in ("r.obj", "r.ply", "a.ply"):
        vertices, faces = mesh_triangles([tmp_path / name])
        found = sorted(map(tuple, np.round(vertices[faces].reshape(-1, 9).astype(np.float64), 5).tolist()))
        np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("r.ply", b"element vertex 4", b"element vertex 4000000000", "claims 4000000000 elements"),
        ("r.ply", b"element face 2", b"element face 99999999999999999999", "claims 99999999999999999999 elements"),
        ("a.ply", b"3 0 1 2", b"3 0 1 9", "missing|refers"),
        ("r.obj", b"f 1 2 3", b"f 1 2 99", "can't be read as a mesh"),
    ],
)
def test_false_counts_and_indices_are_refused(tmp_path: Path, name: str, old: bytes, new: bytes, message: str) -> None:
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 1, 2], [0, 2, 3]], process=False)
    kind = {"encoding": "ascii"} if name == "a.ply" else {}
    data = square.export(file_type=name[-3:], **kind)
    data = data.encode() if isinstance(data, str) else data
    assert old in data
    (tmp_path / name).write_bytes(data.replace(old, new))
    with pytest.raises(FormatError, match=message):
        mesh_triangles([tmp_path / name])


@pytest.mark.parametrize("transform", [np.eye(3), np.full((4, 4), np.nan), np.diag([1, 1, 1e39, 1])])
def test_bad_transforms(scene: trimesh.Scene, transform) -> None:
    with pytest.raises(FormatError, match="not a finite"):
        mesh_triangles([PlacedMesh(scene, transform)])


def test_habitats_test_rooms(real_data: Path) -> None:
    """One island a connected floor: the room's own, and the tops of three boxes in it."""
    folder = real_data / "habitat_test_assets"
    room = Pathfinder(build_scene_navmesh(PlacedMesh(folder / "scenes" / "simple_room.glb", Z_UP)))
    areas = sorted((room.island_area(k) for k in range(room.num_islands)), reverse=True)
    assert len(areas) == 4
    assert areas[0] == pytest.approx(100.4, abs=0.1)
    ground = room.snap_point([0.0, 0.3, 0.0])
    assert room.island_area(room.get_island(ground)) == pytest.approx(areas[0])
    assert ground[1] == room.navmesh.tile.verts[:, 1].min()
    for floor in sorted(folder.glob("**/*stage*.glb")):
        stage = Pathfinder(build_scene_navmesh(floor))
        assert stage.num_islands == 1, floor.name
        assert stage.navigable_area == pytest.approx(19.9976**2 - 4 * 0.15 * 19.9976, rel=0.02)
