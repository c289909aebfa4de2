"""Triangles of files and scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.recast import Z_UP, PlacedMesh, build_navmesh, build_scene_navmesh, mesh_triangles
from condvln.navigation.settings import NavMeshSettings
from schemas.errors import FormatError, MissingFileError


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


def test_pathfinders_build_for_themselves(plate, tmp_path: Path) -> None:
    mesh = plate(0, 0, 4, 4)
    built = Pathfinder.build(*mesh, NavMeshSettings(agent_radius=0.2), "habitat<=0.3.3")
    assert built.settings.agent_radius == 0.2
    built.save(tmp_path / "room.navmesh")
    loaded = Pathfinder.load(tmp_path / "room.navmesh")
    assert loaded.navmesh.to_bytes() == built.navmesh.to_bytes()
    assert loaded.navigable_area == built.navigable_area


def test_stages_are_reported_in_order(plate) -> None:
    told: list[str] = []
    build_navmesh(*plate(0, 0, 4, 4), report=told.append)
    assert told[0] == "checking triangles"
    assert told[-1] == "assembling the tile"
    assert len(told) == len(set(told))


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
