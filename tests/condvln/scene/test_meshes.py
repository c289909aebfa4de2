"""The library of meshes: placing, joining, and what it keeps."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from condvln.scene import MeshPart, SceneObject
from condvln.scene.boxes import placement, transform_points
from condvln.scene.meshes import MeshLibrary
from schemas.errors import FormatError, MissingFileError, PathEscapeError

TURN = Rotation.from_euler("yxz", [30, 20, 10], degrees=True).as_matrix()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, size in (("a", [1, 1, 1]), ("b", [2, 2, 2])):
        (tmp_path / f"{name}.glb").write_bytes(bytes(trimesh.creation.box(size).export(file_type="glb")))
    return tmp_path


def item(*parts: MeshPart) -> SceneObject:
    return SceneObject("o", "r", "box", "box", np.zeros(3), mesh=parts)


def test_parts_are_placed_and_joined(folder: Path) -> None:
    parts = (MeshPart("a.glb", placement(translation=[5, 0, 0])), MeshPart("b.glb", placement(scale=[1, 1, 3])))
    mesh = MeshLibrary(folder).world_mesh(item(*parts))
    assert (mesh.vertices.dtype, mesh.faces.dtype, mesh.watertight) == (np.float64, np.int32, True)
    assert (mesh.vertices.shape, mesh.faces.shape) == ((16, 3), (24, 3))
    np.testing.assert_allclose([mesh.vertices.min(0), mesh.vertices.max(0)], [[-1, -1, -3], [5.5, 1, 3]])
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(1 + 24)


def test_a_mirrored_part_keeps_its_outside_outside(folder: Path) -> None:
    mesh = MeshLibrary(folder).world_mesh(item(MeshPart("a.glb", placement(scale=[-1, 2, 1]))))
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(2)


def test_a_body_of_scaled_parts_has_one_shape_wherever_it_stands(folder: Path) -> None:
    """Placed by its pose, the shared shape is the mesh in the scene, to a nanometre."""
    library = MeshLibrary(folder)
    inside = (placement(scale=0.4), placement(rotation=TURN, translation=[1 / 3, 2, -1], scale=[0.4, 0.5, 0.4]))
    shapes = []
    for seed in range(20):
        turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
        place = placement(rotation=turn, translation=[seed, -1 / 7, 3])
        mesh = library.world_mesh(
            item(*(MeshPart(n, place @ m) for n, m in zip(("a.glb", "b.glb"), inside, strict=True)))
        )
        assert mesh.pose is not None
        np.testing.assert_allclose(mesh.pose, place, atol=1e-12)
        np.testing.assert_allclose(transform_points(mesh.pose, mesh.asset.vertices), mesh.vertices, atol=1e-9)
        np.testing.assert_array_equal(mesh.asset.faces, mesh.faces)
        shapes.append(mesh.asset)
    assert all(shape is shapes[0] for shape in shapes)
    assert trimesh.Trimesh(shapes[0].vertices, shapes[0].faces).volume == pytest.approx(0.4**3 + 8 * 0.4 * 0.5 * 0.4)


def test_other_proportions_are_another_shape(folder: Path) -> None:
    library = MeshLibrary(folder)
    one, other = (library.world_mesh(item(MeshPart("a.glb", placement(scale=size)))) for size in (0.4, 0.4000001))
    assert one.asset is not None
    assert one.asset is not other.asset


@pytest.mark.parametrize("scales", [([-1, 1, 1], [1, 1, 1]), ([1, 1, 1], [-1, 1, 1]), ([1, 2, 1], [1, 1, 1])])
def test_mirrored_bodies_and_those_whose_first_part_is_stretched_have_no_shared_shape(
    folder: Path, scales: tuple[list[float], list[float]]
) -> None:
    parts = (MeshPart(name, placement(scale=size)) for name, size in zip(["a.glb", "b.glb"], scales, strict=True))
    mesh = MeshLibrary(folder).world_mesh(item(*parts))
    assert mesh.asset is None
    assert mesh.pose is None
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(8 + max(scales[0]))


def test_an_object_without_parts_has_no_mesh(folder: Path) -> None:
    assert MeshLibrary(folder).world_mesh(item()) is None


def test_files_are_read_once_and_a_changed_one_again(folder: Path) -> None:
    library = MeshLibrary(folder)
    first = library.geometry("a.glb")
    assert library.geometry("a.glb") is first
    data = (folder / "b.glb").read_bytes()
    (folder / "a.glb").write_bytes(data)
    os.utime(folder / "a.glb", ns=(1, 1))
    assert library.geometry("a.glb").vertices.max() == 1.0


def test_faults_name_the_file(folder: Path) -> None:
    library = MeshLibrary(folder)
    (folder / "c.glb").write_bytes(b"glTF")
    with pytest.raises(MissingFileError):
        library.geometry("none.glb")
    with pytest.raises(FormatError) as caught:
        library.geometry("c.glb")
    assert caught.value.where == str(folder / "c.glb")
    with pytest.raises(PathEscapeError):
        library.geometry("../c.glb")
