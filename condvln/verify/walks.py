"""The walks of a scene's episodes, each made once, and all together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.follower import Follower, Length
from condvln.verify.geodesics import Point

__all__ = ["Walks"]

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class Walks:
    """Walks on one navmesh. Leaves of several episodes share walks. A ground truth is executed by itself, so that its
    places are not those which planning it gave.
    """

    def __init__(self, follower: Follower) -> None:
        self._follower = follower

    def lengths(self, points: F64, starts: I64, yaws: F64, stops: I64, ends: I64) -> list[Length]:
        """Return how long each of n walks is. Equal walks are made once.

        points (p, 3) : of the scene; starts (n,) : index of the point at which each walk begins
        yaws (n,) : the heading there in radians
        stops (k,), ends (n,) : indices of the points at which the walks stop in turn, all concatenated, and the end
            index of each walk's stops
        """
        where, at = stops.tolist(), 0
        numbers: dict[tuple[float, ...], int] = {}
        which: list[int] = []
        first: list[int] = []
        for number, (start, yaw, end) in enumerate(zip(starts.tolist(), yaws.tolist(), ends.tolist(), strict=True)):
            found = numbers.setdefault((yaw, start, *where[at:end]), len(numbers))
            if found == len(first):
                first.append(number)
            which.append(found)
            at = end
        if not first:
            return []
        chosen = np.array(first)
        sizes = np.diff(ends, prepend=0)
        kept = np.zeros(len(sizes), dtype=bool)
        kept[chosen] = True
        made = self._follower.lengths(
            points[starts[chosen]],
            yaws[chosen].tolist(),
            points[stops[np.repeat(kept, sizes)]],
            np.cumsum(sizes[chosen]),
        )
        return [made[number] for number in which]

    def along(self, starts: Sequence[Point], yaws: Sequence[float], actions: Sequence[NDArray[np.int8]]) -> list[F64]:
        """Return the positions (n, 3) of each agent that executes its actions: its start, then its position after each
        forward step.
        """
        places = self._follower.places(starts, yaws, [taken.reshape(-1) for taken in actions])
        return [np.asarray(its, dtype=np.float64) for its in places]
