"""Ways, headings and gaps between objects against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import LineString, Point

from condvln.episodes.kernels.distances import comes_within
from condvln.episodes.placing import heading_degrees, yaw_quaternion
from condvln.episodes.starts import GoalField
from tests.condvln.episodes.floors import grid_floor

flat_points = st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=2, max_size=6).map(
    lambda pairs: np.array([[round(x, 3), 0.0, round(z, 3)] for x, z in pairs])
)


@given(flat_points, flat_points)
def test_a_way_comes_as_near_as_shapely_says(path: np.ndarray, points: np.ndarray) -> None:
    line = LineString(path[:, [0, 2]])
    expected = min(line.distance(Point(x, z)) for x, _, z in points)
    assert comes_within(path, points, expected + 1e-9)
    assert not comes_within(path, points, expected - 1e-9)


def test_nearness_counts_height() -> None:
    path = np.array([[0, 0, 0], [1, 0, 0.0]])
    point = np.array([[0.5, 3.0, 4.0]])
    assert [comes_within(path, point, limit) for limit in (4.999, 5.001)] == [False, True]


@pytest.mark.parametrize(
    ("yaw", "heading"), [(0, 0), (-math.pi / 2, 90), (math.pi, 180), (math.pi / 2, 270), (-math.pi, 180)]
)
def test_heading_is_clockwise_from_north(yaw: float, heading: float) -> None:
    assert heading_degrees(yaw) == heading


@given(st.floats(-math.pi, math.pi))
def test_quaternion_turns_the_forward_axis_to_the_heading(yaw: float) -> None:
    x, y, z, w = yaw_quaternion(yaw)
    # Rotating −Z by a quaternion about +Y, written out.
    forward = np.array([-2 * y * w, 0.0, -(1 - 2 * y * y)])
    heading = math.radians(heading_degrees(yaw))
    np.testing.assert_allclose(forward, [math.sin(heading), 0, -math.cos(heading)], atol=1e-6)
    assert x == z == 0.0


def test_objects_are_apart_by_the_least_way_in_either_direction() -> None:
    rng = np.random.default_rng(4)
    solid = rng.random((24, 24)) < 0.3
    floor = grid_floor(6, 6, lambda x, z: bool(solid[int(x / 0.25), int(z / 0.25)]))
    points = floor.get_random_navigable_points(300, np.random.default_rng(1)).astype(np.float64).round(3)
    goals = {f"object {k}": points[2 * k : 2 * k + 2] for k in range(150)}
    table = floor.distance_table(points, points).astype(np.float64)
    table[~np.isfinite(table)] = np.inf
    one_way = table.reshape(150, 2, 150, 2).min(axis=(1, 3))
    assert ((one_way >= 2.5) & (one_way.T < 2.49)).any(), "on this floor the direction decides"
    gaps = np.minimum(one_way, one_way.T)
    np.fill_diagonal(gaps, 0.0)
    field, backwards = GoalField(floor, goals), GoalField(floor, dict(reversed(goals.items())))
    for least in (2.5, 0.4, 1.0, 4.0):
        np.testing.assert_array_equal(field.apart(least), gaps >= least)
        np.testing.assert_array_equal(backwards.apart(least)[::-1, ::-1], gaps >= least)
    for one, other in rng.integers(150, size=(40, 2)).tolist():
        if one != other:
            assert field.gap(one, other) == gaps[one, other]
