"""Surface distances against closed forms, and against the generator's on real meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from condvln.relations import surface_distances
from condvln.relations.metrics import pair_metrics
from condvln.scene import MeshPart, OrientedBox, SceneObject, round_mm
from condvln.scene.meshes import MeshLibrary
from condvln.scene.quaternions import rotation_y
from condvln.sources.registry import open_source
from condvln.verify.surfaces import Shapes, SurfaceGauge
from tests.condvln.glb_boxes import box_glb


def box(name: str, centre: list[float], half: list[float], turn: float = 0.0) -> SceneObject:
    middle, extents, rotation = round_mm(centre), round_mm(half), rotation_y(turn)
    reach = np.abs(rotation) @ extents
    bounds = round_mm([middle - reach, middle + reach])
    return SceneObject(name, "r", name, name, middle, bounds, OrientedBox(middle, extents, rotation) if turn else None)


def gauge(root: Path = Path()) -> SurfaceGauge:
    return SurfaceGauge(Shapes(root))


def test_boxes_side_by_side_whose_centres_share_coordinates() -> None:
    """The case in which FCL's primitive boxes are wrong."""
    assert gauge().millimetres(box("a", [0, 0, 0], [1, 1, 1]), box("b", [3.2, 0, 0], [1, 1, 1])) == 1200.0


def test_a_turned_box_is_measured_by_its_corner() -> None:
    found = gauge().millimetres(box("a", [0, 0, 0], [1, 1, 1], np.pi / 4), box("b", [4, 0, 0], [1, 1, 1]))
    assert found == round(1000 * (3 - np.sqrt(2)))


def test_touching_overlapping_and_holding_are_no_distance() -> None:
    big = box("big", [0, 0, 0], [2, 2, 2])
    for other in (
        box("b", [3, 0, 0], [1, 1, 1]),
        box("c", [1.5, 0, 0], [1, 1, 1]),
        box("d", [0.5, 0, 0], [0.1, 0.1, 0.1]),
    ):
        assert gauge().millimetres(big, other) == gauge().millimetres(other, big) == 0.0


def test_without_extent_nothing_is_known() -> None:
    point = SceneObject("p", "r", "p", "p", np.zeros(3))
    assert gauge().millimetres(point, box("a", [0, 0, 0], [1, 1, 1])) is None


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mesh_is_measured_where_its_transform_places_it(tmp_path: Path, mirrored: bool) -> None:
    """A box of 2 x 1 x 1 before its own origin along x, turned by 60 degrees, and the mirror image of it."""
    (tmp_path / "box.glb").write_bytes(box_glb([2.0, 1.0, 1.0], [1.0, 0.0, 0.0]))
    transform = np.eye(4)
    transform[:3, :3] = rotation_y(np.pi / 3) @ np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0])
    corners = np.array([[x, y, z, 1.0] for x in (0.0, 2.0) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) @ transform.T
    mesh = SceneObject("m", "r", "m", "m", corners[:, :3].mean(axis=0), mesh=(MeshPart("box.glb", transform),))
    least = corners[:, 0].min()
    assert gauge(tmp_path).millimetres(mesh, box("b", [-6.0, 0.0, 0.0], [1.0, 1.0, 9.0])) == round(1000 * (least + 5.0))


@pytest.mark.parametrize("scene_id", ["apt_1", "v3_sc1_staging_07"])
def test_equal_to_the_generators_distances_on_meshes(real_data: Path, scene_id: str) -> None:
    root = real_data / "replicacad"
    scene = open_source("replicacad", root).read(scene_id)
    arrays = scene.arrays(scene.rooms[0].room_id)
    aabb = pair_metrics(arrays.centers, arrays.aabb_min, arrays.aabb_max, arrays.radius).aabb
    theirs = surface_distances(arrays, aabb, 0.85, MeshLibrary(root).world_mesh)
    asked = np.argwhere(np.triu(~np.isnan(theirs), 1))[:40]
    ours = gauge(root)
    assert len(asked) >= 30
    for i, j in asked.tolist():
        # Both round to 1 mm; turning a mesh before or after measuring moves it by nanometres.
        assert ours.millimetres(arrays.objects[i], arrays.objects[j]) == pytest.approx(1000 * theirs[i, j], abs=1.001)
