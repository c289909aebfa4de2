"""Bounds of surface distances against closed forms, and against the generator's distances on real meshes."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from condvln.relations import surface_distances
from condvln.relations.metrics import pair_metrics
from condvln.scene import MeshPart, OrientedBox, SceneObject, round_mm
from condvln.scene.boxes import placement
from condvln.scene.meshes import MeshLibrary
from condvln.scene.rotations import rotation_y
from condvln.sources.registry import open_source
from condvln.verify.surfaces import Shapes, SurfaceGauge
from tests.condvln.glb_boxes import box_glb

F64 = NDArray[np.float64]


def box(name: str, centre: list[float], half: list[float], turn: float = 0.0) -> SceneObject:
    middle, extents, rotation = round_mm(centre), round_mm(half), rotation_y(turn)
    reach = np.abs(rotation) @ extents
    bounds = round_mm([middle - reach, middle + reach])
    return SceneObject(name, "r", name, name, middle, bounds, OrientedBox(middle, extents, rotation) if turn else None)


def gauge(root: Path = Path()) -> SurfaceGauge:
    return SurfaceGauge(Shapes(root))


def test_touching_overlapping_and_holding_are_no_distance() -> None:
    big = box("big", [0, 0, 0], [2, 2, 2])
    for other in (
        box("b", [3, 0, 0], [1, 1, 1]),
        box("c", [1.5, 0, 0], [1, 1, 1]),
        box("d", [0.5, 0, 0], [0.1, 0.1, 0.1]),
    ):
        assert gauge().at_most(big, other, 0.0) == gauge().at_most(other, big, 0.0) == 0.0


def test_without_extent_nothing_is_known() -> None:
    point = SceneObject("p", "r", "p", "p", np.zeros(3))
    assert gauge().at_most(point, box("a", [0, 0, 0], [1, 1, 1]), 500.0) is None


turns = st.integers(0, 359).map(np.radians)
middles = st.lists(st.integers(-3000, 3000).map(lambda mm: mm / 1000), min_size=3, max_size=3)
halves = st.lists(st.sampled_from([0.0, 0.1, 0.45, 0.8]), min_size=3, max_size=3)


@given(middles, halves, turns, middles, halves, turns)
@example([0.0, 0.0, -0.147], [0.1, 0.0, 0.0], 0.0, [0.043, 0.0, -0.146], [0.0, 0.0, 0.1], np.radians(91))
def test_a_bound_of_boxes_is_never_below_their_distance_and_close_to_it(
    at: list[float], half: list[float], turn: float, to: list[float], reach: list[float], spin: float
) -> None:
    one, other = box("a", at, half, turn), box("b", to, reach, spin)
    spans = np.hstack([rotation_y(turn) * half, -rotation_y(spin) * reach])
    found = lsq_linear(spans, np.subtract(to, at), bounds=(-1, 1), method="bvls", tol=1e-14)
    exact = 1000.0 * np.linalg.norm(spans @ found.x - np.subtract(to, at))
    bound = gauge().at_most(one, other, 0.0)
    assert exact - 0.51 <= bound <= exact + 1.51


def placed(folder: Path, transform: F64, name: str = "box.glb") -> SceneObject:
    """A box mesh of 2 x 1 x 1 before its own origin along x, at a transform."""
    (folder / name).write_bytes(box_glb([2.0, 1.0, 1.0], [1.0, 0.0, 0.0]))
    return SceneObject(name, "r", "m", "m", transform[:3, 3], mesh=(MeshPart(name, transform),))


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mesh_is_measured_where_its_transform_places_it(tmp_path: Path, mirrored: bool) -> None:
    """A box that is turned by 60 degrees, and the mirror image of it."""
    transform = np.eye(4)
    transform[:3, :3] = rotation_y(np.pi / 3) @ np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0])
    corners = np.array([[x, y, z, 1.0] for x in (0.0, 2.0) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) @ transform.T
    least = corners[:, 0].min()
    found = gauge(tmp_path).at_most(placed(tmp_path, transform), box("b", [-6.0, 0.0, 0.0], [1.0, 1.0, 9.0]), 0.0)
    assert found == round(1000 * (least + 5.0))


@settings(max_examples=40)
@given(seed=st.integers(0, 2**31))
def test_a_bound_of_meshes_is_never_below_their_distance_and_close_to_it(seed: int) -> None:
    """Boxes as meshes, whose exact distance is a least-squares problem of six bounded unknowns."""
    rng = np.random.default_rng(seed)
    with TemporaryDirectory() as folder:
        root, transforms, spans, centres = Path(folder), [], [], []
        for _ in range(2):
            transform = placement(Rotation.random(rng=rng).as_matrix(), rng.uniform(-2.5, 2.5, 3))
            transforms.append(transform)
            centres.append(transform[:3, 3] + transform[:3, 0])
            spans.append(transform[:3, :3] * [1.0, 0.5, 0.5])
        one, other = (placed(root, transform, f"{k}.glb") for k, transform in enumerate(transforms))
        both, apart = np.hstack([spans[0], -spans[1]]), centres[1] - centres[0]
        found = lsq_linear(both, apart, bounds=(-1, 1), method="bvls", tol=1e-14)
        exact = 1000.0 * np.linalg.norm(both @ found.x - apart)
        own = gauge(root)
        bound = own.at_most(one, other, 0.0)
        assert exact - 0.51 <= bound
        assert exact < 1.0 or bound <= exact + 2.51  # what crosses has surfaces that are searched apart from a point
        for enough in (200.0, 850.0):
            assert (own.at_most(one, other, enough) <= enough) == (exact <= enough) or abs(exact - enough) < 2.51


@pytest.mark.parametrize("scene_id", ["apt_1", "v3_sc1_staging_07"])
def test_what_the_generator_finds_near_on_meshes_is_proven(real_data: Path, scene_id: str) -> None:
    root = real_data / "replicacad"
    scene = open_source("replicacad", root).read(scene_id)
    arrays = scene.arrays(scene.rooms[0].room_id)
    aabb = pair_metrics(arrays.centers, arrays.aabb_min, arrays.aabb_max, arrays.radius).aabb
    theirs = 1000.0 * surface_distances(arrays, aabb, 0.85, MeshLibrary(root).world_mesh)
    asked = np.argwhere(np.triu(~np.isnan(theirs), 1))[:60]
    ours = gauge(root)
    assert len(asked) >= 30
    for i, j in asked.tolist():
        bound = ours.at_most(arrays.objects[i], arrays.objects[j], 500.0)
        # Both round to 1 mm.
        assert bound >= theirs[i, j] - 1.001
        assert (bound <= 500.0) == (theirs[i, j] <= 500.0) or abs(theirs[i, j] - 500.0) <= 1.001
