"""Pixel goals, on which InternVLA-N1 is trained: the pixel at which a frame shows the farthest later position of the
walk that the camera sees.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    moved = np.any(ahead != place, axis=1)
    if not moved.any():
        return None
    eye, axes = camera_pose(camera, place, heading)
    right, up, back = ((ahead - eye) @ axes).T
    along = -back
    tan_x, tan_y = half_extents(camera)
    with np.errstate(divide="ignore", invalid="ignore"):
        column = np.floor((right / along / tan_x + 1) / 2 * camera.width)
        row = np.floor((1 - up / along / tan_y) / 2 * camera.height)
    inside = moved & (along > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    (found,) = np.nonzero(inside)
    columns, rows = column[found].astype(int), row[found].astype(int)
    there = depth[rows, columns]
    seen = found[(there > 0) & (there >= (1 - slack) * along[found])]
    if not len(seen):
        return None
    last = int(seen[-1])
    first = last
    while first > 0 and (ahead[first - 1] == ahead[last]).all():
        first -= 1
    return PixelGoal(int(column[last]), int(row[last]), first + 1)


def camera_to_world(camera: CameraConfig, place: F64, heading: float) -> F64:
    """Return the matrix (4, 4) from camera coordinates (x right, y down, z ahead) to Habitat's frame, metres."""
    eye, axes = camera_pose(camera, place, heading)
    matrix = np.eye(4)
    matrix[:3, :3] = axes * np.array([1.0, -1.0, -1.0])
    matrix[:3, 3] = eye
    return matrix
