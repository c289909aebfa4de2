"""Where a walk goes: which stops it passes in turn, how far it ends from the goals, and how far it is off the places
that are claimed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import compiled, register_warm_up

__all__ = ["passed_and_left"]

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


@compiled
def _metres(one: F64, other: F64) -> float:
    x, y, z = one[0] - other[0], one[1] - other[1], one[2] - other[2]
    return math.sqrt(x * x + y * y + z * z)


@compiled
def passed_and_left(along: F64, stops: F64, goals: F64, radius: float) -> tuple[Bools, float]:
    """Return whether a walk along places (n, 3) passes each of the stops (s, 3) in turn within `radius` metres, and the
    metres from its end to the nearest of the goals (g, 3).
    """
    passed = np.zeros(len(stops), dtype=np.bool_)
    at = 0
    for stop in range(len(stops)):
        for place in range(at, len(along)):
            if _metres(along[place], stops[stop]) <= radius:
                passed[stop], at = True, place
                break
    left = np.inf
    for goal in range(len(goals)):
        left = min(left, _metres(goals[goal], along[len(along) - 1]))
    return passed, left


def _warm_up() -> None:
    place = np.zeros((1, 3))
    passed_and_left(place, place, place, 1.0)


register_warm_up("stops passed", _warm_up)
