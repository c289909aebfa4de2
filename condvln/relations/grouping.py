"""Furniture that forms a group: what stands at the same rug or around the same coffee table.

A person who looks at a seating group does not say that one of its armchairs is not close to its sofa.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from condvln.labels.roles import Role, have_role
from condvln.relations.metrics import millimetres
from condvln.scene import RoomArrays
from schemas.config.constants import GROUP_RUG, GROUP_TABLE

__all__ = ["in_one_group"]


def in_one_group(arrays: RoomArrays) -> NDArray[np.bool_]:
    """Return a mask (n, n) of the pairs of objects whose footprints are both within `GROUP_RUG` of a third object that
    is a rug, or within `GROUP_TABLE` of one that is a coffee table.
    """
    low, high = millimetres(arrays.aabb_min), millimetres(arrays.aabb_max)
    found = np.zeros((len(arrays), len(arrays)), dtype=np.bool_)
    reaches: tuple[tuple[Role, float], ...] = (("carpet", GROUP_RUG), ("low table", GROUP_TABLE))
    for role, reach in reaches:
        middle = np.flatnonzero(have_role(arrays.labels, role))
        gaps = [
            np.maximum(low[:, None, k] - high[None, middle, k], low[None, middle, k] - high[:, None, k]) for k in (0, 2)
        ]
        x, z = (np.maximum(gap, 0.0) for gap in gaps)
        close = x * x + z * z <= (1000.0 * reach) ** 2  # False where a box is unknown
        close[middle, np.arange(len(middle))] = False
        found |= (close[:, None, :] & close[None, :, :]).any(axis=2)
    return found
