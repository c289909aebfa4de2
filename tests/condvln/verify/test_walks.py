"""Actions that this package executes, and entries that are no ground truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.verify.records import _told, executed

CORNERS = np.array([[0, 0, 0], [4, 0, 0], [4, 0, 1], [1, 0, 1], [1, 0, 4], [0, 0, 4]], np.float32)
START, STOPS = (3.5, 0.0, 0.5), ((2.0, 0.0, 0.5), (0.5, 0.0, 3.5))


@pytest.fixture(scope="module")
def follower() -> Follower:
    return Follower(Pathfinder.from_tile(tile_of_polygons(CORNERS, [[0, 1, 2, 3], [0, 3, 4, 5]])))


def test_poses_of_actions_are_those_of_habitat_s_agent(follower: Follower) -> None:
    """Of a walk that was made, of the same actions from elsewhere or facing elsewhere, and of others that slide along
    walls; all together and each alone.
    """
    known = follower.follow(START, 0.3, STOPS).actions
    other = np.array([LEFT, FORWARD, RIGHT, RIGHT, *[FORWARD] * 30, STOP, *[LEFT] * 30, *[FORWARD] * 9], np.int8)
    asked = [
        (start, yaw, actions)
        for start, yaw in ((START, 0.3), (START, 0.4), ((3.4, 0.0, 0.5), 6.0))
        for actions in (known, other, known[:-1], known[:0], other[::-1])
    ]
    starts, yaws, taken = zip(*asked, strict=True)
    together = executed(follower.pathfinder, starts, yaws, taken)
    for (start, yaw, actions), (places, facing) in zip(asked, together, strict=True):
        expected = follower.walk(start, yaw, actions)
        np.testing.assert_array_equal(places, expected.positions)
        np.testing.assert_allclose(np.exp(1j * facing), np.exp(1j * expected.headings), atol=1e-12)
        np.testing.assert_array_equal(executed(follower.pathfinder, [start], [yaw], [actions])[0][0], places)
    assert executed(follower.pathfinder, [], [], []) == []


@pytest.mark.parametrize(
    "change", [{"actions": [300]}, {"locations": [[10**400, 0, 0]]}, {"actions": [1, [2]]}, {"actions": {}}]
)
def test_a_ground_truth_of_impossible_numbers_is_malformed(change: dict[str, Any]) -> None:
    assert _told({"locations": [[0, 0, 0]], "forward_steps": 0, "actions": [0]}) is not None
    assert _told({"locations": [[0, 0, 0]], "forward_steps": 0, "actions": [0], **change}) is None
