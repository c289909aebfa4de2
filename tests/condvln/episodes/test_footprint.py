"""Footprints: distances and crossings against closed forms and against shapely."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon

from condvln.episodes.footprint import Footprint, Footprints
from condvln.episodes.kernels.distances import passes_through
from condvln.scene import OrientedBox, SceneObject

metres = st.floats(-5, 5).map(lambda v: round(v, 3))
extents = st.floats(0.05, 2).map(lambda v: round(v, 3))
angles = st.floats(-np.pi, np.pi)


def rectangle(x: float, z: float, hx: float, hz: float, angle: float) -> Footprint:
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return Footprint(np.array([x, z]), np.array([hx, hz]), axes)


def polygon(box: Footprint) -> Polygon:
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * box.half
    return Polygon(box.center + corners @ box.axes)


boxes = st.builds(rectangle, metres, metres, extents, extents, angles)
points = st.lists(st.tuples(metres, metres), min_size=2, max_size=8).map(
    lambda pairs: np.array([[x, 0.0, z] for x, z in pairs])
)


@given(boxes, points)
def test_distance_is_shapely_s(box: Footprint, at: np.ndarray) -> None:
    expected = [polygon(box).distance(Point(x, z)) for x, _, z in at]
    np.testing.assert_allclose(box.distance(at), expected, atol=1e-9)


@given(boxes, st.floats(0.05, 1.0), st.floats(0.05, 0.5))
def test_ring_lies_at_its_offset_and_leaves_no_gap(box: Footprint, offset: float, spacing: float) -> None:
    ring = box.ring(offset, spacing)
    at = np.column_stack([ring[:, 0], np.zeros(len(ring)), ring[:, 1]])
    np.testing.assert_allclose(box.distance(at), offset, atol=1e-9)
    gaps = np.linalg.norm(ring - np.roll(ring, -1, axis=0), axis=1)
    assert gaps.max() <= spacing + 1e-9


@given(boxes, points)
def test_crossing_is_shapely_s(box: Footprint, at: np.ndarray) -> None:
    shape = polygon(box)
    core = shape.buffer(-1e-9, join_style="mitre")  # a way along an edge is not inside
    for a, b in pairwise(at):
        crossed = passes_through(np.array([a, b]), *Footprints([box]).boxes)
        inside = LineString([a[[0, 2]], b[[0, 2]]]).intersection(core).length
        if inside > 1e-6:
            assert crossed
        # Grazing a side or a corner is no crossing; rounding may go either way within a hair of it.
        if crossed:
            assert LineString([a[[0, 2]], b[[0, 2]]]).distance(shape) <= 1e-9


def test_upright_oriented_box_gives_its_own_rectangle() -> None:
    turn = np.pi / 6
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    obb = OrientedBox(np.array([1.0, 0.5, 2.0]), np.array([0.8, 0.5, 0.3]), rotation)
    item = SceneObject("a", "r", "table", "table", obb.center, aabb=np.array([[0, 0, 1], [2, 1, 3.0]]), obb=obb)
    box = Footprint.of(item)
    np.testing.assert_allclose(box.half, [0.8, 0.3])
    tip = obb.center + rotation @ np.array([0.8, 0.0, 0.3])
    assert box.distance(tip[None])[0] < 1e-9
    assert box.half_perimeter == 2.2


def test_tilted_box_falls_back_to_its_aabb() -> None:
    tilt = np.pi / 4
    rotation = np.array([[np.cos(tilt), -np.sin(tilt), 0], [np.sin(tilt), np.cos(tilt), 0], [0, 0, 1]])
    obb = OrientedBox(np.zeros(3), np.ones(3), rotation)
    item = SceneObject("a", "r", "x", "x", np.zeros(3), aabb=np.array([[-2, -2, -1], [2, 2, 1.0]]), obb=obb)
    box = Footprint.of(item)
    np.testing.assert_allclose(box.half, [2, 1])


def test_unknown_extent_has_no_footprint() -> None:
    assert Footprint.of(SceneObject("a", "r", "x", "x", np.zeros(3))) is None


@given(st.lists(boxes, max_size=4), points)
def test_a_way_stands_in_what_some_segment_crosses(several: list[Footprint], at: np.ndarray) -> None:
    crossed = [passes_through(np.array(way), *Footprints([one]).boxes) for one in several for way in pairwise(at)]
    assert passes_through(at, *Footprints(several).boxes) == any(crossed)
