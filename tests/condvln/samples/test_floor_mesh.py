"""Meshing of free floor: conforming, convex, and with the distances that the floor has."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.navigation.settings import NavMeshSettings
from condvln.samples import make_layout
from condvln.samples.floor_mesh import MAX_CORNERS, NAVMESH_HEIGHT, convex_polygons, free_floor, navmesh_of
from condvln.samples.solid import piece_corners
from tests.condvln.voxelised import layout_triangles, voxelised


def _area(vertices: np.ndarray, polygon: list[int]) -> float:
    return float(shapely.Polygon(vertices[polygon]).area)


def _pathfinder(floor: shapely.Geometry) -> Pathfinder:
    vertices, polygons = convex_polygons(floor)
    points = np.column_stack([vertices[:, 0], np.zeros(len(vertices)), vertices[:, 1]])
    return Pathfinder.from_tile(tile_of_polygons(points, polygons))


@pytest.mark.costly
@given(st.integers(0, 10**9))
@settings(max_examples=15)
def test_a_made_floor_is_covered_once_by_convex_polygons_that_meet_along_whole_edges(seed: int) -> None:
    floor = free_floor(make_layout(seed))
    vertices, polygons = convex_polygons(floor)
    assert sum(_area(vertices, p) for p in polygons) == pytest.approx(floor.area, abs=1e-9)
    assert shapely.union_all([shapely.Polygon(vertices[p]) for p in polygons]).area == pytest.approx(floor.area)
    # Habitat switches polygons below 1e-5 m² off.
    assert min(_area(vertices, p) for p in polygons) > 2e-5
    for polygon in polygons:
        assert 3 <= len(polygon) <= MAX_CORNERS
        hull = shapely.Polygon(vertices[polygon]).convex_hull
        assert hull.area == pytest.approx(_area(vertices, polygon), abs=1e-9)
    # An edge belongs to two polygons or lies on the border: there is no corner in the middle of a neighbour's edge.
    edges = Counter(frozenset(e) for p in polygons for e in zip(p, [*p[1:], p[0]], strict=True))
    assert set(edges.values()) <= {1, 2}
    border = sum(np.linalg.norm(np.subtract(*vertices[list(e)])) for e, times in edges.items() if times == 1)
    assert border == pytest.approx(floor.length)


@given(st.integers(0, 10**9))
@settings(max_examples=10)
def test_the_navmesh_is_one_island_of_the_floors_area(seed: int) -> None:
    layout = make_layout(seed)
    pathfinder = Pathfinder(navmesh_of(layout, NavMeshSettings()))
    assert pathfinder.num_islands == 1
    assert pathfinder.navigable_area == pytest.approx(free_floor(layout).area, rel=1e-5)
    assert pathfinder.settings.fits(0.1, 1.5, 0.2, 45.0)
    centers = np.array([(door.center[0], NAVMESH_HEIGHT, door.center[1]) for door in layout.doors])
    np.testing.assert_allclose(pathfinder.snap_points(centers), centers, atol=1e-5)
    distances = pathfinder.distance_table(centers, centers)
    assert np.isfinite(distances).all()
    straight = np.linalg.norm(centers[:, None] - centers[None], axis=-1)
    assert (distances >= straight - 1e-4).all()


@pytest.mark.parametrize("seed", [1, 4])
def test_voxelising_the_layout_finds_the_same_floor(seed: int) -> None:
    """Recast, over the triangles of slabs, walls and furniture, knows nothing of how the free floor was computed."""
    layout = make_layout(seed)
    exact = Pathfinder(navmesh_of(layout, NavMeshSettings()))
    voxels = Pathfinder(voxelised(layout, NavMeshSettings()))
    points = exact.get_random_navigable_points(200, np.random.default_rng(0))
    assert points[:, 1] == pytest.approx(NAVMESH_HEIGHT)
    assert voxels.are_navigable(points).mean() > 0.93
    snapped = voxels.snap_points(points)
    assert np.abs(snapped[:, 1] - NAVMESH_HEIGHT).max() < 1e-5
    (floor,) = set(voxels.get_islands(points).tolist())
    assert voxels.island_area(floor) == pytest.approx(exact.navigable_area, rel=0.08)
    mine = exact.distance_table(points[:50], points[50:100])
    recasts = voxels.distance_table(points[:50], points[50:100])
    assert np.median(recasts / mine) == pytest.approx(1.0, abs=0.01)


def test_a_layouts_triangles_are_closed_boxes_of_its_furniture() -> None:
    layout = make_layout(2)
    vertices, faces = layout_triangles(layout)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume > 0
    for piece in layout.furniture:
        corners = piece_corners(piece).reshape(-1, 3)
        np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], piece.aabb, atol=1e-6)


def test_shortest_way_round_a_table_is_the_closed_form() -> None:
    floor = shapely.box(0, 0, 4, 2).difference(shapely.box(1, 0.5, 3, 2))
    path = _pathfinder(floor).find_path((0.5, 0, 1.5), (3.5, 0, 1.5))
    assert path.geodesic_distance == pytest.approx(2 * np.hypot(0.5, 1.0) + 2.0, rel=1e-6)
