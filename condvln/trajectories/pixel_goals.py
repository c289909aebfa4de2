"""Pixel goals, on which InternVLA-N1 is trained: the pixel at which a frame shows the farthest later position of the
walk that the camera sees.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import compiled, register_warm_up
from condvln.sensors.camera import camera_pose, half_extents
from schemas.config import CameraConfig

__all__ = ["PixelGoal", "camera_to_world", "mistake_after", "pixel_goal"]

F64 = NDArray[np.float64]


class PixelGoal(NamedTuple):
    """A pixel goal: the column and row of a place in the image, and the number of frames until the walk reaches the
    place.
    """

    column: int
    row: int
    frames: int


def mistake_after(right: NDArray[np.bool_], frame: int) -> int:
    """Return the end (exclusive) of the frames whose places may be the pixel goal at `frame`. The last of these frames
    is the one at which the next mistake begins, or the last of the walk.

    right : (n,) whether the right action was taken at each frame. In a mistake, no place may be a goal.
    """
    if not right[frame]:
        return frame + 1
    wrong = np.flatnonzero(~right[frame:])
    # The place of the first wrong frame is still on the right way.
    return frame + int(wrong[0]) + 1 if len(wrong) else len(right)


def pixel_goal(
    camera: CameraConfig,
    place: F64,
    heading: float,
    ahead: F64,
    depth: NDArray[np.float32],
    slack: float,
) -> PixelGoal | None:
    """Return the pixel at which the camera sees the last visible place of `ahead`, and the number of frames until the
    agent is there; None if no such place is visible.

    Parameters
    ----------
    place, heading : pose of the agent: feet (3,) metres, radians counter-clockwise from −z
    ahead : (m, 3) feet at the following frames, metres
    depth : (h, w) metres along the optical axis, 0 where nothing is seen
    slack : share by which the seen depth may be less than the place's

    Of several frames at one place, the first one counts.
    """
    eye, axes = camera_pose(camera, place, heading)
    tan_x, tan_y = half_extents(camera)
    column, row, frames = _farthest(
        np.ascontiguousarray(ahead, np.float64),
        np.ascontiguousarray(place, np.float64),
        eye,
        np.ascontiguousarray(axes),
        tan_x,
        tan_y,
        1.0 - slack,
        np.ascontiguousarray(depth, np.float32),
    )
    return PixelGoal(column, row, frames) if frames else None


@compiled
def _farthest(
    ahead: F64,
    place: F64,
    eye: F64,
    axes: F64,
    tan_x: float,
    tan_y: float,
    share: float,
    depth: NDArray[np.float32],
) -> tuple[int, int, int]:
    """Return the pixel, column and row, of the last place of `ahead` that the camera sees, and the number of frames
    until the agent is first there without moving on in between; zeros if no place is seen.

    eye (3,), axes (3, 3) : as `camera_pose` returns them; tan_x, tan_y : half extents of the image at depth 1
    share : of a place's depth, which the seen surface must have at least
    """
    height, width = depth.shape
    for k in range(len(ahead) - 1, -1, -1):
        if ahead[k, 0] == place[0] and ahead[k, 1] == place[1] and ahead[k, 2] == place[2]:
            continue
        x, y, z = ahead[k, 0] - eye[0], ahead[k, 1] - eye[1], ahead[k, 2] - eye[2]
        along = -(x * axes[0, 2] + y * axes[1, 2] + z * axes[2, 2])
        if not along > 0.0:
            continue
        right = x * axes[0, 0] + y * axes[1, 0] + z * axes[2, 0]
        up = x * axes[0, 1] + y * axes[1, 1] + z * axes[2, 1]
        column = math.floor(min(max((right / along / tan_x + 1.0) / 2.0 * width, -1.0), float(width)))
        row = math.floor(min(max((1.0 - up / along / tan_y) / 2.0 * height, -1.0), float(height)))
        if not (0 <= column < width and 0 <= row < height):
            continue
        there = depth[row, column]
        if there > 0.0 and there >= share * along:
            first = k
            while first > 0 and (
                ahead[first - 1, 0] == ahead[k, 0]
                and ahead[first - 1, 1] == ahead[k, 1]
                and ahead[first - 1, 2] == ahead[k, 2]
            ):
                first -= 1
            return column, row, first + 1
    return 0, 0, 0


def camera_to_world(camera: CameraConfig, place: F64, heading: float) -> F64:
    """Return the matrix (4, 4) from camera coordinates (x right, y down, z ahead) to Habitat's frame, metres."""
    eye, axes = camera_pose(camera, place, heading)
    matrix = np.eye(4)
    matrix[:3, :3] = axes * np.array([1.0, -1.0, -1.0])
    matrix[:3, 3] = eye
    return matrix


def _warm_up() -> None:
    pixel_goal(CameraConfig(width=4, height=4), np.zeros(3), 0.0, -np.eye(3), np.ones((4, 4), np.float32), 0.1)


register_warm_up("pixel goals", _warm_up)
