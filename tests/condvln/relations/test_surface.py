"""Surface distances against closed forms, and the overlap that surfaces alone don't see."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from condvln.formats.glb import GlbGeometry
from condvln.relations.metrics import pair_metrics
from condvln.relations.solids import BoxSolid, MeshSolid, is_its_aabb, solid_of
from condvln.relations.surface import solid_distance, surface_distances
from condvln.scene import OrientedBox, RoomArrays, SceneObject
from condvln.scene.boxes import placement, transform_points
from condvln.scene.meshes import WorldMesh

EYE = np.eye(3)

# Half the coordinates are drawn from three values, so that centres and faces often share one.
coordinate = st.one_of(st.sampled_from([-0.5, 0.0, 0.5]), st.floats(-3, 3).map(lambda x: round(x, 3)))
half = st.one_of(st.sampled_from([0.0, 0.25, 0.5]), st.floats(0.01, 1.5).map(lambda x: round(x, 3)))


@st.composite
def boxes(draw: st.DrawFn) -> BoxSolid:
    center = np.array([draw(coordinate) for _ in range(3)])
    return BoxSolid(center, np.array([draw(half) for _ in range(3)]), EYE)


def closed_form(a: BoxSolid, b: BoxSolid) -> float:
    gap = np.maximum(np.abs(a.center - b.center) - (a.half_extents + b.half_extents), 0.0)
    return float(np.linalg.norm(gap))


def mesh_of(shape: trimesh.Trimesh, watertight: bool = True) -> MeshSolid:
    return MeshSolid(WorldMesh(np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int32), watertight))


@settings(max_examples=300)
@given(boxes(), boxes())
def test_box_triangles_give_the_closed_form(a: BoxSolid, b: BoxSolid) -> None:
    assert solid_distance(a, b) == pytest.approx(closed_form(a, b), abs=1e-9)


@settings(max_examples=100)
@given(boxes(), boxes(), st.integers(0, 2**31))
def test_turning_both_boxes_leaves_their_distance(a: BoxSolid, b: BoxSolid, seed: int) -> None:
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    turned = [BoxSolid(turn @ box.center, box.half_extents, turn) for box in (a, b)]
    assert solid_distance(*turned) == pytest.approx(closed_form(a, b), abs=1e-9)


def test_flat_boxes_in_one_plane_are_apart_however_they_are_turned() -> None:
    """By twelve triangles each, FCL has one in a hundred of these at distance 0."""
    flat = np.array([0.5, 0.0, 0.5])
    for seed in range(300):
        turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
        a, b = BoxSolid(np.zeros(3), flat, turn), BoxSolid(turn @ np.array([0.0, 0.0, -1.088]), flat, turn)
        assert solid_distance(a, b) == pytest.approx(0.088, abs=1e-9)


@st.composite
def turned_boxes(draw: st.DrawFn) -> BoxSolid:
    box = draw(boxes())
    angles = [draw(st.sampled_from([0, 30, 45, 90, 137])) for _ in range(3)]
    return BoxSolid(box.center, box.half_extents, Rotation.from_euler("yxz", angles, degrees=True).as_matrix())


@settings(max_examples=100)
@given(turned_boxes(), turned_boxes())
def test_boxes_against_bounded_least_squares(a: BoxSolid, b: BoxSolid) -> None:
    """The nearest points of two boxes are a least-squares problem of six bounded unknowns."""
    spans = np.hstack([a.rotation * a.half_extents, -b.rotation * b.half_extents])
    found = lsq_linear(spans, b.center - a.center, bounds=(-1, 1), method="bvls", tol=1e-14)
    expected = np.linalg.norm(spans @ found.x - (b.center - a.center))
    assert solid_distance(a, b) == pytest.approx(expected, abs=1e-9)
    assert solid_distance(b, a) == pytest.approx(expected, abs=1e-9)


@settings(max_examples=100)
@given(boxes(), boxes())
def test_a_box_as_a_mesh_is_the_same_solid(a: BoxSolid, b: BoxSolid) -> None:
    mesh = mesh_of(trimesh.creation.box(2 * a.half_extents, trimesh.transformations.translation_matrix(a.center)))
    assert solid_distance(mesh, b) == pytest.approx(closed_form(a, b), abs=1e-9)
    assert solid_distance(b, mesh) == pytest.approx(closed_form(a, b), abs=1e-9)


@pytest.mark.parametrize("shift", [(0, 0, 0), (0, 0.3, 0), (0.1, -0.2, 0.3)])
def test_what_lies_inside_is_at_distance_zero(shift: tuple[float, float, float]) -> None:
    outer, inner = BoxSolid(np.zeros(3), np.ones(3), EYE), BoxSolid(np.array(shift), np.full(3, 0.1), EYE)
    ball = mesh_of(trimesh.creation.icosphere(3, 1.2))
    shell = mesh_of(trimesh.creation.icosphere(3, 1.2), watertight=False)
    assert solid_distance(outer, inner) == solid_distance(inner, outer) == 0.0
    assert solid_distance(ball, inner) == solid_distance(inner, ball) == 0.0
    # A surface that is not closed has no inside: the gap stands.
    assert solid_distance(shell, inner) == solid_distance(inner, shell) > 0.5


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
        box = BoxSolid(rng.uniform(-1, 1, 3), rng.uniform(0.01, 0.3, 3), Rotation.random(rng=rng).as_matrix())
        np.testing.assert_array_equal(shared.surface.extent, alone.surface.extent)
        assert len(shared.pieces) == len(alone.pieces) == 2
        assert solid_distance(shared, box) == pytest.approx(solid_distance(alone, box), abs=1e-12)
        assert solid_distance(box, shared) == pytest.approx(solid_distance(box, alone), abs=1e-12)


def test_one_piece_inside_is_enough() -> None:
    far, near = (
        trimesh.creation.box((0.2, 0.2, 0.2), trimesh.transformations.translation_matrix(c))
        for c in ([5, 0, 0], [0, 0, 0])
    )
    pair = mesh_of(trimesh.util.concatenate([far, near]))
    assert len(pair.pieces) == 2
    assert solid_distance(pair, BoxSolid(np.zeros(3), np.ones(3), EYE)) == 0.0


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
    assert solid_distance(mesh_of(a), mesh_of(b)) == pytest.approx(np.linalg.norm([0.9, 0.6, -1.2]) - 0.75, abs=2e-3)


def test_the_best_known_geometry_stands_for_an_object(make: Callable[..., SceneObject]) -> None:
    item = make("a", (0, 0, 0), (0.5, 0.5, 0.5))
    aabb = item.aabb
    assert aabb is not None
    triangle = WorldMesh(np.eye(3), np.array([[0, 1, 2]], np.int32), False)
    nothing = WorldMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), False)
    turned = replace(
        item, obb=OrientedBox(np.zeros(3), np.full(3, 0.5), Rotation.from_euler("y", 45, degrees=True).as_matrix())
    )
    assert isinstance(solid_of(turned, aabb, triangle), MeshSolid)
    assert isinstance(solid_of(turned, aabb, nothing), BoxSolid)
    assert isinstance(solid_of(item, aabb, None), BoxSolid)
    np.testing.assert_array_equal(solid_of(item, aabb, None).surface.extent, aabb)
    assert not is_its_aabb(turned, None)
    assert not is_its_aabb(item, triangle)
    assert is_its_aabb(item, nothing)


@pytest.mark.parametrize("axes", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_a_box_turned_by_right_angles_is_axis_aligned(
    make: Callable[..., SceneObject], axes: tuple[int, int, int]
) -> None:
    half = np.array([0.1, 0.2, 0.3])
    box = BoxSolid(np.array([1.0, 2.0, 3.0]), half, -EYE[:, axes])
    np.testing.assert_allclose(box.surface.extent[1] - box.surface.extent[0], 2 * half[np.argsort(axes)], atol=1e-12)
    item = make("a", box.center, half[np.argsort(axes)])
    assert is_its_aabb(replace(item, obb=OrientedBox(box.center, half, box.rotation)), None)


def room_surface(room: RoomArrays, within: float, **meshes: WorldMesh) -> tuple[np.ndarray, np.ndarray]:
    aabb = pair_metrics(room.centers, room.aabb_min, room.aabb_max, room.radius).aabb
    return aabb, surface_distances(room, aabb, within, (lambda o: meshes.get(o.object_id)) if meshes else None)


def test_boxes_of_a_room(furnished: list[SceneObject], room_of: Callable[[Sequence[SceneObject]], RoomArrays]) -> None:
    aabb, surface = room_surface(room_of(furnished), 1.15)
    asked = aabb <= 1.15
    np.testing.assert_array_equal(
        ~np.isnan(surface) | np.eye(len(aabb), dtype=bool), asked | np.eye(len(aabb), dtype=bool)
    )
    # Boxes stand on whole millimetres, so rounding the closed form is all there is.
    np.testing.assert_array_equal(surface[asked], np.round(aabb[asked], 3))
    np.testing.assert_array_equal(surface, surface.T)
    assert (np.diag(surface) == 0).all()


def test_closed_form_and_triangles_agree_over_a_room(
    furnished: list[SceneObject], room_of: Callable[[Sequence[SceneObject]], RoomArrays]
) -> None:
    room = room_of(furnished)
    shapes = {o.object_id: trimesh.creation.box(bounds=o.aabb) for o in room.objects if o.aabb is not None}
    meshes = {
        name: WorldMesh(np.asarray(s.vertices), np.asarray(s.faces, np.int32), True) for name, s in shapes.items()
    }
    np.testing.assert_array_equal(room_surface(room, 1.15)[1], room_surface(room, 1.15, **meshes)[1])


def test_a_mesh_is_further_than_its_box(
    make: Callable[..., SceneObject], room_of: Callable[[Sequence[SceneObject]], RoomArrays]
) -> None:
    """Two opposite corners of boxes are cut off: boxes touch, surfaces are apart by the diagonal of the cut."""
    room = room_of([make("a", (0, 0, 0), (0.5, 0.5, 0.5)), make("b", (1, 1, 1), (0.5, 0.5, 0.5))])
    vertices = np.array([[-0.5, -0.5, -0.5], [0.5, -0.5, -0.5], [-0.5, 0.5, -0.5], [-0.5, -0.5, 0.5]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    corner = WorldMesh(vertices, faces, True)
    aabb, surface = room_surface(room, 1.15, a=corner)
    assert aabb[0, 1] == 0.0
    # From the corner (0.5, 0.5, 0.5) of b to the plane x + y + z = −0.5.
    assert surface[0, 1] == round(2 / np.sqrt(3), 3)


def test_nothing_is_asked_beyond_the_broad_phase(
    make: Callable[..., SceneObject], room_of: Callable[[Sequence[SceneObject]], RoomArrays]
) -> None:
    room = room_of(
        [make("a", (0, 0, 0), (0.5,) * 3), make("b", (2.151, 0, 0), (0.5,) * 3), make("c", (-2.15, 0, 0), (0.5,) * 3)]
    )
    asked: list[str] = []

    def meshes(item: SceneObject) -> None:
        asked.append(item.object_id)

    aabb = pair_metrics(room.centers, room.aabb_min, room.aabb_max, room.radius).aabb
    surface = surface_distances(room, aabb, 1.15, meshes)
    assert asked == ["a", "c"]
    assert surface[0, 2] == 1.15
    assert np.isnan(surface[0, 1])
