"""Scenes with meshes as triangles: scans in Habitat's frame and order, and stages with every body in its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from condvln.formats.triangles import Z_UP, PlacedMesh, mesh_triangles
from condvln.samples.layout import Layout
from condvln.samples.maker import make_layouts, make_samples
from condvln.scene.scene import STRUCTURE, SceneGeometry
from condvln.sources.registry import open_source
from schemas.errors import FormatError
from tests.condvln.voxelised import layout_triangles

F64 = NDArray[np.float64]

SEED, SCENES = 5, 2
FAMILIES = ("gibson", "mp3d", "replicacad")


@pytest.fixture(scope="module")
def layouts() -> dict[str, Layout]:
    return make_layouts(SCENES, SEED)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("made")
    for family in FAMILIES:
        make_samples(root / family, family, SCENES, SEED)
    return root


def geometries(root: Path, family: str) -> dict[str, SceneGeometry]:
    """By the made scene's own name."""
    source = open_source(family, root / family)
    found = {}
    for handle in source.handles():
        geometry = source.geometry(source.read(handle.scene_id))
        assert geometry is not None
        found[handle.scene_id.rpartition("/")[2]] = geometry
    return found


def signed(vertices: F64, faces: NDArray[np.integer]) -> F64:
    """(m, 6) middle of each triangle and its area along its normal, in an order of their own."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    rows = np.round(np.column_stack([(a + b + c) / 3, np.cross(b - a, c - a) / 2]), 4) + 0.0
    return rows[np.lexsort(rows.T)]


@pytest.mark.parametrize("family", FAMILIES)
def test_the_same_apartment_has_the_same_surfaces_in_every_family(
    made: Path, layouts: dict[str, Layout], family: str
) -> None:
    found = geometries(made, family)
    assert set(found) == set(layouts)
    for name, geometry in found.items():
        assert not geometry.approximate
        expected = signed(*layout_triangles(layouts[name]))
        got = signed(geometry.vertices, geometry.faces)
        assert len(got) == len(expected)
        # Triangles are matched by the sums over their cells, as a box's faces may be cut along the other diagonal.
        np.testing.assert_allclose(got[:, 3:].sum(axis=0), expected[:, 3:].sum(axis=0), atol=1e-2)
        areas, known = (np.sort(np.linalg.norm(rows[:, 3:], axis=1)) for rows in (got, expected))
        np.testing.assert_allclose(areas, known, atol=2e-3)
        for bound in (np.min, np.max):
            np.testing.assert_allclose(
                bound(geometry.vertices, axis=0), bound(layout_triangles(layouts[name])[0], axis=0), atol=1e-5
            )


@pytest.mark.parametrize("family", ["gibson", "mp3d"])
def test_a_scan_is_what_the_builder_reads_of_its_file(made: Path, family: str) -> None:
    for name, geometry in geometries(made, family).items():
        file = made / family / (f"{name}/{name}.glb" if family == "mp3d" else f"{name}.glb")
        vertices, faces = mesh_triangles([PlacedMesh(file, Z_UP)])
        assert geometry.vertices.astype(np.float32).tobytes() == vertices.tobytes()
        np.testing.assert_array_equal(geometry.faces, faces)
        assert (geometry.owner == STRUCTURE).all()


def test_bodies_own_their_triangles(made: Path) -> None:
    source = open_source("replicacad", made / "replicacad")
    for handle in source.handles():
        scene = source.read(handle.scene_id)
        geometry = source.geometry(scene)
        assert set(geometry.owner.tolist()) == {STRUCTURE, *range(len(scene.objects))}
        for number, item in enumerate(scene.objects):
            points = geometry.vertices[geometry.faces[geometry.owner == number]].reshape(-1, 3)
            assert item.aabb is not None
            np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], item.aabb, atol=5.1e-4)
        again = source.geometry(scene)
        assert again.vertices.tobytes() == geometry.vertices.tobytes()
        assert again.faces.tobytes() == geometry.faces.tobytes()


@pytest.mark.parametrize("family", FAMILIES)
def test_without_its_mesh_a_scene_has_no_surfaces(tmp_path: Path, family: str) -> None:
    make_samples(tmp_path, family, 1, SEED)
    pattern = "stages/*.glb" if family == "replicacad" else "**/made_000.glb"
    (mesh,) = tmp_path.glob(pattern)
    whole = mesh.read_bytes()
    mesh.write_bytes(whole[: len(whole) // 2])
    source = open_source(family, tmp_path)
    (handle,) = source.handles()
    with pytest.raises(FormatError) as caught:
        source.geometry(source.read(handle.scene_id))
    assert caught.value.where == str(mesh)
    mesh.unlink()
    source = open_source(family, tmp_path)
    assert source.geometry(source.read(handle.scene_id)) is None
