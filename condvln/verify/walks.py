"""The walks of a scene's episodes, each made once, and all together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.follower import Follower, Length
from condvln.verify.geodesics import Point

__all__ = ["Walks", "Way"]

F64 = NDArray[np.float64]
Way = tuple[Point, float, tuple[Point, ...]]
"""A start, the heading there in radians, and the stops in turn."""


class Walks:
    """Walks on one navmesh. Leaves of several episodes share walks. A ground truth is executed by itself, so that its
    places are not those which planning it gave.
    """

    def __init__(self, follower: Follower) -> None:
        self._follower = follower
        self._lengths: dict[Way, Length] = {}

    def ask(self, ways: Iterable[Way]) -> None:
        """Make all walks that were not made before."""
        new = [way for way in dict.fromkeys(ways) if way not in self._lengths]
        starts, headings, stops = zip(*new, strict=True) if new else ((), (), ())
        self._lengths.update(zip(new, self._follower.lengths(starts, headings, stops), strict=True))

    def length(self, way: Way) -> Length:
        """Return how long a walk is that was asked for."""
        return self._lengths[way]

    def along(self, starts: Sequence[Point], yaws: Sequence[float], actions: Sequence[NDArray[np.int8]]) -> list[F64]:
        """Return the positions (n, 3) of each agent that executes its actions: its start, then its position after each
        forward step.
        """
        places = self._follower.places(starts, yaws, [taken.reshape(-1) for taken in actions])
        return [np.asarray(its, dtype=np.float64) for its in places]
