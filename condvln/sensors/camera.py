"""The pose of a camera, and the camera presets of published agents; and noise of pose estimates and of actuation, which
depends on a seed and names, never on the time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from condvln.arrays import F64
from condvln.scene.rotations import rotation_x, rotation_y
from condvln.seeding import generator
from schemas.config import CameraConfig, NoiseConfig
from schemas.errors import UsageError

__all__ = ["PRESETS", "camera_pose", "cameras_of", "half_extents", "noisy_move", "noisy_pose", "panorama", "pixel_rays"]


def noisy_pose(
    position: npt.ArrayLike, heading: float, noise: NoiseConfig, seed: int, names: Sequence[object] = ()
) -> tuple[F64, float]:
    """Return a pose with noise: position (3,) in metres, shifted horizontally, and heading in radians."""
    east, south, turn = generator(seed, "pose", *names).normal(size=3)
    believed = np.asarray(position, np.float64) + noise.position * np.array([east, 0.0, south])
    return believed, (heading + math.radians(noise.heading) * turn) % (2 * math.pi)


def noisy_move(
    forward: float, turn: float, noise: NoiseConfig, seed: int, names: Sequence[object] = ()
) -> tuple[float, float]:
    """Return the forward step (metres) and the turn (radians), each with a random relative error."""
    step, angle = generator(seed, "move", *names).normal(size=2)
    return max(0.0, forward * (1 + noise.step * step)), turn * (1 + noise.turn * angle)


_STREAMVLN: Final = CameraConfig(width=640, height=480, hfov=79.0)
PANORAMA_ROWS: Final = (30.0, 0.0, -30.0)
"""Downward angle in degrees of the three rows of a panorama: view 0 is in the lowest row, as in the R2R simulator."""
PANORAMA_STEP: Final = 30.0
"""Degrees between two adjacent views of a row, to the right."""
_PANORAMA_HFOV: Final = math.degrees(2 * math.atan(math.tan(math.radians(60.0) / 2) * 640 / 480))
"""Vertical field of view in degrees of the R2R simulator."""


def panorama(width: int = 640, height: int = 480, eye_height: float = 1.25) -> dict[str, CameraConfig]:
    """Return the cameras, by name, of the 36 views of the R2R simulator: ``rgb_00`` to ``rgb_35``.

    Three rows of twelve views, the lowest row first, each row from straight ahead to the right. The simulator's views
    are those of an agent that faces north. Depths are metres without a limit.
    """
    return {
        f"rgb_{12 * row + column:02d}": CameraConfig(
            width=width,
            height=height,
            hfov=_PANORAMA_HFOV,
            eye_height=eye_height,
            look_down=down,
            turn=-PANORAMA_STEP * column,
            max_depth=None,
            normalized=False,
        )
        for row, down in enumerate(PANORAMA_ROWS)
        for column in range(12)
    }


PRESETS: Final[Mapping[str, Mapping[str, CameraConfig]]] = {
    "vlnce": {
        "rgb": CameraConfig(width=224, height=224),
        "depth": CameraConfig(width=256, height=256),
    },
    "streamvln": {"rgb": _STREAMVLN, "depth": _STREAMVLN},
    "internvla-n1": {
        "rgb": _STREAMVLN.model_copy(update={"max_depth": None, "normalized": False}),
        "depth": _STREAMVLN.model_copy(update={"max_depth": None, "normalized": False}),
        "rgb_look_down": _STREAMVLN.model_copy(update={"look_down": 30.0, "max_depth": None, "normalized": False}),
        "depth_look_down": _STREAMVLN.model_copy(update={"look_down": 30.0, "max_depth": None, "normalized": False}),
    },
    "panorama": panorama(),
}
"""Camera presets. A camera's name begins with its modality: ``rgb``, ``depth``, ``instance`` or ``label``."""


def cameras_of(preset: str) -> Mapping[str, CameraConfig]:
    """Return the cameras of a preset by name.

    Raises
    ------
    UsageError : no preset has this name
    """
    if preset not in PRESETS:
        raise UsageError(f"there is no camera preset {preset!r}", remedy=f"Choose one of {', '.join(sorted(PRESETS))}")
    return PRESETS[preset]


def camera_pose(camera: CameraConfig, position: npt.ArrayLike, heading: float) -> tuple[F64, F64]:
    """Return a camera's position and rotation from the agent's pose.

    Parameters
    ----------
    position : (3,) of the agent's feet, metres, Habitat frame
    heading : radians counter-clockwise from −Z, as in :class:`condvln.evaluation.walker.Observation`

    Returns
    -------
    eye (3,) metres; rotation (3, 3), its columns the camera's right, up and back in the scene's frame
    """
    eye = np.asarray(position, np.float64) + np.array([0.0, camera.eye_height, 0.0])
    rotation = rotation_y(heading + math.radians(camera.turn)) @ rotation_x(-math.radians(camera.look_down))
    return eye, np.asarray(rotation, np.float64)


def pixel_rays(camera: CameraConfig) -> tuple[F64, F64]:
    """Return coordinates of the pixels' centres at depth 1 in the camera's frame: x of each column (w,) and y of each
    row (h,). Row 0 is the uppermost.
    """
    tan_x, tan_y = half_extents(camera)
    columns = (2 * np.arange(camera.width) + 1 - camera.width) / camera.width * tan_x
    rows = (camera.height - 1 - 2 * np.arange(camera.height)) / camera.height * tan_y
    return columns, rows


def half_extents(camera: CameraConfig) -> tuple[float, float]:
    """Return half the width and half the height of the image plane at depth 1; pixels are square."""
    tan_x = math.tan(math.radians(camera.hfov) / 2)
    return tan_x, tan_x * camera.height / camera.width
