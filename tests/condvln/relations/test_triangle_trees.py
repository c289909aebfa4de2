"""Distances over trees of triangles, against FCL's and against closed forms where FCL's are wrong."""

from __future__ import annotations

import fcl
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from condvln.relations.triangle_trees import TriangleTree, tree_order

F64 = NDArray[np.float64]


def tree_of(triangles: F64) -> TriangleTree:
    return TriangleTree.of(triangles[tree_order(triangles)])


def by_fcl(one: F64, other: F64) -> float:
    models = []
    for triangles in (one, other):
        model = fcl.BVHModel()
        model.beginModel(3 * len(triangles), len(triangles))
        model.addSubModel(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
        model.endModel()
        models.append(fcl.CollisionObject(model))
    return float(fcl.distance(*models, fcl.DistanceRequest(), fcl.DistanceResult()))


@st.composite
def soups(draw: st.DrawFn) -> F64:
    """Triangles in general position: some far apart, some that cross each other."""
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    count, size = draw(st.integers(1, 70)), draw(st.sampled_from([0.05, 0.4, 2.0]))
    return rng.normal(size=(count, 1, 3)) + size * rng.normal(size=(count, 3, 3)) + rng.normal(size=3)


@settings(max_examples=300)
@given(soups(), soups(), st.sampled_from([0.0, 2.0, 9.0]))
def test_distances_of_triangles_are_those_of_fcl(one: F64, other: F64, away: float) -> None:
    other = other + np.array([away, 0.0, 0.0])
    expected = by_fcl(one, other)
    assert tree_of(one).distance(tree_of(other)) == pytest.approx(expected, abs=1e-9)
    assert tree_of(other).distance(tree_of(one)) == pytest.approx(expected, abs=1e-9)
    # In any other order of the triangles, too.
    assert TriangleTree.of(one).distance(TriangleTree.of(other[::-1].copy())) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("away", [0.0, 0.001, 0.3])
def test_meshes_with_shared_corners_and_long_thin_faces(away: float) -> None:
    ball, drum = trimesh.creation.icosphere(3, 0.5), trimesh.creation.cylinder(0.4, 1.0, sections=48)
    turn = Rotation.from_euler("xyz", [20, 30, 70], degrees=True).as_matrix()
    one = np.asarray(ball.triangles, float) + np.array([0.9 + away, 0.0, 0.0])
    other = np.asarray(drum.triangles, float) @ turn.T
    assert tree_of(one).distance(tree_of(other)) == pytest.approx(by_fcl(one, other), abs=1e-9)


def test_flat_shapes_in_one_plane_are_apart_however_they_are_turned() -> None:
    """FCL has one in a hundred of these at distance 0."""
    plate = np.array(
        [[[-0.5, 0, -0.5], [0.5, 0, 0.5], [0.5, 0, -0.5]], [[-0.5, 0, -0.5], [-0.5, 0, 0.5], [0.5, 0, 0.5]]]
    )
    for seed in range(300):
        turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
        beside = plate + np.array([0.0, 0.0, -1.088])
        assert tree_of(plate @ turn.T).distance(tree_of(beside @ turn.T)) == pytest.approx(0.088, abs=1e-9)


def test_triangles_without_area_are_points_and_lines() -> None:
    box = np.asarray(trimesh.creation.box((2.0, 2.0, 2.0)).triangles, float)
    point = np.broadcast_to([4.0, 5.0, 0.5], (1, 3, 3)).copy()
    line = np.array([[[3.0, -9.0, 0.0], [3.0, 9.0, 0.0], [3.0, 1.0, 0.0]]])
    assert tree_of(box).distance(tree_of(point)) == pytest.approx(5.0, abs=1e-12)
    assert tree_of(line).distance(tree_of(box)) == pytest.approx(2.0, abs=1e-12)
    assert tree_of(line).distance(tree_of(point)) == pytest.approx(np.hypot(1.0, 0.5), abs=1e-12)
    assert tree_of(point).distance(tree_of(point)) == 0.0


def test_an_edge_through_the_middle_of_a_face_is_at_distance_zero() -> None:
    """No corner and no edge is near: the face and the needle meet in its middle only."""
    face = np.array([[[-9.0, 0.0, -9.0], [9.0, 0.0, -9.0], [0.0, 0.0, 9.0]]])
    needle = np.array([[[0.0, -5.0, 0.0], [0.0, 5.0, 0.0], [0.01, 5.0, 0.0]]])
    assert tree_of(face).distance(tree_of(needle)) == 0.0
    assert tree_of(needle).distance(tree_of(face)) == 0.0
    assert tree_of(face).distance(tree_of(needle + np.array([0.0, 6.0, 0.0]))) == pytest.approx(1.0, abs=1e-12)


@given(soups())
def test_each_node_is_around_its_triangles(triangles: F64) -> None:
    order = tree_order(triangles)
    assert sorted(order.tolist()) == list(range(len(triangles)))
    tree = TriangleTree.of(triangles[order])
    np.testing.assert_array_equal(tree.extent, [triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])
    leaves = len(tree.boxes) // 2
    assert len(triangles) / 2 < leaves <= len(triangles)
    for node in range(1, leaves):
        both = tree.boxes[2 * node : 2 * node + 2]
        np.testing.assert_array_equal(tree.boxes[node], np.r_[both[:, :3].min(axis=0), both[:, 3:].max(axis=0)])
