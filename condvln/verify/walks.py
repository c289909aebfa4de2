"""The walks of a scene's episodes, each made once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.follower import FORWARD, FollowedRoute, Follower
from condvln.verify.geodesics import Point

__all__ = ["Walks"]

F64 = NDArray[np.float64]


class Walks:
    """Walks on one navmesh. Leaves of several episodes share walks. A ground truth is executed by itself, so that its
    places are not those which planning it gave.
    """

    def __init__(self, follower: Follower) -> None:
        self._follower = follower
        self._routes: dict[tuple[Point, float, tuple[Point, ...]], FollowedRoute] = {}

    def to(self, start: Point, yaw: float, stops: tuple[Point, ...]) -> FollowedRoute:
        """Return the walk from ``start``, facing ``yaw`` in radians, to each of ``stops`` in turn."""
        key = (start, yaw, stops)
        route = self._routes.get(key)
        if route is None:
            route = self._routes[key] = self._follower.follow(start, yaw, stops)
        return route

    def along(self, start: Point, yaw: float, actions: NDArray[np.int8]) -> F64:
        """Return the positions (n, 3) of an agent that executes ``actions``: ``start``, then the position after each
        forward step.
        """
        places = self._follower.places(start, yaw, actions)
        moved = np.ones(len(places), dtype=bool)
        np.equal(actions.reshape(-1), FORWARD, out=moved[1:])
        return places[moved].astype(np.float64)
