"""Boxes and placements against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.scene.boxes import aabb_of, box_corners, corners, oriented_box, placement, rounded_box, transform_points
from condvln.scene.rotations import rotation_y, to_matrix

lengths = st.floats(0.01, 20).map(lambda v: round(v, 4))
coordinates = st.floats(-50, 50).map(lambda v: round(v, 4))
points = st.tuples(coordinates, coordinates, coordinates).map(np.array)
extents = st.tuples(lengths, lengths, lengths).map(np.array)
rotations = (
    st.tuples(*[st.floats(-1, 1)] * 4).map(np.array).filter(lambda q: float(np.linalg.norm(q)) > 0.1).map(to_matrix)
)


def test_placement_scales_then_turns_then_moves() -> None:
    matrix = placement(rotation_y(np.pi / 2), [10, 0, 0], [2, 3, 4])
    np.testing.assert_allclose(transform_points(matrix, [[1, 1, 0], [0, 0, 1]]), [[10, 3, -2], [14, 0, 0]], atol=1e-12)


@given(points, extents, rotations, points, extents)
def test_the_oriented_box_is_the_local_box_transformed(
    low: np.ndarray, size: np.ndarray, rotation: np.ndarray, translation: np.ndarray, scale: np.ndarray
) -> None:
    local = np.array([low, low + size])
    transform = placement(rotation, translation, scale)
    box = oriented_box(local, transform)
    expected = transform_points(transform, corners(local))
    got = box_corners(box)
    distances = np.linalg.norm(expected[:, None] - got[None], axis=2)
    assert distances.min(axis=1).max() < 1e-6 * (1 + np.abs(expected).max())
    assert np.linalg.det(box.rotation) == pytest.approx(1)


@given(points, extents, rotations)
def test_the_axis_aligned_box_of_a_turned_box_is_the_abs_matrix(
    centre: np.ndarray, half: np.ndarray, rotation: np.ndarray
) -> None:
    local = np.array([-half, half])
    box = oriented_box(local, placement(rotation, centre))
    assert box is not None
    reach = np.abs(rotation) @ half
    np.testing.assert_allclose(aabb_of(box_corners(box)), [centre - reach, centre + reach], atol=1e-9)


def test_a_mirroring_placement_gives_the_same_box() -> None:
    box = oriented_box([[0, 0, 0], [1, 2, 3]], placement(scale=[-1, 1, 1]))
    np.testing.assert_allclose(aabb_of(box_corners(box)), [[-1, 0, 0], [0, 2, 3]], atol=1e-12)
    assert np.linalg.det(box.rotation) == pytest.approx(1)


def test_a_sheared_box_is_no_box() -> None:
    sheared = placement(scale=[1, 2, 1]) @ placement(rotation_y(0.5)) @ placement([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    shear = np.eye(4)
    shear[0, 1] = 0.3
    assert oriented_box([[0, 0, 0], [1, 1, 1]], shear) is None
    assert oriented_box([[0, 0, 0], [1, 1, 1]], placement(scale=[1, 0, 1])) is None
    assert oriented_box([[0, 0, 0], [1, 1, 1]], sheared) is not None


@given(points, extents, rotations)
def test_rounding_a_box_twice_is_rounding_it_once(centre: np.ndarray, half: np.ndarray, rotation: np.ndarray) -> None:
    box = oriented_box([-half, half], placement(rotation, centre))
    once = rounded_box(box)
    twice = rounded_box(once)
    assert once.rotation.tobytes() == twice.rotation.tobytes()
    assert once.center.tobytes() == twice.center.tobytes()
    np.testing.assert_allclose(once.rotation, box.rotation, atol=1e-8)
    assert np.abs(once.half_extents - box.half_extents).max() <= 0.0005 + 1e-12
