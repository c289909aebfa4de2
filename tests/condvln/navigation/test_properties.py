"""What must hold of every query on a real home, wherever the points lie."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.navigation.pathfinder import Pathfinder

which = st.integers(0, 299)
shift = st.tuples(*[st.floats(-3, 3, width=32)] * 3)


@given(which, which)
def test_paths_are_no_shorter_than_the_crow_flies(home: Pathfinder, home_points: np.ndarray, i: int, j: int) -> None:
    start, end = home_points[i], home_points[j]
    path = home.find_path(start, end)
    same_island = home.get_island(start) == home.get_island(end)
    assert path.found == same_island
    if not path.found:
        assert len(path.points) == 0
        return
    # Points on the floor stay as asked for; height is the polygon's only at corners.
    np.testing.assert_allclose(path.points[[0, -1]], [start, end], atol=1e-3)
    steps = np.linalg.norm(np.diff(path.points.astype(np.float64), axis=0), axis=1)
    assert path.geodesic_distance == pytest.approx(steps.sum(), rel=1e-5, abs=1e-5)
    assert path.geodesic_distance >= np.linalg.norm(end.astype(np.float64) - start) - 1e-3


@given(which, shift, st.booleans())
def test_steps_stay_on_the_island_and_near_their_aim(
    home: Pathfinder, home_points: np.ndarray, i: int, by: tuple[float, float, float], sliding: bool
) -> None:
    start = home_points[i]
    end = start + np.float32([by[0] / 4, 0, by[2] / 4])
    reached = (home.try_step if sliding else home.try_step_no_sliding)(start, end)
    assert home.get_island(reached) == home.get_island(start)
    ground = [0, 2]
    asked = np.linalg.norm((end - start)[ground])
    # A step ends at the wall's point nearest to its end, which may lie a little beyond its length. So it does, now and
    # then, without sliding: habitat-sim looks for the wall in the way among the polygons that the slide went through.
    assert np.linalg.norm((reached - end)[ground]) <= asked * (1 + 1e-4) + 1e-3
    if np.array_equal(reached[ground], end[ground]):
        assert home.is_navigable(reached)


@given(which)
def test_the_nearest_wall_bounds_a_free_step(home: Pathfinder, home_points: np.ndarray, i: int) -> None:
    """In any direction a step shorter than the distance to the nearest wall is made in full."""
    point = home_points[i]
    free = home.distance_to_closest_obstacle(point)
    for angle in np.arange(0, 2 * np.pi, np.pi / 4):
        end = point + np.float32(0.98 * min(free, 2.0)) * np.float32([np.sin(angle), 0, np.cos(angle)])
        reached = home.try_step_no_sliding(point, end)
        np.testing.assert_allclose(reached[[0, 2]], end[[0, 2]], atol=1e-5)


@given(st.lists(st.tuples(which, which), min_size=1, max_size=12))
def test_batches_change_no_number(home: Pathfinder, home_points: np.ndarray, pairs: list[tuple[int, int]]) -> None:
    starts, ends = (home_points[[pair[side] for pair in pairs]] for side in (0, 1))
    alone = np.array([home.geodesic_distance(a, b) for a, b in zip(starts, ends, strict=True)], np.float32)
    np.testing.assert_array_equal(home.geodesic_distances(starts, ends), alone)
    table = home.distance_table(starts, ends)
    np.testing.assert_array_equal(np.diagonal(table), alone)
    np.testing.assert_array_equal(home.geodesic_distances(starts[0], ends), table[0])
    np.testing.assert_array_equal(home.geodesic_distances(starts, ends[0]), table[:, 0])
    for path, single in zip(home.find_paths(starts, ends), map(home.find_path, starts, ends), strict=True):
        np.testing.assert_array_equal(path.points, single.points)


@given(st.integers(0, 2**32 - 1))
def test_random_points_repeat_and_are_on_the_floor(home: Pathfinder, seed: int) -> None:
    points = home.get_random_navigable_points(20, seed)
    assert home.are_navigable(points, max_y_delta=1e-3).all()
    np.testing.assert_array_equal(points, home.get_random_navigable_points(20, np.random.default_rng(seed)))
    for island in range(home.num_islands):
        chosen = home.get_random_navigable_points(5, seed, island)
        np.testing.assert_allclose(home.snap_points(chosen, island), chosen, atol=1e-3)
    centre = points[0]
    near = home.get_random_navigable_point_near(centre, 0.7, rng=seed)
    if not np.isnan(near).any():
        assert np.linalg.norm(near - centre) <= 0.7
        assert home.is_navigable(near)


def test_random_points_are_spread_by_area(home: Pathfinder, l_shape: Pathfinder) -> None:
    """Shares of 40,000 points, to five standard errors."""
    count = 40_000
    points = home.get_random_navigable_points(count, 5)
    shares = np.bincount(home.get_islands(points), minlength=home.num_islands) / count
    for island, share in enumerate(shares):
        expected = home.island_area(island) / home.navigable_area
        # Islands are weighed by their polygons, areas counted on the detail mesh: they agree to a thousandth.
        assert share == pytest.approx(expected, abs=5 * np.sqrt(expected * (1 - expected) / count) + 2e-3)
    on_l = l_shape.get_random_navigable_points(count, 6)
    cells, _, _ = np.histogram2d(on_l[:, 0], on_l[:, 2], bins=[[0, 1, 2, 3, 4], [0, 1, 2, 3, 4]])
    expected_cells = np.array([[1, 1, 1, 1], [1, 1, 1, 1], [1, 1, 0, 0], [1, 1, 0, 0]]) / 12
    error = 5 * np.sqrt(expected_cells * (1 - expected_cells) / count)
    assert (np.abs(cells / count - expected_cells) <= error).all()


def test_a_point_near_nothing_is_nan(l_shape: Pathfinder) -> None:
    assert np.isnan(l_shape.get_random_navigable_point_near([50, 0, 50], 1.0)).all()


@pytest.mark.soak
def test_real_navmeshes_agree_with_themselves(real_data: Path) -> None:
    """Batches, tables and single queries over every eighth of the real navmeshes."""
    for file in sorted(real_data.rglob("*.navmesh"))[::8]:
        pathfinder = Pathfinder.load(file)
        if pathfinder.navigable_area == 0:
            continue
        points = pathfinder.get_random_navigable_points(40, 1)
        table = pathfinder.distance_table(points, points)
        for i, j in np.random.default_rng(2).integers(0, 40, (60, 2)):
            assert np.float32(pathfinder.geodesic_distance(points[i], points[j])) == table[i, j]
        islands = pathfinder.get_islands(points)
        assert (np.isfinite(table) == (islands[:, None] == islands[None, :])).all(), file
