"""Rooms whose floor is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.recast import build_navmesh
from condvln.navigation.settings import NavMeshSettings
from schemas.errors import InputError

CELL = 0.05
# An agent of radius 0.1 m keeps two cells from a wall, and the cell of the wall or of the ledge itself is lost too.
MARGIN = 0.15
# Borders exactly along the cells, and no region too small to keep.
EXACT = NavMeshSettings(edge_max_error=0.0, region_min_size=0.0)


def pathfinder(mesh, asked: NavMeshSettings | None = None, profile: str = "habitat>=0.3.4") -> Pathfinder:
    return Pathfinder(build_navmesh(*mesh, asked, profile))


@pytest.mark.parametrize(("x", "z"), [(4.0, 3.0), (2.5, 6.25), (12.0, 1.5)])
def test_area_of_a_bare_floor(plate, x: float, z: float) -> None:
    room = pathfinder(plate(0, 0, x, z))
    assert room.num_islands == 1
    assert room.navigable_area == pytest.approx((x - 2 * MARGIN) * (z - 2 * MARGIN), rel=1e-5)
    low, high = room.bounds
    np.testing.assert_allclose(low, [0, 0, 0])
    np.testing.assert_allclose(high, [x, 1.6, z], rtol=1e-6)  # 1.5 m are 8 voxels


@pytest.mark.parametrize(("radius", "cells"), [(0.0, 0), (0.1, 2), (0.18, 4), (0.3, 6)])
def test_radius_is_rounded_up_to_cells(plate, radius: float, cells: int) -> None:
    room = pathfinder(plate(0, 0, 4, 4), NavMeshSettings(agent_radius=radius))
    assert room.navigable_area == pytest.approx((4 - 2 * (cells + 1) * CELL) ** 2, rel=1e-5)


def test_walls_take_their_own_cell_and_the_radius(join, plate, box) -> None:
    wall = box([2.0, 0, 0], [2.0999, 2.5, 4])  # two cells thick
    room = pathfinder(join(plate(0, 0, 4, 4), wall))
    assert room.num_islands == 2
    depth = 4 - 2 * MARGIN
    assert room.navigable_area == pytest.approx((2.0 - MARGIN - 0.1 + 1.9 - MARGIN - 0.1) * depth, rel=1e-5)


@pytest.mark.parametrize(("lintel", "old", "new"), [(1.55, 2, 2), (1.8, 2, 1), (2.05, 1, 1)])
def test_door_height_and_profile(join, plate, box, lintel: float, old: int, new: int) -> None:
    """The floor fills voxel 0; a lintel from voxel k leaves k - 1 free ones, and the agent needs 8 of them, or 9."""
    walls = [box([2, 0, 0], [2.0999, 2.5, 1.5]), box([2, 0, 2.5], [2.0999, 2.5, 4])]
    mesh = join(plate(0, 0, 4, 4), *walls, box([2, lintel, 1.5], [2.0999, 2.5, 2.5]))
    assert pathfinder(mesh, profile="habitat<=0.3.3").num_islands == old
    assert pathfinder(mesh, profile="habitat>=0.3.4").num_islands == new


@pytest.mark.parametrize(("rise", "islands"), [(0.2, 1), (0.4, 2)])
def test_a_step_is_climbed_and_a_ledge_is_not(join, plate, box, rise: float, islands: int) -> None:
    room = pathfinder(join(plate(0, 0, 6, 3), box([3, 0, 0], [6, rise, 3])))
    assert room.num_islands == islands


@pytest.mark.parametrize(("slope", "walkable"), [(30, True), (44, True), (46, False)])
def test_slope(slope: float, walkable: bool) -> None:
    rise = 2.0 * np.tan(np.radians(slope))
    ramp = np.array([[0, 0, 0], [0, 0, 4], [2, rise, 4], [2, rise, 0]], np.float32)
    flat = np.array([[-4, 0, 0], [-4, 0, 4], [0, 0, 4], [0, 0, 0]], np.float32)
    mesh = np.concatenate([flat, ramp]), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
    room = pathfinder(mesh, NavMeshSettings(agent_max_climb=0.4, cell_height=0.05))
    assert room.is_navigable([1.0, rise / 2, 2.0]) == walkable


def test_storeys_are_islands_of_their_own(join, plate) -> None:
    room = pathfinder(join(plate(0, 0, 5, 4), plate(0, 0, 5, 4, y=3.0), plate(0, 0, 5, 4, y=6.0)))
    assert room.num_islands == 3
    one = (5 - 2 * MARGIN) * (4 - 2 * MARGIN)
    for island in range(3):
        assert room.island_area(island) == pytest.approx(one, rel=1e-5)
    heights = sorted(float(room.snap_point([2.5, y, 2.0])[1]) for y in (0.0, 3.0, 6.0))
    np.testing.assert_allclose(heights, [0.2, 3.2, 6.2], atol=1e-5)  # the top of the floor's voxel


def test_a_pillar_makes_a_hole_and_not_an_island(join, plate, box) -> None:
    mesh = join(plate(0, 0, 3, 3), box([2.35, 0, 1.45], [2.4499, 2.5, 1.5499]))
    room = pathfinder(mesh)
    assert room.num_islands == 1
    assert not room.is_navigable([2.4, 0.2, 1.5])
    assert room.is_navigable([2.4, 0.2, 2.0])
    # Straight through the pillar is not the way.
    path = room.find_path([2.0, 0.2, 1.5], [2.8, 0.2, 1.5])
    assert 0.8 < path.geodesic_distance < 1.0


def test_small_regions_are_dropped(join, plate) -> None:
    mesh = join(plate(0, 0, 4, 4), plate(6, 0, 7, 1))  # 0.7 m squared are 196 cells, and 400 are asked for
    assert pathfinder(mesh).num_islands == 1
    assert pathfinder(mesh, NavMeshSettings(region_min_size=14)).num_islands == 2
    assert pathfinder(mesh, NavMeshSettings(region_min_size=14.1)).num_islands == 1


OBSTACLE = st.tuples(st.integers(0, 52), st.integers(0, 52), st.integers(1, 12), st.integers(1, 12))


def with_obstacles(join, plate, box, obstacles):
    """A floor of 3.3 m squared with obstacles of whole cells, 1 mm short of the next so that no face lies on a border.

    They are boxes too low to walk in, turned inside out, as nobody walks on a face that looks down, and without a
    bottom: Recast takes the top of a wall for walkable where a floor is rasterised after it.
    """
    boxes = [
        box([x * CELL + 0.001, 0, z * CELL + 0.001], [(x + a) * CELL - 0.001, 1.5, (z + b) * CELL - 0.001])
        for x, z, a, b in obstacles
    ]
    return join(plate(0, 0, 3.3, 3.3), *((v, f[(v[f][:, :, 1] > 0).any(axis=1)][:, ::-1]) for v, f in boxes))


@given(obstacles=st.lists(OBSTACLE, max_size=30))
def test_polygons_cover_the_eroded_floor_exactly(join, plate, box, obstacles) -> None:
    check_cover(join, plate, box, obstacles)


@pytest.mark.soak
@given(obstacles=st.lists(OBSTACLE, min_size=20, max_size=80))
@settings(max_examples=500)
def test_polygons_cover_crowded_floors_exactly(join, plate, box, obstacles) -> None:
    check_cover(join, plate, box, obstacles)


def check_cover(join, plate, box, obstacles) -> None:
    """With borders along the cells, floor and islands are those of a picture of the floor, eroded in plain numpy."""
    free = np.ones((66, 66), bool)  # x, z
    for x, z, a, b in obstacles:
        free[x : x + a, z : z + b] = False
    free[[0, -1]] = free[:, [0, -1]] = False  # the ledge at the end of the world
    walkable = chamfer(free) >= 4
    labels, count = ndimage.label(walkable)
    sizes = np.bincount(labels.ravel())[1:]
    count, cells = count - int((sizes == 1).sum()), int(sizes[sizes > 1].sum())  # a cell alone has no outline
    mesh = with_obstacles(join, plate, box, obstacles)
    if cells == 0:
        with pytest.raises(InputError):
            build_navmesh(*mesh, EXACT)
        return
    room = pathfinder(mesh, EXACT)
    assert room.num_islands >= count
    middles = (np.argwhere(np.ones((66, 66))) + 0.5) * CELL
    ours = room.are_navigable(np.insert(middles, 1, 0.2, axis=1)).reshape(66, 66)
    # Recast makes the border of two regions straight, and where that cuts a corner it may lose floor and links.
    assert (ours != walkable).sum() <= 8 + cells // 50


def chamfer(free: np.ndarray) -> np.ndarray:
    """Distance to the nearest free cell that lacks a free neighbour, 2 straight and 3 diagonal, by plain relaxation."""
    padded = np.pad(free, 1)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:] & free
    far = 10**6
    distance = np.where(free & inner, far, 0)
    distance[~free] = -1
    for _ in range(3):  # more than the radius needs
        grown = np.pad(np.where(free, distance, far), 1, constant_values=far)
        steps = [(1, 0, 2), (-1, 0, 2), (0, 1, 2), (0, -1, 2), (1, 1, 3), (1, -1, 3), (-1, 1, 3), (-1, -1, 3)]
        best = np.min([grown[1 + i : 67 + i, 1 + j : 67 + j] + cost for i, j, cost in steps], axis=0)
        distance = np.where(free, np.minimum(distance, best), -1)
    return distance
