"""Walks that are made once are those that would be made each time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.verify.ground_truth import _told
from condvln.verify.kernels.passing import passed_and_left
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
    asked: list[int] = []
    made = follower.lengths
    monkeypatch.setattr(follower, "lengths", lambda starts, *given: asked.append(len(starts)) or made(starts, *given))
    walks = Walks(follower)
    points = np.array([START, *STOPS, (3.4, 0.0, 0.5)])
    ways = [(0, 0.3, (1, 2)), (0, 0.4, (1, 2)), (0, 0.3, (1,)), (3, 0.3, (1, 2))]
    for these in (ways[:2], [*ways, *ways[::-1]], [], [ways[2], ways[2], ways[0]]):
        starts, yaws, stops = ([way[part] for way in these] for part in range(3))
        ends = np.cumsum([len(one) for one in stops]).astype(np.int64)
        flat = np.array([stop for one in stops for stop in one], np.int64)
        found = walks.lengths(points, np.array(starts, np.int64), np.array(yaws), flat, ends)
        for (start, yaw, own), length in zip(these, found, strict=True):
            route = follower.follow(points[start], yaw, points[list(own)])
            assert route.arrived
            assert length == (len(route.actions), "arrived")
            assert length.arrived
    assert asked == [2, 4, 2]


def test_places_of_actions_are_those_of_executing_them(follower: Follower) -> None:
    """Of a walk that was made, of the same actions from elsewhere or facing elsewhere, and of other actions."""
    walks = Walks(follower)
    known = follower.follow(START, 0.3, STOPS).actions
    other = np.array([LEFT, FORWARD, RIGHT, RIGHT, *[FORWARD] * 30, STOP], np.int8)
    asked = [
        (start, yaw, actions)
        for start, yaw in ((START, 0.3), (START, 0.4), ((3.4, 0.0, 0.5), 0.3))
        for actions in (known, other, known[:-1], known[:0], other[::-1].reshape(5, -1), other[:8].reshape(2, 2, 2))
    ]
    together = walks.along(*[list(part) for part in zip(*asked, strict=True)])
    for (start, yaw, actions), places in zip(asked, together, strict=True):
        expected = replayed(follower, start, yaw, actions.reshape(-1))
        np.testing.assert_array_equal(places, expected)
        np.testing.assert_array_equal(walks.along([start], [yaw], [actions])[0], expected)
    assert walks.along([], [], []) == []


def test_stops_are_passed_in_turn() -> None:
    """As NumPy finds it, for stops that are passed, missed, or passed too early."""
    rng = np.random.default_rng(3)
    found = set()
    for _ in range(200):
        along, stops = rng.uniform(0, 4, (rng.integers(1, 12), 3)), rng.uniform(0, 4, (rng.integers(0, 4), 3))
        goals, radius = rng.uniform(0, 4, (rng.integers(1, 5), 3)), rng.uniform(0.5, 2.5)
        at, expected = 0, []
        for stop in stops:
            near = np.flatnonzero(np.linalg.norm(along[at:] - stop, axis=1) <= radius)
            at += int(near[0]) if len(near) else 0
            expected.append(bool(len(near)))
        passed, left = passed_and_left(along, stops, goals, radius)
        assert passed.tolist() == expected
        assert left == np.linalg.norm(goals - along[-1], axis=1).min()
        found.add(tuple(expected))
    assert {(True, False), (False, True), (True, True)} <= found


@pytest.mark.parametrize(
    "change", [{"actions": [300]}, {"locations": [[10**400, 0, 0]]}, {"actions": [1, [2]]}, {"actions": {}}]
)
def test_a_ground_truth_of_impossible_numbers_is_malformed(change: dict[str, Any]) -> None:
    assert _told({"locations": [[0, 0, 0]], "forward_steps": 0, "actions": [0]}) is not None
    assert _told({"locations": [[0, 0, 0]], "forward_steps": 0, "actions": [0], **change}) is None
