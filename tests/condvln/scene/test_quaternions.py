"""Rotations against scipy's, and the stored quaternion's fixed point."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from condvln.scene.quaternions import from_matrix, from_wxyz, rotation_rpy, round_quaternion, to_matrix

components = st.floats(-10, 10).map(lambda v: round(v, 6))
quaternions = (
    st.tuples(components, components, components, components)
    .map(np.array)
    .filter(lambda q: float(np.linalg.norm(q)) > 1e-3)
)
angles = st.floats(-7, 7)


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
