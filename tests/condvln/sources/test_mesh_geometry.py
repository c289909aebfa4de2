"""Scenes with meshes as triangles: scans in Habitat's frame and order, and stages with every body in its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from condvln.formats.triangles import Z_UP, PlacedMesh, mesh_triangles
from condvln.navigation.pathfinder import Pathfinder
from condvln.samples.layout import Layout
from condvln.samples.maker import make_layouts, make_samples
from condvln.samples.solid import layout_triangles
from condvln.scene.geometry import STRUCTURE, SceneGeometry
from condvln.sources.registry import open_source
from schemas.errors import FormatError

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
        assert geometry is not None
        assert set(geometry.owner.tolist()) == {STRUCTURE, *range(len(scene.objects))}
        for number, item in enumerate(scene.objects):
            points = geometry.vertices[geometry.faces[geometry.owner == number]].reshape(-1, 3)
            assert item.aabb is not None
            np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], item.aabb, atol=5.1e-4)
        again = source.geometry(scene)
        assert again is not None
        assert again.vertices.tobytes() == geometry.vertices.tobytes()
        assert again.faces.tobytes() == geometry.faces.tobytes()


@pytest.mark.parametrize("family", FAMILIES)
def test_navmeshes_built_of_it_lead_to_every_room(made: Path, layouts: dict[str, Layout], family: str) -> None:
    rng = np.random.default_rng(0)
    for name, geometry in geometries(made, family).items():
        nav = Pathfinder.build(geometry.vertices, geometry.faces)
        of_layout = Pathfinder.build(*layout_triangles(layouts[name]))
        assert nav.navigable_area == pytest.approx(of_layout.navigable_area, rel=0.02)
        main = max(range(of_layout.num_islands), key=of_layout.island_area)
        ends = of_layout.get_random_navigable_points(40, rng, main).reshape(2, 20, 3)
        ours, known = nav.geodesic_distances(*ends), of_layout.geodesic_distances(*ends)
        assert np.median(np.abs(ours - known)) < 0.01
        assert np.abs(ours - known).max() < 0.25


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


@pytest.mark.parametrize(
    ("family", "scene_id"),
    [("mp3d", "YmJkqBEsHnH"), ("gibson", "automated/Oyens"), ("replicacad", "v3_sc0_staging_00")],
)
def test_real_scenes_without_their_meshes_have_none(real_data: Path, family: str, scene_id: str) -> None:
    source = open_source(family, real_data / family)
    assert source.geometry(source.read(scene_id)) is None
