"""Distances of bodies against closed forms, also where FCL alone is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from condvln.relations.collision import CollisionBody, body_of, box_body
from condvln.scene import OrientedBox

F64 = NDArray[np.float64]


def body(triangles: F64) -> CollisionBody:
    return body_of(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


def test_flat_shapes_in_one_plane_are_apart_however_they_are_turned() -> None:
    """FCL alone has one in a hundred of these at distance 0."""
    plate = np.array(
        [[[-0.5, 0, -0.5], [0.5, 0, 0.5], [0.5, 0, -0.5]], [[-0.5, 0, -0.5], [-0.5, 0, 0.5], [0.5, 0, 0.5]]]
    )
    for seed in range(1000):
        turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
        beside = plate + np.array([0.0, 0.0, -1.088])
        assert body(plate @ turn.T).distance(body(beside @ turn.T)) == pytest.approx(0.088, abs=2e-5)


@pytest.mark.parametrize("height", [0.0, 0.3])
@pytest.mark.parametrize("spin", [0, 90, 180])
def test_boxes_in_a_row_are_apart_however_they_are_turned(height: float, spin: int) -> None:
    """Cupboards side by side have faces in common planes; a rug and a mat on one floor have no height."""
    for seed in range(300):
        rng = np.random.default_rng(seed)
        turn, gap = Rotation.random(rng=rng).as_matrix(), rng.uniform(0.001, 0.5)
        half = np.array([0.4, height, 0.4])
        other = turn @ Rotation.from_euler("y", spin, degrees=True).as_matrix()
        one = box_body(OrientedBox(np.zeros(3), half, turn))
        beside = box_body(OrientedBox(turn @ np.array([rng.uniform(-0.8, 0.8), 0.0, 0.8 + gap]), half, other))
        assert one.distance(beside) == pytest.approx(gap, abs=2e-5)


def test_bodies_that_touch_or_cross_are_at_distance_zero() -> None:
    box = box_body(OrientedBox(np.zeros(3), np.ones(3), np.eye(3)))
    for shift in ([2.0, 0, 0], [2.0, 2.0, 0], [1.9, 0.3, 0], [0.1, 0.1, 0.1], [0, 0, 0]):
        assert box.distance(box_body(OrientedBox(np.array(shift), np.ones(3), np.eye(3)))) == 0.0


def test_triangles_without_area_are_points_and_lines() -> None:
    box = box_body(OrientedBox(np.zeros(3), np.ones(3), np.eye(3)))
    point = body(np.broadcast_to([4.0, 5.0, 0.5], (1, 3, 3)))
    line = body(np.array([[[3.0, -9.0, 0.0], [3.0, 9.0, 0.0], [3.0, 1.0, 0.0]]]))
    assert box.distance(point) == pytest.approx(5.0, abs=1e-12)
    assert line.distance(box) == pytest.approx(2.0, abs=1e-12)
    assert line.distance(point) == pytest.approx(np.hypot(1.0, 0.5), abs=1e-12)
    rod = box_body(OrientedBox(np.array([0.0, 0.0, 3.0]), np.array([2.0, 0.0, 0.0]), np.eye(3)))
    assert rod.distance(box) == box.distance(rod) == pytest.approx(2.0, abs=1e-12)


def test_an_edge_through_the_middle_of_a_face_is_at_distance_zero() -> None:
    """No corner and no edge is near: the face and the needle meet in its middle only."""
    face = body(np.array([[[-9.0, 0.0, -9.0], [9.0, 0.0, -9.0], [0.0, 0.0, 9.0]]]))
    needle = np.array([[[0.0, -5.0, 0.0], [0.0, 5.0, 0.0], [0.01, 5.0, 0.0]]])
    assert face.distance(body(needle)) == 0.0
    assert face.distance(body(needle + np.array([0.0, 6.0, 0.0]))) == pytest.approx(1.0, abs=1e-12)
