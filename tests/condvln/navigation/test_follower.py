"""Ground-truth walks: they arrive, they replay, and they are about as long as the geodesic."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.navigation.follower import FORWARD, LEFT, RIGHT, RXR, STOP, VLN_CE, ActionSpace, FollowedRoute, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from schemas.errors import UsageError


def check_walk(follower: Follower, route: FollowedRoute, start: np.ndarray, heading: float, goals: np.ndarray) -> None:
    """What must hold of every finished walk."""
    pathfinder = follower.pathfinder
    actions = route.actions.tolist()
    assert route.arrived
    assert actions[-1] == STOP
    assert actions.count(STOP) == 1
    assert set(actions) <= {STOP, FORWARD, LEFT, RIGHT}
    assert actions.count(FORWARD) == len(route.locations) - 1
    np.testing.assert_array_equal(route.locations[0], np.float32(start))
    # One action after the other through try_step ends in the same places.
    position, facing, places = np.float32(start), 0, [np.float32(start)]
    for action in actions:
        if action == FORWARD:
            angle = heading + facing * math.radians(follower.space.turn)
            move = np.float32([-math.sin(angle) * follower.space.forward, 0, -math.cos(angle) * follower.space.forward])
            take = pathfinder.try_step if follower.sliding else pathfinder.try_step_no_sliding
            position = take(position, position + move)
            places.append(position)
        elif action != STOP:
            facing = (facing + (1 if action == LEFT else -1)) % follower.space.headings
    np.testing.assert_array_equal(places, route.locations)
    walk = follower.walk(start, heading, actions)
    np.testing.assert_array_equal(walk.positions[-1], route.locations[-1])
    # Many walks together are those made one by one.
    aside = pathfinder.snap_point(np.float32(start) + np.float32([0.3, 0.0, 0.0]))
    begins = [(np.float32(start), heading), (aside, heading + 1.0), (np.float32(start), heading)]
    alone = [follower.follow(*begin, goals) for begin in begins]
    starts, headings = (list(part) for part in zip(*begins, strict=True))
    ends = np.reshape(goals, (-1, 3))
    asked = np.tile(ends, (3, 1)), len(ends) * np.arange(1, 4)
    assert follower.lengths(starts, headings, *asked) == [(len(one.actions), one.outcome) for one in alone]
    # Each goal is met on the way, in order.
    assert np.all(np.diff(route.arrivals) >= 0)
    for goal, arrival in zip(goals.reshape(-1, 3), route.arrivals, strict=True):
        assert pathfinder.geodesic_distance(route.locations[arrival], goal) <= follower.arrive_within
    assert route.distance_to_goal <= follower.arrive_within


@pytest.mark.parametrize("sliding", [True, False])
@pytest.mark.parametrize("space", [VLN_CE, RXR])
@given(data=st.data())
def test_walks_on_the_l_arrive(l_shape: Pathfinder, space: ActionSpace, sliding: bool, data: st.DataObject) -> None:
    seed = data.draw(st.integers(0, 10_000))
    heading = data.draw(st.floats(-7, 7))
    start, *goals = l_shape.get_random_navigable_points(3, seed)
    follower = Follower(l_shape, space, sliding=sliding)
    route = follower.follow(start, heading, np.array(goals))
    check_walk(follower, route, start, heading, np.array(goals))


@pytest.mark.parametrize("sliding", [True, False])
@pytest.mark.parametrize("space", [VLN_CE, RXR])
def test_walks_in_a_real_home_arrive(
    home: Pathfinder, home_points: np.ndarray, space: ActionSpace, sliding: bool
) -> None:
    follower = Follower(home, space, sliding=sliding)
    walked = geodesic = 0.0
    for number, (start, end) in enumerate(zip(home_points[:60], home_points[60:120], strict=True)):
        distance = home.geodesic_distance(start, end)
        route = follower.follow(start, 0.1 * number, end)
        if not np.isfinite(distance):
            assert route.outcome == "no path"
            assert route.arrivals.tolist() == [-1]
            continue
        check_walk(follower, route, start, 0.1 * number, end)
        walked += float(np.linalg.norm(np.diff(route.locations, axis=0), axis=1).sum()) + route.distance_to_goal
        geodesic += distance
    assert walked / geodesic < 1.1


@pytest.mark.soak
@pytest.mark.parametrize("sliding", [True, False])
@pytest.mark.parametrize("space", [VLN_CE, RXR])
def test_walks_on_every_real_navmesh_arrive(real_data: Path, space: ActionSpace, sliding: bool) -> None:
    for file in sorted(real_data.rglob("*.navmesh")):
        pathfinder = Pathfinder.load(file)
        if pathfinder.navigable_area == 0:
            continue
        points = pathfinder.get_random_navigable_points(16, 3)
        follower = Follower(pathfinder, space, sliding=sliding)
        for number, (start, end) in enumerate(zip(points[:8], points[8:], strict=True)):
            if np.isfinite(pathfinder.geodesic_distance(start, end)):
                route = follower.follow(start, 0.7 * number, end)
                check_walk(follower, route, start, 0.7 * number, end)


def test_straight_ahead_needs_no_turn(l_shape: Pathfinder) -> None:
    """2 m due north (−z) from z = 3.5: seven steps of 0.25 m bring it within 0.25 m."""
    route = Follower(l_shape).follow([1, 0, 3.5], 0.0, [1, 0, 1.5])
    assert route.actions.tolist() == [FORWARD] * 7 + [STOP]
    np.testing.assert_allclose(route.locations[:, 2], 3.5 - 0.25 * np.arange(8), atol=1e-6)
    assert route.distance_to_goal == pytest.approx(0.25, abs=1e-6)


def test_turns_go_the_short_way(l_shape: Pathfinder) -> None:
    """Facing −z, east (+x) is six turns of 15° right, and west six turns left."""
    east = Follower(l_shape).follow([1, 0, 1], 0.0, [3, 0, 1])
    west = Follower(l_shape).follow([3, 0, 1], 0.0, [1, 0, 1])
    assert east.actions[:7].tolist() == [RIGHT] * 6 + [FORWARD]
    assert west.actions[:7].tolist() == [LEFT] * 6 + [FORWARD]


def test_start_at_the_goal_stops_at_once(l_shape: Pathfinder) -> None:
    route = Follower(l_shape).follow([1, 0, 1], 0.3, [1.1, 0, 1.1])
    assert route.actions.tolist() == [STOP]
    assert route.locations.shape == (1, 3)
    assert route.arrivals.tolist() == [0]


def test_a_corridor_too_narrow_for_the_turns() -> None:
    """5 cm wide, at a heading that no turn of 30° brings in line: walked from wall to wall without sliding."""
    corridor = Pathfinder.from_tile(
        tile_of_polygons([[0, 0, 0], [0.05, 0, 0], [0.05, 0, 6], [0, 0, 6]], [[0, 1, 2, 3]])
    )
    for sliding in (True, False):
        follower = Follower(corridor, RXR, sliding=sliding)
        start, heading, goal = np.float32([0.025, 0, 5.9]), math.radians(15), np.float32([0.025, 0, 0.1])
        route = follower.follow(start, heading, goal)
        check_walk(follower, route, start, heading, goal)


def test_unreachable_and_too_long(two_islands: Pathfinder, l_shape: Pathfinder) -> None:
    lost = Follower(two_islands).follow([0.5, 0, 0.5], 0.0, [5.5, 1, 0.5])
    assert lost.outcome == "no path"
    assert lost.actions.tolist() == [STOP]
    assert lost.distance_to_goal == math.inf
    tired = Follower(l_shape, max_actions=3).follow([1, 0, 3.5], 0.0, [1, 0, 0.5])
    assert tired.outcome == "too long"
    assert tired.actions.tolist() == [FORWARD] * 3 + [STOP]
    assert tired.arrivals.tolist() == [-1]


def test_poses_of_a_walk(l_shape: Pathfinder) -> None:
    walk = Follower(l_shape).walk([1, 0, 1], 0.0, [LEFT, LEFT, RIGHT, FORWARD, STOP])
    np.testing.assert_allclose(np.degrees(walk.headings), [0, 15, 30, 15, 15, 15], atol=1e-9)
    expected = [1 - 0.25 * math.sin(math.radians(15)), 0, 1 - 0.25 * math.cos(math.radians(15))]
    np.testing.assert_allclose(walk.positions[-1], expected, atol=1e-6)
    np.testing.assert_array_equal(walk.positions[:4], np.float32([[1, 0, 1]] * 4))


def test_spaces_and_distances_are_checked(l_shape: Pathfinder) -> None:
    for bad in ({"turn": 25.0}, {"turn": 0.0}, {"forward": -1.0}, {"forward": math.nan}):
        with pytest.raises(UsageError):
            ActionSpace(**bad)
    for bad in ({"stop_within": 0.0}, {"stop_within": 0.6}, {"arrive_within": math.inf}, {"max_actions": 0}):
        with pytest.raises(UsageError):
            Follower(l_shape, **bad)
    with pytest.raises(UsageError, match="heading"):
        Follower(l_shape).follow([1, 0, 1], math.nan, [2, 0, 1])
