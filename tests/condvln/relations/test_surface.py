"""Surface distances against closed forms, and the overlap that surfaces alone don't see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from condvln.formats.glb import GlbGeometry
from condvln.relations.solids import BoxSolid, MeshSolid, is_its_aabb, solid_distance
from condvln.scene import OrientedBox, SceneObject
from condvln.scene.boxes import placement, transform_points
from condvln.scene.meshes import WorldMesh

EYE = np.eye(3)

# Half the coordinates are drawn from three values, so that centres and faces often share one.
coordinate = st.one_of(st.sampled_from([-0.5, 0.0, 0.5]), st.floats(-3, 3).map(lambda x: round(x, 3)))
half = st.one_of(st.sampled_from([0.0, 0.25, 0.5]), st.floats(0.01, 1.5).map(lambda x: round(x, 3)))


def distance(*things: OrientedBox | MeshSolid) -> float:
    return solid_distance(*(BoxSolid((one,)) if isinstance(one, OrientedBox) else one for one in things))


@st.composite
def boxes(draw: st.DrawFn) -> OrientedBox:
    center = np.array([draw(coordinate) for _ in range(3)])
    return OrientedBox(center, np.array([draw(half) for _ in range(3)]), EYE)


def closed_form(a: OrientedBox, b: OrientedBox) -> float:
    gap = np.maximum(np.abs(a.center - b.center) - (a.half_extents + b.half_extents), 0.0)
    return float(np.linalg.norm(gap))


def mesh_of(shape: trimesh.Trimesh, watertight: bool = True) -> MeshSolid:
    return MeshSolid(WorldMesh(np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int32), watertight))


@settings(max_examples=300)
@given(boxes(), boxes())
def test_box_triangles_give_the_closed_form(a: OrientedBox, b: OrientedBox) -> None:
    assert distance(a, b) == pytest.approx(closed_form(a, b), abs=1e-9)


@settings(max_examples=100)
@given(boxes(), boxes(), st.integers(0, 2**31))
def test_turning_both_boxes_leaves_their_distance(a: OrientedBox, b: OrientedBox, seed: int) -> None:
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    turned = [OrientedBox(turn @ box.center, box.half_extents, turn) for box in (a, b)]
    assert distance(*turned) == pytest.approx(closed_form(a, b), abs=1e-9)


@st.composite
def turned_boxes(draw: st.DrawFn) -> OrientedBox:
    box = draw(boxes())
    angles = [draw(st.sampled_from([0, 30, 45, 90, 137])) for _ in range(3)]
    return OrientedBox(box.center, box.half_extents, Rotation.from_euler("yxz", angles, degrees=True).as_matrix())


@settings(max_examples=100)
@given(turned_boxes(), turned_boxes())
def test_boxes_against_bounded_least_squares(a: OrientedBox, b: OrientedBox) -> None:
    """The nearest points of two boxes are a least-squares problem of six bounded unknowns."""
    spans = np.hstack([a.rotation * a.half_extents, -b.rotation * b.half_extents])
    found = lsq_linear(spans, b.center - a.center, bounds=(-1, 1), method="bvls", tol=1e-14)
    expected = np.linalg.norm(spans @ found.x - (b.center - a.center))
    assert distance(a, b) == pytest.approx(expected, abs=1e-9)
    assert distance(b, a) == pytest.approx(expected, abs=1e-9)


@settings(max_examples=100)
@given(boxes(), boxes())
def test_a_box_as_a_mesh_is_the_same_solid(a: OrientedBox, b: OrientedBox) -> None:
    mesh = mesh_of(trimesh.creation.box(2 * a.half_extents, trimesh.transformations.translation_matrix(a.center)))
    assert distance(mesh, b) == pytest.approx(closed_form(a, b), abs=1e-9)
    assert distance(b, mesh) == pytest.approx(closed_form(a, b), abs=1e-9)


@pytest.mark.parametrize("shift", [(0, 0, 0), (0, 0.3, 0), (0.1, -0.2, 0.3)])
def test_what_lies_inside_is_at_distance_zero(shift: tuple[float, float, float]) -> None:
    outer, inner = OrientedBox(np.zeros(3), np.ones(3), EYE), OrientedBox(np.array(shift), np.full(3, 0.1), EYE)
    ball = mesh_of(trimesh.creation.icosphere(3, 1.2))
    shell = mesh_of(trimesh.creation.icosphere(3, 1.2), watertight=False)
    assert distance(outer, inner) == distance(inner, outer) == 0.0
    assert distance(ball, inner) == distance(inner, ball) == 0.0
    # A surface that is not closed has no inside: the gap stands.
    assert distance(shell, inner) == distance(inner, shell) > 0.5


@pytest.mark.parametrize("scale", [1.0, 0.7])
def test_a_shared_shape_gives_the_distances_of_its_triangles(scale: float) -> None:
    """A ball with a smaller one beside it and a vertex that no face uses, placed by a pose or given in the scene."""
    balls = [trimesh.creation.icosphere(2, r).apply_translation([x, 0, 0]) for r, x in ((0.5, 0.0), (0.1, 0.8))]
    both = trimesh.util.concatenate(balls).apply_scale(scale)
    vertices, faces = np.vstack([[9.0, 9.0, 9.0], both.vertices]), np.asarray(both.faces, np.int32) + 1
    asset = GlbGeometry(vertices, faces, True)
    for seed in range(30):
        rng = np.random.default_rng(seed)
        pose = placement(Rotation.random(rng=rng).as_matrix(), rng.uniform(-1, 1, 3))
        placed = transform_points(pose, vertices)
        shared, alone = (
            MeshSolid(WorldMesh(placed, faces, True, asset, pose)),
            MeshSolid(WorldMesh(placed, faces, True)),
        )
        box = OrientedBox(rng.uniform(-1, 1, 3), rng.uniform(0.01, 0.3, 3), Rotation.random(rng=rng).as_matrix())
        np.testing.assert_array_equal(shared.extent, alone.extent)
        assert len(shared.pieces) == len(alone.pieces) == 2
        assert distance(shared, box) == pytest.approx(distance(alone, box), abs=1e-12)
        assert distance(box, shared) == pytest.approx(distance(box, alone), abs=1e-12)


def test_one_piece_inside_is_enough() -> None:
    far, near = (
        trimesh.creation.box((0.2, 0.2, 0.2), trimesh.transformations.translation_matrix(c))
        for c in ([5, 0, 0], [0, 0, 0])
    )
    pair = mesh_of(trimesh.util.concatenate([far, near]))
    assert len(pair.pieces) == 2
    assert distance(pair, OrientedBox(np.zeros(3), np.ones(3), EYE)) == 0.0


def test_inside_of_a_mesh_is_that_of_its_shape() -> None:
    """Points against the analytic torus, which is not convex and has a hole."""
    torus = mesh_of(trimesh.creation.torus(1.0, 0.4, major_sections=128, minor_sections=64))
    points = np.random.default_rng(3).uniform(-1.5, 1.5, (400, 3))
    depth = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 1.0, points[:, 2]) - 0.4
    clear = np.abs(depth) > 0.01  # the facets deviate from the torus by less
    np.testing.assert_array_equal(torus.contains(points)[clear], (depth < 0)[clear])
    assert (depth < 0).any()


def test_spheres_against_their_closed_form() -> None:
    a, b = trimesh.creation.icosphere(5, 0.5), trimesh.creation.icosphere(5, 0.25)
    b.apply_translation([0.9, 0.6, -1.2])
    assert distance(mesh_of(a), mesh_of(b)) == pytest.approx(np.linalg.norm([0.9, 0.6, -1.2]) - 0.75, abs=2e-3)


@pytest.mark.parametrize("axes", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_a_box_turned_by_right_angles_is_axis_aligned(
    make: Callable[..., SceneObject], axes: tuple[int, int, int]
) -> None:
    half = np.array([0.1, 0.2, 0.3])
    box = OrientedBox(np.array([1.0, 2.0, 3.0]), half, -EYE[:, axes])
    extent = BoxSolid((box,)).extent
    np.testing.assert_allclose(extent[1] - extent[0], 2 * half[np.argsort(axes)], atol=1e-12)
    item = make("a", box.center, half[np.argsort(axes)])
    assert is_its_aabb(replace(item, obb=OrientedBox(box.center, half, box.rotation)), None)
