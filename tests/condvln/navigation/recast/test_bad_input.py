"""What can't be built is refused with a sentence that says what, where and what to do."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from condvln.navigation.recast import build_navmesh
from condvln.navigation.recast.config import MEMORY_LIMIT_BYTES
from condvln.navigation.recast.contours import Contours
from condvln.navigation.recast.polymesh import build_polymesh
from condvln.navigation.settings import NavMeshSettings
from schemas.errors import FormatError, InputError, UsageError


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e39])
def test_vertices_that_are_no_numbers(plate, value: float) -> None:
    vertices, faces = plate(0, 0, 4, 4)
    vertices = vertices.astype(np.float64)
    vertices[2, 1] = value
    with pytest.raises(FormatError, match=r"vertex 2: 1 of 4 vertices are NaN, infinite or beyond float32\. Repair"):
        build_navmesh(vertices, faces)


@pytest.mark.parametrize("index", [-1, 4, 2**31, 2**62])
def test_indices_without_a_vertex(plate, index: int) -> None:
    vertices, faces = plate(0, 0, 4, 4)
    faces = faces.astype(np.int64)
    faces[1, 2] = index
    with pytest.raises(FormatError, match=rf"face 1: face \[0, 2, {index}\] refers to a vertex outside 0\.\.3"):
        build_navmesh(vertices, faces)


@pytest.mark.parametrize("faces", [[], np.zeros((0, 3), np.int32)])
def test_no_triangles(plate, faces) -> None:
    with pytest.raises(FormatError, match="no triangles"):
        build_navmesh(plate(0, 0, 4, 4)[0], faces)


@pytest.mark.parametrize(
    ("vertices", "faces", "place"),
    [
        (np.zeros((4, 2)), np.zeros((1, 3), int), "vertices"),
        (np.zeros(12), np.zeros((1, 3), int), "vertices"),
        (np.array([["a", "b", "c"]]), np.zeros((1, 3), int), "vertices"),
        (np.zeros((4, 3)), np.zeros((1, 4), int), "faces"),
        (np.zeros((4, 3)), np.zeros((1, 3)), "faces"),
        (np.zeros((0, 3)), np.zeros((1, 3), int), "face 0"),
    ],
)
def test_wrong_shapes_and_types(vertices, faces, place: str) -> None:
    with pytest.raises(FormatError, match=f"^{place}: "):
        build_navmesh(vertices, faces)


def test_a_grid_that_is_too_large_is_refused_before_it_is_allocated(plate) -> None:
    mesh = plate(0, 0, 100_000, 100_000)
    tracemalloc.start()
    with pytest.raises(
        FormatError, match=r"2e\+06 x 2e\+06 cells of 0.05 m would need about 491,738\.6 GiB.*larger cell_size"
    ):
        build_navmesh(*mesh)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()


def test_the_memory_limit_is_the_callers(plate) -> None:
    with pytest.raises(FormatError, match=r"the limit is 0\.0 GiB"):
        build_navmesh(*plate(0, 0, 4, 4), memory_limit=100_000)
    assert build_navmesh(*plate(0, 0, 4, 4), memory_limit=MEMORY_LIMIT_BYTES).tile.polys.size == 1


@given(extent=st.floats(1e3, 3e38), other=st.floats(1e-3, 3e38))
def test_no_extent_brings_it_down(plate, extent: float, other: float) -> None:
    with pytest.raises(FormatError, match="mesh bounds"):
        build_navmesh(*plate(0, 0, extent, other), memory_limit=1_000_000)


def test_long_meshes(plate) -> None:
    with pytest.raises(FormatError, match="70000 cells long, but a tile holds at most 65,535"):
        build_navmesh(*plate(0, 0, 3500, 1))


def test_thin_meshes(plate) -> None:
    with pytest.raises(FormatError, match="thinner than half a cell"):
        build_navmesh(*plate(0, 0, 0.02, 4))


def test_high_meshes(join, plate) -> None:
    with pytest.raises(FormatError, match=r"8500 cells high, each of 0\.2 m, but a tile holds at most 8,191"):
        build_navmesh(*join(plate(0, 0, 4, 4), plate(0, 0, 4, 4, y=1700)))
    high = build_navmesh(*join(plate(0, 0, 4, 4), plate(0, 0, 4, 4, y=1638.19)))
    assert high.tile.verts[:, 1].max() == pytest.approx(1638.2)


def test_more_floors_than_a_column_can_hold(join, plate) -> None:
    def tower(storeys: int):
        return join(*(plate(0, 0, 2, 2, y=2.0 * k) for k in range(storeys)))

    assert len(build_navmesh(*tower(63)).tile.polys) == 63
    with pytest.raises(FormatError, match="64 floors lie one above another, but Recast can tell at most 63 apart"):
        build_navmesh(*tower(64))


def test_more_vertices_than_a_tile_can_number() -> None:
    squares = 65_534 // 4 + 1
    corner = np.array([[0, 0, 0, 0], [0, 0, 1, 0], [1, 0, 1, 0], [1, 0, 0, 0]], np.int32)
    place = np.arange(squares, dtype=np.int32)
    points = (
        corner[None] + np.stack([2 * (place % 256), 0 * place, 2 * (place // 256), 0 * place], axis=1)[:, None]
    ).reshape(-1, 4)
    start = np.arange(0, 4 * squares + 1, 4, dtype=np.int32)
    region = np.ones(squares, np.int32)

    def contours(count: int) -> Contours:
        return Contours(points[: 4 * count], start[: count + 1], region[:count], region[:count])

    with pytest.raises(FormatError, match="65,536 contour vertices, but a tile can number at most 65,533"):
        build_polymesh(contours(squares), 6)
    assert len(build_polymesh(contours(squares - 1), 6).polygons) == squares - 1


def test_more_edges_than_a_tile_can_number() -> None:
    """650 round contours of 100 corners, cut into triangles: 197 edges each."""
    angle = -2 * np.pi * np.arange(100) / 100
    ring = np.stack([np.cos(angle), 0 * angle, np.sin(angle), 0 * angle], axis=1) * 10_000
    level = np.array([0, 10, 0, 0])
    points = np.concatenate([ring.round() + [10_000, 0, 10_000, 0] + level * k for k in range(650)]).astype(np.int32)
    start = np.arange(0, len(points) + 1, 100, dtype=np.int32)
    ones = np.ones(650, np.int32)
    with pytest.raises(FormatError, match="polygon edges, but a tile can number at most 65,534"):
        build_polymesh(Contours(points, start, ones, ones), 3)


def test_nothing_to_walk_on(plate, box) -> None:
    ceiling = plate(0, 0, 4, 4)
    with pytest.raises(InputError, match=r"no floor for an agent of radius 0\.1 m and height 1\.5 m"):
        build_navmesh(ceiling[0], ceiling[1][:, ::-1])
    line = np.array([[0, 0, 0], [4, 0, 4], [2, 0, 2]], np.float32)
    with pytest.raises(InputError, match="no floor"):
        build_navmesh(line, np.array([[0, 1, 2]]))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cell_size", 0.0),
        ("cell_height", float("nan")),
        ("agent_height", 0.0),
        ("agent_radius", -0.1),
        ("agent_max_climb", -0.2),
        ("agent_max_slope", 91.0),
        ("region_min_size", -1.0),
        ("region_merge_size", 1e6),
        ("edge_max_len", -1.0),
        ("edge_max_error", -0.1),
        ("verts_per_poly", 7.0),
        ("detail_sample_dist", -1.0),
        ("detail_sample_max_error", 1e39),
    ],
)
def test_settings_out_of_range(plate, name: str, value: float) -> None:
    with pytest.raises(UsageError, match=f"navmesh settings: {name} "):
        build_navmesh(*plate(0, 0, 4, 4), replace(NavMeshSettings(), **{name: value}))


def test_unknown_profile(plate) -> None:
    with pytest.raises(UsageError, match=r"habitat<=0\.3\.3.*habitat>=0\.3\.4"):
        build_navmesh(*plate(0, 0, 4, 4), profile="habitat 1.0")


POINTS = arrays.arrays(np.float32, st.tuples(st.integers(0, 12), st.just(3)), elements=st.floats(width=32))
FACES = arrays.arrays(np.int64, st.tuples(st.integers(0, 12), st.just(3)), elements=st.integers(-2, 13))


@given(vertices=POINTS, faces=FACES)
def test_any_arrays_build_or_are_refused(vertices, faces) -> None:
    check_soup(vertices, faces)


SMALL = arrays.arrays(np.float32, st.tuples(st.integers(3, 24), st.just(3)), elements=st.floats(-3, 3, width=32))


@given(data=st.data(), vertices=SMALL)
def test_any_small_triangles_build_or_are_refused(data, vertices) -> None:
    faces = data.draw(arrays.arrays(np.int64, (24, 3), elements=st.integers(0, len(vertices) - 1)))
    check_soup(vertices, faces)


def check_soup(vertices, faces) -> None:
    refused: InputError | None = None
    try:
        navmesh = build_navmesh(vertices, faces, NavMeshSettings(region_min_size=1.0), memory_limit=1 << 24)
    except InputError as error:
        refused = error
    if refused is not None:
        assert refused.remedy
        return
    tile = navmesh.tile
    assert (tile.poly_verts < len(tile.verts)).all()
    low, high = tile.bounds
    slack = 0.3  # detail is lifted by a cell, and borders follow whole cells
    assert (tile.verts >= low - slack).all()
    assert (tile.verts <= high + slack).all()
