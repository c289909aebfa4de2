"""Rotations against scipy's, the stored quaternion's fixed point, and the sources' frames, each against a formula or a
landmark of its own documentation.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from condvln.scene.rotations import (
    UNITY_TO_HABITAT,
    Z_UP_TO_HABITAT,
    asset_frame,
    from_matrix,
    from_wxyz,
    rotation_rpy,
    round_quaternion,
    to_matrix,
    unity_rotation,
)

components = st.floats(-10, 10).map(lambda v: round(v, 6))
quaternions = (
    st.tuples(components, components, components, components)
    .map(np.array)
    .filter(lambda q: float(np.linalg.norm(q)) > 1e-3)
)
angles = st.floats(-7, 7)
degrees = st.floats(-360, 360)


@given(quaternions)
def test_matrix_is_scipys_and_a_rotation(q: np.ndarray) -> None:
    matrix = to_matrix(q)
    np.testing.assert_allclose(matrix, Rotation.from_quat(q).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)


@given(quaternions)
def test_quaternion_of_a_matrix_is_the_unit_quaternion_up_to_sign(q: np.ndarray) -> None:
    back = from_matrix(to_matrix(q))
    unit = q / np.linalg.norm(q)
    assert min(np.abs(back - unit).max(), np.abs(back + unit).max()) < 1e-12
    assert back[np.argmax(np.abs(back))] > 0


@given(quaternions)
def test_a_rounded_quaternion_survives_its_matrix_to_the_bit(q: np.ndarray) -> None:
    stored = round_quaternion(q / np.linalg.norm(q))
    again = round_quaternion(from_matrix(to_matrix(stored)))
    assert stored.tobytes() == again.tobytes()
    np.testing.assert_allclose(to_matrix(stored), to_matrix(q), atol=1e-8)


@given(angles, angles, angles)
def test_roll_pitch_yaw_turn_about_fixed_axes(roll: float, pitch: float, yaw: float) -> None:
    expected = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
    np.testing.assert_allclose(rotation_rpy(roll, pitch, yaw), expected, atol=1e-12)


def test_scene_files_put_w_first() -> None:
    quarter_turn = to_matrix(from_wxyz([np.sqrt(0.5), 0, np.sqrt(0.5), 0]))
    np.testing.assert_allclose(quarter_turn @ [0, 0, -1], [-1, 0, 0], atol=1e-15)


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_no_rotation_is_refused(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="not a rotation"):
        to_matrix(bad)


@given(degrees, degrees, degrees)
def test_unity_rotation_is_the_mirrored_quaternion(x: float, y: float, z: float) -> None:
    # Unity's own quaternion of Euler angles is y · x · z; a mirror of z turns (x, y, z, w) into (−x, −y, z, w).
    turn = (
        Rotation.from_euler("y", y, degrees=True)
        * Rotation.from_euler("x", x, degrees=True)
        * Rotation.from_euler("z", z, degrees=True)
    )
    qx, qy, qz, qw = turn.as_quat()
    np.testing.assert_allclose(unity_rotation([x, y, z]), to_matrix([-qx, -qy, qz, qw]), atol=1e-12)


def test_z_up_points_keep_their_meaning() -> None:
    np.testing.assert_array_equal(Z_UP_TO_HABITAT @ [1, 2, 3], [1, 3, -2])
    assert np.linalg.det(Z_UP_TO_HABITAT) == 1
    assert np.linalg.det(UNITY_TO_HABITAT) == -1


def test_a_z_up_asset_stands_up() -> None:
    np.testing.assert_allclose(asset_frame([0, 0, 1], [0, 1, 0]), Z_UP_TO_HABITAT, atol=1e-15)


def test_habitats_own_directions_change_nothing() -> None:
    np.testing.assert_allclose(asset_frame([0, 2, 0], [0, 0, -5]), np.eye(3), atol=1e-15)


@given(st.integers(0, 5), st.integers(0, 3))
def test_up_goes_up_and_front_goes_front(axis: int, turn: int) -> None:
    up = np.roll([1 if axis < 3 else -1, 0, 0], axis % 3)
    front = np.roll(np.roll([1 if turn < 2 else -1, 0, 0], axis % 3), 1 + turn % 2)
    frame = asset_frame(up, front)
    np.testing.assert_allclose(frame @ up, [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(frame @ front, [0, 0, -1], atol=1e-15)
    assert np.linalg.det(frame) == pytest.approx(1)


@pytest.mark.parametrize(("up", "front"), [([0, 0, 0], [0, 0, -1]), ([0, 1, 0], [0, 1, 0])])
def test_directions_that_make_no_frame_are_refused(up: list[float], front: list[float]) -> None:
    with pytest.raises(ValueError):
        asset_frame(up, front)
