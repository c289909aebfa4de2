"""Paths, snapping, islands and movement against closed forms, on floors built in the test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.navigation.settings import NavMeshSettings
from schemas.errors import InputError, UsageError

CORNER = np.array([2.0, 2.0])
VERTICES = [[0, 0, 0], [4, 0, 0], [4, 0, 2], [2, 0, 2], [0, 0, 2], [2, 0, 4], [0, 0, 4]]  # of the L
AWAY = [100.0, 0.0, 100.0]

along = st.floats(0.015625, 3.984375, width=32)


def on_l(x: float, z: float) -> bool:
    """Inside the L, a centimetre from its walls."""
    return z < 1.99 or (x < 1.99 and z < 3.99)


def l_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Shortest path on the L: straight where the segment passes inside the reflex corner, else by way of it."""
    direct = b - a
    to_corner = CORNER - a
    crosses = (a[1] - 2.0) * (b[1] - 2.0) < 0
    beyond = False
    if crosses:
        x_at_seam = a[0] + direct[0] * (2.0 - a[1]) / direct[1]
        beyond = x_at_seam > 2.0
    if not beyond:
        return float(np.hypot(*direct))
    return float(np.hypot(*to_corner) + np.hypot(*(b - CORNER)))


@given(along, along, along, along)
def test_geodesic_on_the_l_is_the_closed_form(l_shape: Pathfinder, ax: float, az: float, bx: float, bz: float) -> None:
    if not (on_l(ax, az) and on_l(bx, bz)):
        return
    path = l_shape.find_path([ax, 0, az], [bx, 0, bz])
    assert path.geodesic_distance == pytest.approx(l_distance(np.array([ax, az]), np.array([bx, bz])), abs=2e-3)
    lengths = np.linalg.norm(np.diff(path.points, axis=0), axis=1)
    # Two points that Magnum calls equal (to 1e-5 per coordinate and relative) are 0 apart.
    assert path.geodesic_distance == pytest.approx(lengths.sum(), rel=1e-6, abs=2e-4)


def test_length_counts_height() -> None:
    """A ramp of 3 m rising 4 m: its middle line is 5 m long."""
    ramp = Pathfinder.from_tile(tile_of_polygons([[0, 0, 0], [3, 4, 0], [3, 4, 1], [0, 0, 1]], [[0, 1, 2], [0, 2, 3]]))
    assert ramp.geodesic_distance([0, 0, 0.5], [3, 4, 0.5]) == pytest.approx(5.0, rel=1e-6)
    assert ramp.navigable_area == pytest.approx(5.0, rel=1e-6)
    assert ramp.snap_point([1.5, 1.7, 0.5])[1] == pytest.approx(2.0, abs=1e-6)


def test_a_point_off_the_mesh_snaps_to_nan_and_is_infinitely_far(l_shape: Pathfinder) -> None:
    assert np.isnan(l_shape.snap_point(AWAY)).all()
    for bad in (AWAY, [np.nan, 0, 0], [np.inf, 0, 0]):
        path = l_shape.find_path([1, 0, 1], bad)
        assert not path.found
        assert path.geodesic_distance == float("inf")
        assert path.closest_goal == -1
        assert path.points.shape == (0, 3)
        assert l_shape.get_island(bad) == -1
        assert l_shape.island_radius(bad) == 0.0
        assert not l_shape.is_navigable(bad)
        assert l_shape.distance_to_closest_obstacle(bad) == float("inf")


def test_islands_part_what_no_edge_joins(two_islands: Pathfinder) -> None:
    small, large = [0.5, 0, 0.5], [5.5, 1, 0.5]
    assert two_islands.num_islands == 2
    assert two_islands.get_islands([small, large]).tolist() == [0, 1]
    assert two_islands.geodesic_distance(small, large) == float("inf")
    assert [two_islands.island_area(i) for i in range(2)] == pytest.approx([1.0, 3.0])
    assert two_islands.navigable_area == pytest.approx(4.0)
    assert two_islands.island_radius(0) == pytest.approx(np.hypot(0.5, 0.5))
    assert two_islands.island_radius(large) == pytest.approx(np.hypot(1.5, 0.5))
    # Snapping to a chosen island passes over the nearer one.
    between = [2.4, 0.5, 0.5]
    np.testing.assert_array_equal(two_islands.snap_point(between), np.float32([1, 0, 0.5]))
    np.testing.assert_array_equal(two_islands.snap_point(between, island_index=0), np.float32([1, 0, 0.5]))
    np.testing.assert_array_equal(two_islands.snap_point(between, island_index=1), np.float32([4, 1, 0.5]))
    with pytest.raises(UsageError, match="there is no island 2"):
        two_islands.snap_point(small, island_index=2)


def test_navigability_tolerances(l_shape: Pathfinder) -> None:
    assert l_shape.is_navigable([1, 0.49, 1])
    assert not l_shape.is_navigable([1, 0.51, 1])
    assert l_shape.is_navigable([1, 0.51, 1], max_y_delta=0.6)
    assert l_shape.is_navigable([-0.009, 0, 1])
    assert not l_shape.is_navigable([-0.011, 0, 1])


def test_steps_against_a_wall(l_shape: Pathfinder) -> None:
    """Into the wall x = 4 at 45°: sliding keeps z, stopping ends where the ray meets the wall."""
    start, end = [3.8, 0, 1.0], [4.2, 0, 1.4]
    np.testing.assert_allclose(l_shape.try_step(start, end), [4.0, 0, 1.4], atol=1e-6)
    np.testing.assert_allclose(l_shape.try_step_no_sliding(start, end), [4.0, 0, 1.2], atol=1e-6)
    inside = [3.6, 0, 0.9]
    np.testing.assert_array_equal(l_shape.try_step(start, inside), np.float32(inside))
    np.testing.assert_array_equal(l_shape.try_step(start, AWAY), np.float32(start))
    np.testing.assert_array_equal(l_shape.try_step(AWAY, start), np.float32(AWAY))


@given(along, along)
def test_distance_to_walls_is_the_closed_form(l_shape: Pathfinder, x: float, z: float) -> None:
    if not on_l(x, z):
        return
    walls = [x, z]  # x = 0 and z = 0, and the rest of the outline as clamped segments
    segments = [((4, 0), (4, 2)), ((2, 2), (4, 2)), ((2, 2), (2, 4)), ((0, 4), (2, 4))]
    for (ax, az), (bx, bz) in segments:
        nx, nz = np.clip(x, min(ax, bx), max(ax, bx)), np.clip(z, min(az, bz), max(az, bz))
        walls.append(float(np.hypot(x - nx, z - nz)))
    record = l_shape.closest_obstacle_surface_point([x, 0, z], 9.0)
    assert record.hit_dist == pytest.approx(min(walls), abs=1e-6)
    back = record.hit_pos + record.hit_normal * np.float32(record.hit_dist)
    np.testing.assert_allclose(back, [x, 0, z], atol=1e-5)


def test_top_down_view_shows_the_l(l_shape: Pathfinder) -> None:
    view = l_shape.get_topdown_view(0.1, 0.0)
    assert view.shape == (40, 40)
    centres = (np.arange(40) * 0.1)[None, :], (np.arange(40) * 0.1)[:, None]
    expected = ~((centres[0] > 2.05) & (centres[1] > 2.05))
    np.testing.assert_array_equal(view, expected)
    assert not l_shape.get_topdown_view(0.1, 2.0).any()
    for bad in (0.0, -1.0, float("nan"), 1e-9):
        with pytest.raises(UsageError, match="per pixel"):
            l_shape.get_topdown_view(bad, 0.0)


def test_bounds_settings_and_save(l_shape: Pathfinder, tmp_path: Path) -> None:
    low, high = l_shape.bounds
    np.testing.assert_array_equal([low, high], np.float32([[0, 0, 0], [4, 1.5, 4]]))
    assert l_shape.settings == NavMeshSettings()
    assert l_shape.settings.fits(0.1, 1.5, 0.2, 45.0)
    assert not l_shape.settings.fits(0.3, 1.5, 0.2, 45.0)
    l_shape.save(tmp_path / "l.navmesh")
    again = Pathfinder.load(tmp_path / "l.navmesh")
    assert again.navmesh.to_bytes() == l_shape.navmesh.to_bytes()
    assert again.find_path([3.5, 0, 1.0], [1.0, 0, 3.5]).geodesic_distance == pytest.approx(3.605551, abs=1e-5)


def test_shapes_of_arguments_are_checked(l_shape: Pathfinder) -> None:
    with pytest.raises(UsageError, match="a point must have the shape"):
        l_shape.snap_point([1, 2])
    with pytest.raises(UsageError, match="points must have the shape"):
        l_shape.snap_points([[1, 2], [3, 4]])
    with pytest.raises(UsageError, match="2 starts and 3 ends"):
        l_shape.geodesic_distances(np.zeros((2, 3)), np.zeros((3, 3)))
    assert l_shape.geodesic_distances(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    assert l_shape.distance_table(np.zeros((0, 3)), np.zeros((2, 3))).shape == (0, 2)


@pytest.mark.parametrize(
    ("polygons", "message"),
    [
        ([[0, 1]], "2 corners"),
        ([[0, 1, 1]], "3 corners"),
        ([[0, 1, 9]], "unknown vertex"),
        ([[0, 1, 3, 5, 6]], "not convex"),
        ([[0, 1, 2], [0, 1, 3], [0, 1, 5]], "3 polygons share"),
        ([], "0 polygons"),
    ],
)
def test_floors_that_are_no_floors(polygons: list[list[int]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        tile_of_polygons(VERTICES, polygons)
    with pytest.raises(InputError, match="NaN"):
        tile_of_polygons([[np.nan, 0, 0], *VERTICES[1:]], [[0, 1, 2]])
