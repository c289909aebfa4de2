"""Noise of pose estimates and of actuation; it depends on a seed and names, never on the time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from condvln.seeding import generator
from schemas.config import NoiseConfig

__all__ = ["noisy_move", "noisy_pose"]

F64 = NDArray[np.float64]


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
