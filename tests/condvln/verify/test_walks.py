"""Walks that are made once are those that would be made each time."""

from __future__ import annotations

import numpy as np
import pytest

from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.verify.walks import Walks

CORNERS = np.array([[0, 0, 0], [4, 0, 0], [4, 0, 1], [1, 0, 1], [1, 0, 4], [0, 0, 4]], np.float32)
START, STOPS = (3.5, 0.0, 0.5), ((2.0, 0.0, 0.5), (0.5, 0.0, 3.5))


@pytest.fixture(scope="module")
def follower() -> Follower:
    return Follower(Pathfinder.from_tile(tile_of_polygons(CORNERS, [[0, 1, 2, 3], [0, 3, 4, 5]])))


def replayed(follower: Follower, start: tuple[float, ...], yaw: float, actions: np.ndarray) -> np.ndarray:
    walk = follower.walk(start, yaw, actions)
    return walk.positions[[0, *(np.flatnonzero(actions == FORWARD) + 1)]].astype(np.float64)


def test_a_walk_is_made_once_for_each_start_heading_and_stops(
    follower: Follower, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    made = follower.follow
    monkeypatch.setattr(follower, "follow", lambda *given: asked.append(given) or made(*given))
    walks = Walks(follower)
    ways = [(START, 0.3, STOPS), (START, 0.4, STOPS), (START, 0.3, STOPS[:1]), ((3.4, 0.0, 0.5), 0.3, STOPS)]
    for _ in range(2):
        for way in ways:
            route, again = walks.to(*way), made(*way)
            assert route.arrived
            np.testing.assert_array_equal(route.actions, again.actions)
            np.testing.assert_array_equal(route.locations, again.locations)
    assert asked == ways


def test_places_of_actions_are_those_of_executing_them(follower: Follower) -> None:
    """Of a walk that was made, of the same actions from elsewhere or facing elsewhere, and of other actions."""
    walks = Walks(follower)
    known = walks.to(START, 0.3, STOPS).actions
    other = np.array([LEFT, FORWARD, RIGHT, RIGHT, *[FORWARD] * 30, STOP], np.int8)
    for start, yaw in ((START, 0.3), (START, 0.4), ((3.4, 0.0, 0.5), 0.3)):
        for actions in (known, other, known[:-1]):
            expected = replayed(follower, start, yaw, actions)
            for _ in range(2):
                np.testing.assert_array_equal(walks.along(start, yaw, actions), expected)
