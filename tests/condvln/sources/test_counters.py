"""Counters with corners are their arms: to paths, rays, distances, goals and to what stands on them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from condvln.episodes.footprint import Footprint, Footprints
from condvln.episodes.kernels.distances import passes_through
from condvln.relations.solids import BoxSolid, solid_distance, solid_of
from condvln.scene import OrientedBox, SceneObject
from condvln.scene.boxes import aabb_of, box_corners
from condvln.scene.rotations import unity_rotation
from condvln.sources.procthor_solids import ARM_DEPTH, counter_parts
from condvln.sources.registry import open_source
from condvln.sources.solids import object_boxes
from condvln.verify.footprints import Ground
from condvln.verify.surfaces import Shapes, SurfaceGauge
from schemas.config.constants import UNKNOWN_EXTENT

SIZE = np.array([2.0, 0.9, 3.0])


def counter(asset_id: str, yaw: float = 0.0) -> SceneObject:
    box = OrientedBox(np.array([1.0, 0.45, -2.0]), SIZE / 2, unity_rotation([0.0, yaw, 0.0]))
    parts = counter_parts(asset_id, box.center, SIZE, box.rotation)
    bounds = aabb_of(box_corners(box))
    return SceneObject("counter", "r", "CounterTop", "counter", box.center, aabb=bounds, obb=box, parts=parts)


def over(item: SceneObject, east: float, north: float) -> bool:
    """Whether a place in the counter's own quarter is over it; as shares of half its lengths, in the asset's frame."""
    local = np.array([east, 0.0, -north]) * item.obb.half_extents
    point = (item.center + item.obb.rotation @ local)[None]
    found = Footprint.of(item)
    assert (found.distance(point)[0] == 0.0) == (Ground(item).distances(point)[0] == 0.0)
    return bool(found.distance(point)[0] == 0.0)


@pytest.mark.parametrize("yaw", [0.0, 90.0, 180.0, 270.0, 30.0])
def test_arms_lie_where_objects_stand_on_them(yaw: float) -> None:
    corner = counter("Countertop_L_8x10", yaw)
    assert [over(corner, *at) for at in ((0.9, 0.9), (0.9, -0.9), (-0.9, -0.9), (-0.9, 0.9), (0.0, 0.0))] == [
        True,
        True,
        True,
        False,
        False,
    ]
    u_shaped = counter("Countertop_C_8x10", yaw)
    sides = ((0.9, 0.9), (-0.9, 0.9), (0.0, -0.9), (0.0, 0.9), (0.0, 0.0))
    assert [over(u_shaped, *at) for at in sides] == [True, True, True, False, False]


@pytest.mark.parametrize(
    "asset_id", ["Countertop_I_8x2", "Countertop_Island_8x3", "Dresser_205_1", "Countertop_L_8x6b"]
)
def test_other_assets_are_one_box(asset_id: str) -> None:
    assert counter(asset_id).parts == ()


def test_a_counter_narrower_than_an_arm_is_one_box() -> None:
    assert counter_parts("Countertop_L_2x8", np.zeros(3), np.array([ARM_DEPTH, 0.9, 2.0]), np.eye(3)) == ()


@given(st.floats(0, 360), st.sampled_from(["Countertop_L_8x10", "Countertop_C_8x10"]), st.integers(0, 2**32))
def test_distances_are_those_of_the_union(yaw: float, asset_id: str, seed: int) -> None:
    item = counter(asset_id, yaw)
    rng = np.random.default_rng(seed)
    union = shapely.union_all([shapely.Polygon(box_corners(p)[[0, 1, 5, 4]][:, [0, 2]]) for p in item.parts])
    points = item.center + rng.uniform(-3, 3, (40, 3))
    expected = shapely.distance(union, shapely.points(points[:, [0, 2]]))
    found = Footprint.of(item)
    assert np.allclose(found.distance(points), expected, atol=1e-9)
    assert np.allclose(Ground(item).distances(points), expected, atol=1e-9)
    assert found.half_perimeter == pytest.approx(union.length / 2)
    assert Ground(item).half_round == pytest.approx(union.length / 2)
    ring = shapely.points(found.ring(0.3, 0.2))
    assert np.allclose(shapely.distance(union, ring), 0.3, atol=1e-6)
    ends = item.center + rng.uniform(-3, 3, (40, 3))
    lines = shapely.linestrings(np.stack([points[:, [0, 2]], ends[:, [0, 2]]], axis=1))
    inner = shapely.intersects(union.buffer(-1e-6), lines)
    outer = shapely.intersects(union.buffer(1e-6), lines)
    boxes = Footprints([found, Footprint(np.array([90.0, 90.0]), np.ones(2), np.eye(2))]).boxes
    crossed = np.array([passes_through(np.array(way), *boxes) for way in zip(points, ends, strict=True)])
    assert (inner <= crossed).all()
    assert (crossed <= outer).all()


@given(st.floats(0, 360), st.integers(0, 2**32))
def test_surface_distance_is_the_least_of_the_parts(yaw: float, seed: int) -> None:
    item = counter("Countertop_L_8x10", yaw)
    place = item.center + np.random.default_rng(seed).uniform(-3, 3, 3)
    box = np.array([place - 0.1, place + 0.1])
    bowl = SceneObject("bowl", "r", "bowl", "bowl", place, aabb=box)
    assert item.aabb is not None
    solid = solid_of(item, None)
    assert isinstance(solid, BoxSolid)
    other = BoxSolid((OrientedBox(place, np.full(3, 0.1), np.eye(3)),))
    expected = min(solid_distance(BoxSolid((part,)), other) for part in solid.boxes)
    assert solid_distance(solid, other) == pytest.approx(expected, abs=1e-6)
    measured = SurfaceGauge(Shapes(Path("."))).at_most(item, bowl, 0.0)
    assert measured is not None
    assert measured == pytest.approx(1000 * expected, abs=1.0)


def test_the_notch_is_not_drawn() -> None:
    drawn = object_boxes([(7, counter("Countertop_L_8x10"))])
    assert len(drawn.faces) == 24
    assert set(drawn.owner.tolist()) == {7}


def test_an_object_of_unknown_extent_stands_in_the_way_unless_it_rests_on_something() -> None:
    lone = SceneObject("o", "r", "thing", "thing", np.array([1.0, 0.1, 2.0]))
    drawn = object_boxes([(0, lone)])
    assert np.ptp(drawn.vertices, axis=0).tolist() == pytest.approx([UNKNOWN_EXTENT] * 3)
    assert drawn.vertices.mean(axis=0).tolist() == pytest.approx([1.0, 0.1, 2.0])
    assert len(object_boxes([(0, replace(lone, support="table")), (1, replace(lone, parent="box"))]).faces) == 0


def test_what_stands_on_real_counters_stands_over_their_arms(real_data: Path) -> None:
    source = open_source("procthor", real_data / "procthor")
    counters, standing = 0, 0
    for handle in source.handles():
        scene = source.read(handle.scene_id)
        counters += sum(bool(item.parts) for item in scene.objects)
        for item in scene.objects:
            below = scene.object_of.get(item.support or "")
            if below is not None and below.parts:
                found = Footprint.of(below)
                assert found.distance(item.center[None])[0] == 0.0, (handle.scene_id, item.object_id)
                standing += 1
    assert counters == 35
    assert standing > 400
