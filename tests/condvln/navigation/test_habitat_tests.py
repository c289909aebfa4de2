"""The assertions of habitat-sim's own tests (tests/test_nav.py, tests/test_greedy_follower.py and
src/tests/PathFinderTest.cpp of habitat-sim, MIT licence) on our pathfinder and follower.

Habitat's scenes are not here; the real navmeshes of two other homes take their place. Not taken over: what needs a
simulator, and expected numbers of scenes that are not here.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from condvln.navigation.follower import RXR, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.protocol import MultiGoalShortestPath, ShortestPath
from schemas.errors import UsageError

HOMES = ("hm3d/TEEsavR23oF.basis.navmesh", "gibson/navmesh/Oyens.navmesh")


@pytest.fixture(params=HOMES)
def pathfinder(request: pytest.FixtureRequest, real_data: Path) -> Pathfinder:
    loaded = Pathfinder.load(real_data / request.param)
    assert loaded.is_loaded
    loaded.seed(42)
    return loaded


def test_a_pathfinder_is_empty_until_a_navmesh_is_loaded(pathfinder: Pathfinder, tmp_path: Path) -> None:
    file, other = tmp_path / "one.navmesh", tmp_path / "other.navmesh"
    empty = Pathfinder()
    assert not empty.is_loaded
    assert empty.save_nav_mesh(file) is empty.load_nav_mesh(file) is False
    for ask in (
        lambda: empty.get_bounds(),
        lambda: empty.navigable_area,
        lambda: empty.get_random_navigable_point(),
        lambda: empty.snap_point([0.0, 0.0, 0.0]),
        lambda: empty.find_path([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
        lambda: empty.get_topdown_view(0.1, 0.0),
    ):
        with pytest.raises(UsageError, match="load_nav_mesh"):
            ask()
    assert pathfinder.save_nav_mesh(file)
    assert empty.load_nav_mesh(file)
    assert empty.is_loaded
    assert empty.navigable_area == pathfinder.navigable_area
    assert empty.nav_mesh_settings == pathfinder.nav_mesh_settings
    # What can't be loaded leaves the navmesh of before.
    other.write_bytes(file.read_bytes()[:-1])
    assert not empty.load_nav_mesh(other)
    assert empty.save_nav_mesh(other)
    assert other.read_bytes() == file.read_bytes()
    assert not empty.save_nav_mesh(file / "below a file")


def test_random_points_near(pathfinder: Pathfinder) -> None:
    for radius in (0.5, 5.0):
        for _ in range(100):
            point = pathfinder.get_random_navigable_point()
            near = pathfinder.get_random_navigable_point_near(point, radius, max_tries=100)
            assert pathfinder.is_navigable(near)
            assert np.linalg.norm(point - near) <= radius


def test_random_points_near_are_the_seeds(pathfinder: Pathfinder) -> None:
    centre = pathfinder.get_random_navigable_point()
    drawn = []
    for _ in range(2):
        pathfinder.seed(7)
        drawn.append([pathfinder.get_random_navigable_point_near(centre, 3.0) for _ in range(5)])
    np.testing.assert_array_equal(*drawn)
    assert len(np.unique(drawn[0], axis=0)) == 5
    one, other = (pathfinder.get_random_navigable_point_near(centre, 3.0, rng=3) for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_a_path_without_a_way(pathfinder: Pathfinder) -> None:
    path = ShortestPath(requested_start=pathfinder.get_random_navigable_point(), requested_end=np.full(3, 99999.0))
    assert len(path.points) == 0
    assert pathfinder.find_path(path) is False
    assert path.geodesic_distance == math.inf
    assert len(path.points) == 0
    with pytest.raises(UsageError, match="requested"):
        pathfinder.find_path(ShortestPath())
    with pytest.raises(UsageError, match="needs an end"):
        pathfinder.find_path([0.0, 0.0, 0.0])


def test_one_query_object_for_several_paths(pathfinder: Pathfinder) -> None:
    path = ShortestPath()
    for _ in range(20):
        path.requested_start, path.requested_end = (pathfinder.get_random_navigable_point() for _ in range(2))
        direct = pathfinder.find_path(path.requested_start, path.requested_end)
        assert pathfinder.find_path(path) is direct.found
        assert path.geodesic_distance == direct.geodesic_distance
        np.testing.assert_array_equal(path.points, direct.points)


def test_the_nearest_of_several_ends(pathfinder: Pathfinder) -> None:
    for _ in range(50):
        start, *ends = (pathfinder.get_random_navigable_point() for _ in range(10))
        several = MultiGoalShortestPath(requested_start=start, requested_ends=ends)
        alone = [MultiGoalShortestPath(requested_start=start, requested_ends=[end]) for end in ends]
        single = [ShortestPath(requested_start=start, requested_end=end) for end in ends]
        found = [pathfinder.find_path(path) for path in alone]
        assert found == [pathfinder.find_path(path) for path in single]
        assert pathfinder.find_path(several) == any(found)
        assert [path.geodesic_distance for path in alone] == [path.geodesic_distance for path in single]
        assert several.geodesic_distance == min(path.geodesic_distance for path in alone)
        if any(found):
            assert 0 <= several.closest_end_point_index < len(ends)
            assert several.geodesic_distance == single[several.closest_end_point_index].geodesic_distance
            assert len(several.points) > 0
        else:
            assert several.closest_end_point_index == -1


def test_islands(pathfinder: Pathfinder) -> None:
    total = 0
    seen: set[tuple[float, ...]] = set()
    for island in range(pathfinder.num_islands):
        vertices = pathfinder.build_navmesh_vertices(island)
        indices = pathfinder.build_navmesh_vertex_indices(island)
        assert 0 < len(vertices) == len(indices)
        assert indices.max() < len(vertices)
        # As in habitat-sim, the triangles of an island are those that its area is the sum of.
        a, b, c = vertices[indices].reshape(-1, 3, 3).transpose(1, 0, 2)
        area = np.linalg.norm(np.cross(b - a, c - b), axis=1).sum() / 2
        assert pathfinder.island_area(island) == pytest.approx(area, rel=1e-3, abs=1e-4)
        own = {tuple(vertex) for vertex in vertices.tolist()}
        assert not own & seen, "a vertex is in two islands"
        seen |= own
        total += len(vertices)
        if pathfinder.island_area(island) < 0.5:
            continue
        point = pathfinder.get_random_navigable_point(island_index=island)
        near = pathfinder.get_random_navigable_point_near(circle_center=point, radius=0.5, island_index=island)
        assert np.linalg.norm(point - near) < 0.5
        for each in (point, near):
            assert pathfinder.is_navigable(each)
            assert pathfinder.get_island(each) == island
            assert np.allclose(each, pathfinder.snap_point(each, island), atol=1e-3)
        assert pathfinder.island_radius(point) == pathfinder.island_radius(island) > 0.0
    assert total == len(pathfinder.build_navmesh_vertices()) == len(pathfinder.build_navmesh_vertex_indices(-1))
    assert pathfinder.island_area() == pathfinder.navigable_area
    point = pathfinder.get_random_navigable_point()
    np.testing.assert_array_equal(pathfinder.snap_point(point, -1), pathfinder.snap_point(point))


def test_topdown_views(pathfinder: Pathfinder) -> None:
    height = float(pathfinder.build_navmesh_vertices(-1)[:, 1].min())
    binary = pathfinder.get_topdown_view(meters_per_pixel=0.1, height=height, eps=0.5)
    islands = pathfinder.get_topdown_island_view(0.1, height)
    low, high = pathfinder.get_bounds()
    assert binary.shape == islands.shape == tuple(int((high - low)[axis] / np.float32(0.1)) for axis in (2, 0))
    assert binary.any()
    np.testing.assert_array_equal(islands >= 0, binary)
    assert islands.max() < pathfinder.num_islands
    row, column = np.argwhere(binary)[len(np.argwhere(binary)) // 2]
    point = [low[0] + 0.1 * column, height, low[2] + 0.1 * row]
    assert islands[row, column] == pathfinder.get_island(point)


@pytest.mark.parametrize(("sliding", "acceptable"), [(True, 0.97), (False, 0.925)])
def test_greedy_follower(pathfinder: Pathfinder, sliding: bool, acceptable: float) -> None:
    """SPL of 100 walks by turns of 30° that stop within three quarters of a step."""
    pathfinder.seed(0)
    follower = Follower(pathfinder, RXR, sliding=sliding, stop_within=0.1875, arrive_within=0.25)
    spl = []
    while len(spl) < 100:
        path = ShortestPath()
        path.requested_start, path.requested_end = (pathfinder.get_random_navigable_point() for _ in range(2))
        if not pathfinder.find_path(path) or path.geodesic_distance <= 2.0:
            continue
        shortest = path.geodesic_distance
        route = follower.follow(path.requested_start, 0.0, path.requested_end)
        walked = float(np.linalg.norm(np.diff(route.locations, axis=0), axis=1).sum())
        path.requested_start = route.locations[-1]
        pathfinder.find_path(path)
        spl.append((path.geodesic_distance <= 0.25) * shortest / max(shortest, walked))
    assert np.mean(spl) >= acceptable
