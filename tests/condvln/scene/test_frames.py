"""The frames of the sources, each against a formula or a landmark of its own documentation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from condvln.scene.frames import UNITY_TO_HABITAT, Z_UP_TO_HABITAT, asset_frame, unity_point, unity_rotation
from condvln.scene.quaternions import to_matrix

degrees = st.floats(-360, 360)
metres = st.floats(-1e6, 1e6) | st.sampled_from([0.0, -0.0])


@given(metres, metres, metres)
def test_a_point_of_unity_is_mirrored_to_the_last_bit(x: float, y: float, z: float) -> None:
    assert unity_point(x, y, z).tobytes() == (UNITY_TO_HABITAT @ np.array([x, y, z])).tobytes()


@given(degrees)
def test_unity_yaw_is_a_turn_by_the_opposite_angle(yaw: float) -> None:
    half = np.radians(yaw) / 2
    np.testing.assert_allclose(unity_rotation([0, yaw, 0]), to_matrix([0, -np.sin(half), 0, np.cos(half)]), atol=1e-12)
    forward = unity_rotation([0, yaw, 0]) @ UNITY_TO_HABITAT @ [0, 0, 1]
    np.testing.assert_allclose(forward, [np.sin(2 * half), 0, -np.cos(2 * half)], atol=1e-12)


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
