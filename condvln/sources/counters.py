"""The shape of ProcTHOR's L- and C-shaped kitchen counters, whose boxes are mostly air.

The asset database has one box for each asset. The shape follows from names (``Countertop_L_8x6``,
``Countertop_C_10x4``), and the sides of the arms from the objects on the counters: on 23 L counters of 60 houses, none
of 261 objects is in the (−x, +z) quarter of the asset's frame; on 12 C counters, none of 161 is beyond the arms along
−x, −z and +x; none at all is more than 0.55 m from the outer side. Straight counters of the same kit are 0.61 m deep.
"""

from __future__ import annotations

import re
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.scene import OrientedBox
from condvln.scene.boxes import rounded_box

__all__ = ["ARM_DEPTH", "counter_parts"]

F64 = NDArray[np.float64]

ARM_DEPTH: Final = 0.61
"""Depth of each arm in metres, from the outer to the inner side."""

_NAME: Final = re.compile(r"Countertop_(?P<shape>[LC])_\d+x\d+")
_ARMS: Final = {"L": ("+x", "-z"), "C": ("-x", "+x", "-z")}
"""Sides of the asset's box, in Unity's frame, along whose full length an arm runs."""


def counter_parts(asset_id: str, center: F64, size: F64, rotation: F64) -> tuple[OrientedBox, ...]:
    """Return the arms of a counter as boxes that overlap at the corners; empty for any other asset.

    Parameters
    ----------
    center : (3,) middle of the asset's box in the scene, metres
    size : (3,) its full lengths along the asset's axes
    rotation : (3, 3) from the asset's axes, Unity's mirrored in z, to the scene's
    """
    named = _NAME.fullmatch(asset_id)
    if named is None or not (size[[0, 2]] > ARM_DEPTH).all():
        return ()
    parts = []
    for side in _ARMS[named["shape"]]:
        axis = "xyz".index(side[1])
        # The asset's own z is mirrored by the conversion to Habitat's frame.
        sign = (1.0 if side[0] == "+" else -1.0) * (-1.0 if side[1] == "z" else 1.0)
        half, middle = size / 2, np.zeros(3)
        middle[axis] = sign * (half[axis] - ARM_DEPTH / 2)
        half = half.copy()
        half[axis] = ARM_DEPTH / 2
        parts.append(rounded_box(OrientedBox(center + rotation @ middle, half, rotation)))
    return tuple(parts)
