"""Pixel goals and camera matrices, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from condvln.sensors.camera import camera_pose
from condvln.trajectories.images import mistake_after, pixel_goal
from condvln.trajectories.internvla import camera_to_world
from schemas.config import CameraConfig

CAMERA = CameraConfig(width=640, height=480, hfov=79.0, look_down=30.0, max_depth=None, normalized=False)
OPEN = np.full((480, 640), 100.0, np.float32)


def test_a_place_straight_ahead_is_in_the_middle_column() -> None:
    ahead = np.array([[0.0, 0.0, -0.25 * k] for k in range(1, 9)])
    goal = pixel_goal(CAMERA, np.zeros(3), 0.0, ahead, OPEN, 0.1)
    assert goal is not None
    # 2 m ahead and 1.25 m below the eye, seen by a camera that looks 30° down.
    down = math.atan2(1.25, 2.0) - math.radians(30.0)
    focal = 320 / math.tan(math.radians(39.5))
    assert goal == (320, math.floor(240 + focal * math.tan(down)), 8)


def test_what_is_hidden_behind_or_beside_is_not_a_goal() -> None:
    ahead = np.array([[0.0, 0.0, -0.25 * k] for k in range(1, 9)])
    assert pixel_goal(CAMERA, np.zeros(3), math.pi, ahead, OPEN, 0.1) is None
    assert pixel_goal(CAMERA, np.zeros(3), math.pi / 2, ahead, OPEN, 0.1) is None
    wall = np.full((480, 640), 1.5, np.float32)
    near = pixel_goal(CAMERA, np.zeros(3), 0.0, ahead, wall, 0.1)
    # Optical depth of a place d ahead: d cos 30° + 1.25 sin 30°.
    deepest = max(d for d in range(1, 9) if 0.9 * (0.25 * d * math.cos(math.pi / 6) + 0.625) <= 1.5)
    assert near.frames == deepest
    assert pixel_goal(CAMERA, np.zeros(3), 0.0, ahead, np.zeros_like(OPEN), 0.1) is None


def test_turns_do_not_move_a_goal_and_the_first_frame_at_it_counts() -> None:
    ahead = np.array([[0.0, 0.0, -1.0]] * 4)
    goal = pixel_goal(CAMERA, np.zeros(3), 0.0, ahead, OPEN, 0.1)
    assert goal.frames == 1
    assert pixel_goal(CAMERA, np.zeros(3), 0.0, np.zeros((3, 3)), OPEN, 0.1) is None
    assert pixel_goal(CAMERA, np.zeros(3), 0.0, np.zeros((0, 3)), OPEN, 0.1) is None


@pytest.mark.parametrize(
    ("right", "frame", "end"),
    [([1, 1, 0, 0, 1, 1], 0, 3), ([1, 1, 0, 0, 1, 1], 2, 3), ([1, 1, 0, 0, 1, 1], 4, 6), ([1, 1], 1, 2)],
)
def test_goals_end_at_mistakes(right: list[int], frame: int, end: int) -> None:
    assert mistake_after(np.array(right, bool), frame) == end


@given(
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.floats(0, 2 * math.pi),
    st.floats(-60, 60),
    st.floats(0.1, 1.5),
)
def test_the_matrix_has_the_camera_s_pose(x: float, z: float, heading: float, pitch: float, height: float) -> None:
    camera = CAMERA.model_copy(update={"look_down": pitch, "eye_height": height})
    place = np.array([x, 0.3, z])
    matrix = camera_to_world(camera, place, heading)
    eye, axes = camera_pose(camera, place, heading)
    np.testing.assert_allclose(matrix @ [0, 0, 0, 1], [*eye, 1])
    np.testing.assert_allclose(matrix @ [0, 0, 1, 0], [*-axes[:, 2], 0], atol=1e-12)  # ahead
    np.testing.assert_allclose(matrix @ [1, 0, 0, 0], [*axes[:, 0], 0], atol=1e-12)  # right
    np.testing.assert_allclose(matrix @ [0, 1, 0, 0], [*-axes[:, 1], 0], atol=1e-12)  # down
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)


@given(st.integers(0, 2**32 - 1), st.floats(0, 2 * math.pi), st.floats(-60, 60), st.floats(0, 0.5))
def test_the_goal_is_the_last_place_that_any_pixel_shows(seed: int, heading: float, pitch: float, slack: float) -> None:
    """Against a plain search over all places, with coordinates from the inverse of the camera's matrix."""
    draw = np.random.default_rng(seed)
    camera = CAMERA.model_copy(update={"look_down": pitch, "width": 64, "height": 48})
    place = draw.normal(size=3)
    ahead = place + np.cumsum(draw.normal(size=(12, 3)) * draw.integers(0, 2, (12, 1)), axis=0)
    depth = draw.uniform(-1, 6, (48, 64)).clip(0).astype(np.float32)
    focal = 32 / math.tan(math.radians(39.5))
    inside = np.linalg.inv(camera_to_world(camera, place, heading))
    expected, doubtful = None, False
    for k, point in enumerate(ahead):
        x, y, z, _ = inside @ [*point, 1]
        if (point == place).all() or z <= 0:
            continue
        column, row = 32 + focal * x / z, 24 + focal * y / z
        doubtful |= min(abs(column - round(column)), abs(row - round(row)), abs(z)) < 1e-9
        if 0 <= column < 64 and 0 <= row < 48:
            there = depth[int(row), int(column)]
            doubtful |= abs(there - (1 - slack) * z) < 1e-9
            if there > 0 and there >= (1 - slack) * z:
                first = next(j for j in range(k + 1) if (ahead[j : k + 1] == point).all())
                expected = (int(column), int(row), first + 1)
    assume(not doubtful)
    assert pixel_goal(camera, place, heading, ahead, depth, slack) == expected
