"""Each stage alone: its input taken from the reference dump of a build, its output compared with the dump."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from condvln.navigation.recast.arrays import Array
from condvln.navigation.recast.compact import CompactHeightfield, compact
from condvln.navigation.recast.compare import STAGE_OF_ARRAY, first_difference
from condvln.navigation.recast.config import RecastConfig
from condvln.navigation.recast.contours import Contours, trace_contours
from condvln.navigation.recast.detail import build_detail
from condvln.navigation.recast.distance import distance_field, erode
from condvln.navigation.recast.filters import filter_ledges, filter_low_hanging_obstacles, filter_low_height
from condvln.navigation.recast.heightfield import Heightfield, rasterize
from condvln.navigation.recast.holes import merge_holes
from condvln.navigation.recast.polymesh import PolyMesh, build_polymesh
from condvln.navigation.recast.regions import merge_regions
from condvln.navigation.recast.stages import NOT_CONNECTED, build_stages
from condvln.navigation.recast.triangles import walkable_faces
from condvln.navigation.recast.watershed import watershed
from condvln.navigation.settings import NavMeshSettings

SETTINGS = NavMeshSettings()


@pytest.fixture(scope="module")
def dump(real_data: Path) -> dict[str, Array]:
    with np.load(real_data / "navmesh_golden" / "build" / "apt1.stages.npz") as stages:
        return dict(stages)


@pytest.fixture(scope="module")
def mesh(real_data: Path) -> dict[str, Array]:
    with np.load(real_data / "navmesh_golden" / "build" / "apt1.npz") as arrays:
        return dict(arrays)


@pytest.fixture(scope="module")
def config(mesh: dict[str, Array]) -> RecastConfig:
    return RecastConfig.of(mesh["vertices"], SETTINGS)


def solid_of(dump: dict[str, Array], name: str) -> Heightfield:
    width, depth = int(dump["meta"][0]), int(dump["meta"][1])
    cell, bottom, top, area = dump[name].reshape(-1, 4).T
    start = np.searchsorted(cell, np.arange(width * depth + 1)).astype(np.int32)
    return Heightfield(width, depth, start, *map(np.ascontiguousarray, (bottom, top)), area.astype(np.uint8))


def compact_of(dump: dict[str, Array]) -> CompactHeightfield:
    width, depth = int(dump["meta"][0]), int(dump["meta"][1])
    counts = dump["chf_cells"].reshape(-1, 2)[:, 1]
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    column = np.repeat(np.arange(width * depth), counts).astype(np.int32)
    spans = dump["chf_spans"].reshape(-1, 6)
    dx, dz = np.array([-1, 0, 1, 0]), np.array([0, 1, 0, -1])
    beside = np.clip(column[:, None] + dx + dz * width, 0, width * depth - 1)
    steps = spans[:, 2:]
    neighbour = np.where(steps == NOT_CONNECTED, -1, start[beside] + steps).astype(np.int32)
    floor, clearance = (np.ascontiguousarray(spans[:, k]) for k in (0, 1))
    area = dump["chf_area0"].astype(np.uint8)
    return CompactHeightfield(width, depth, start, column, floor, clearance, neighbour, area)


def contours_of(dump: dict[str, Array]) -> Contours:
    rows, place = dump["contours"], 0
    points, heads = [], []
    while place < len(rows):
        n, region, area = rows[place : place + 3]
        points.append(rows[place + 3 : place + 3 + 4 * n].reshape(-1, 4))
        heads.append((len(points[-1]), region, area))
        place += 3 + 4 * n
    sizes, regions, areas = np.array(heads, np.int32).T
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    return Contours(np.concatenate(points).astype(np.int32), start, *map(np.ascontiguousarray, (regions, areas)))


def polymesh_of(dump: dict[str, Array]) -> PolyMesh:
    polygons = dump["pm_polys"].reshape(-1, 2 * int(SETTINGS.verts_per_poly))
    return PolyMesh(dump["pm_verts"].reshape(-1, 3), polygons, dump["pm_regs"], np.full(len(polygons), 63, np.int32))


def assert_equal(ours: dict[str, Array], dump: dict[str, Array]) -> None:
    assert first_difference(ours, {name: dump[name] for name in ours}) is None


def test_configuration(dump: dict[str, Array], config: RecastConfig) -> None:
    ours = [config.width, config.depth, *config.bounds_min, *config.bounds_max, config.cell_size, config.cell_height]
    ours += [config.walkable_height, config.walkable_climb, config.walkable_radius]
    np.testing.assert_array_equal(np.array(ours, np.float32), dump["meta"][:13])


def test_rasterisation(dump: dict[str, Array], mesh: dict[str, Array], config: RecastConfig) -> None:
    area = walkable_faces(mesh["vertices"], mesh["faces"], config.walkable_slope_cosine)
    ours, theirs = rasterize(mesh["vertices"], mesh["faces"], area, config), solid_of(dump, "solid0")
    for name in ("start", "bottom", "top", "area"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)


def test_filters(dump: dict[str, Array], config: RecastConfig) -> None:
    low_hanging = filter_low_hanging_obstacles(solid_of(dump, "solid0"), config.walkable_climb)
    np.testing.assert_array_equal(low_hanging, solid_of(dump, "solid1").area)
    ledges = filter_ledges(solid_of(dump, "solid1"), config.walkable_height, config.walkable_climb)
    np.testing.assert_array_equal(ledges, solid_of(dump, "solid2").area)
    low_height = filter_low_height(solid_of(dump, "solid2"), config.walkable_height, height_must_exceed=False)
    np.testing.assert_array_equal(low_height, solid_of(dump, "solid3").area)


def test_compact_heightfield(dump: dict[str, Array], config: RecastConfig) -> None:
    solid = solid_of(dump, "solid3")
    ours, theirs = compact(solid, solid.area, config.walkable_height, config.walkable_climb), compact_of(dump)
    for name in ("start", "column", "floor", "clearance", "neighbour", "area"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)


def test_erosion_and_distance(dump: dict[str, Array], config: RecastConfig) -> None:
    field = compact_of(dump)
    np.testing.assert_array_equal(erode(field, config.walkable_radius), dump["chf_area1"])
    distance, highest = distance_field(field, dump["chf_area1"].astype(np.uint8))
    np.testing.assert_array_equal(distance, dump["chf_dist"])
    assert highest >= distance.max()  # a blur lowers the peak


def test_regions(dump: dict[str, Array], config: RecastConfig) -> None:
    field, area = compact_of(dump), dump["chf_area1"].astype(np.uint8)
    _, highest = distance_field(field, area)
    region, count = watershed(field, area, dump["chf_dist"], highest)
    assert count > dump["chf_reg"].max()  # some are merged
    merged, left = merge_regions(field, area, region, count, config.min_region_area, config.merge_region_area)
    np.testing.assert_array_equal(merged, dump["chf_reg"])
    assert left == dump["chf_reg"].max()


def test_contours(dump: dict[str, Array], config: RecastConfig) -> None:
    area = dump["chf_area1"].astype(np.uint8)
    raw, simple = trace_contours(compact_of(dump), area, dump["chf_reg"], config.max_edge_error, config.max_edge_length)
    ours, theirs = merge_holes(simple), contours_of(dump)
    for name in ("points", "start", "region", "area"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
    flat = [np.concatenate([[len(raw[k]), raw.region[k]], raw[k].ravel()]) for k in range(len(raw))]
    np.testing.assert_array_equal(np.concatenate(flat), dump["rawcontours"])


def test_polygon_mesh(dump: dict[str, Array], config: RecastConfig) -> None:
    ours, theirs = build_polymesh(contours_of(dump), config.verts_per_poly), polymesh_of(dump)
    for name in ("vertices", "polygons", "region", "area"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)


def test_detail_mesh(dump: dict[str, Array], config: RecastConfig) -> None:
    detail = build_detail(polymesh_of(dump), compact_of(dump), dump["chf_reg"], config)
    ours = {"dm_meshes": detail.meshes, "dm_verts": detail.vertices, "dm_tris": detail.triangles}
    assert_equal({name: array.ravel() for name, array in ours.items()}, dump)


def test_the_stages_of_one_build_are_those_of_the_dump(dump: dict[str, Array], mesh: dict[str, Array]) -> None:
    arrays = build_stages(mesh["vertices"], mesh["faces"], SETTINGS).arrays()
    assert list(arrays) == list(STAGE_OF_ARRAY)
    assert set(dump) - {"meta"} == set(arrays) - {"tile"}
    arrays.pop("tile")
    assert_equal(arrays, dump)
