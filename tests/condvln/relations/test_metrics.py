"""Distances and angles of all pairs against the definitions one pair at a time, and their invariances."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from condvln.relations.metrics import USED_METRICS, PairMetrics, pair_metrics
from condvln.scene import RoomArrays, SceneObject

Millimetres = np.ndarray
FIELDS = tuple(f for f in PairMetrics.__dataclass_fields__ if f != "delta")

# Rooms in whole millimetres: centres and half extents within a big building, small numbers often.
coordinates = st.one_of(st.integers(-30, 30), st.integers(-3000, 3000), st.integers(-60_000, 60_000))


@st.composite
def rooms(draw: st.DrawFn) -> tuple[Millimetres, Millimetres]:
    n = draw(st.integers(2, 6))
    centres = draw(arrays(np.int64, (n, 3), elements=coordinates))
    halves = draw(arrays(np.int64, (n, 3), elements=st.integers(1, 2000)))
    return centres, halves


def metrics_of(centres: Millimetres, halves: Millimetres) -> PairMetrics:
    unknown = np.full(len(centres), np.nan)
    return pair_metrics(centres / 1000, (centres - halves) / 1000, (centres + halves) / 1000, unknown)


def assert_same(a: PairMetrics, b: PairMetrics) -> None:
    np.testing.assert_array_equal(a.delta, b.delta)
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field), err_msg=field)


@given(rooms())
def test_against_the_definitions_one_pair_at_a_time(room: tuple[Millimetres, Millimetres]) -> None:
    centres, halves = room
    metrics = metrics_of(centres, halves)
    for i in range(len(centres)):
        for j in range(len(centres)):
            delta = [int(centres[j][k]) - int(centres[i][k]) for k in range(3)]
            assert metrics.delta[i, j].tolist() == [d / 1000 for d in delta]
            # Square roots of whole numbers of square millimetres: exact integer arithmetic under one rounding.
            assert metrics.centre[i, j] == math.sqrt(sum(d * d for d in delta)) / 1000
            assert metrics.horizontal[i, j] == math.sqrt(delta[0] ** 2 + delta[2] ** 2) / 1000
            gaps = [max(abs(d) - int(halves[i][k]) - int(halves[j][k]), 0) for k, d in enumerate(delta)]
            assert metrics.aabb[i, j] == metrics.used[i, j] == math.sqrt(sum(g * g for g in gaps)) / 1000
            if delta[0] == delta[2] == 0:
                assert math.isnan(metrics.azimuth[i, j])
            else:
                assert math.isclose(metrics.azimuth[i, j], math.degrees(math.atan2(delta[2], -delta[0])), abs_tol=1e-12)
            flat = math.hypot(delta[0], delta[2])
            assert math.isclose(metrics.elevation[i, j], math.degrees(math.atan2(-delta[1], flat)), abs_tol=1e-12)
            shared = 1
            for k in (0, 2):
                low = max(int(centres[i][k] - halves[i][k]), int(centres[j][k] - halves[j][k]))
                high = min(int(centres[i][k] + halves[i][k]), int(centres[j][k] + halves[j][k]))
                shared *= max(high - low, 0)
            smaller = min(4 * int(halves[o][0]) * int(halves[o][2]) for o in (i, j))
            assert metrics.footprint_overlap[i, j] == shared / smaller


@given(rooms())
def test_symmetry(room: tuple[Millimetres, Millimetres]) -> None:
    metrics = metrics_of(*room)
    np.testing.assert_array_equal(metrics.delta, -metrics.delta.transpose(1, 0, 2))
    np.testing.assert_array_equal(metrics.elevation, -metrics.elevation.T)
    for field in ("centre", "horizontal", "aabb", "used", "footprint_overlap"):
        values = getattr(metrics, field)
        np.testing.assert_array_equal(values, values.T, err_msg=field)
    opposite = np.mod(metrics.azimuth - metrics.azimuth.T, 360.0)
    np.testing.assert_allclose(opposite[~np.isnan(opposite)], 180.0, atol=1e-9)


@given(rooms(), arrays(np.int64, 3, elements=st.integers(-200_000, 200_000)))
def test_moving_a_room_by_millimetres_changes_no_bit(room: tuple[Millimetres, Millimetres], shift: Millimetres) -> None:
    centres, halves = room
    assert_same(metrics_of(centres, halves), metrics_of(centres + shift, halves))


@given(rooms(), st.randoms(use_true_random=False))
def test_order_of_objects_changes_no_bit(room: tuple[Millimetres, Millimetres], random: object) -> None:
    centres, halves = room
    order = list(range(len(centres)))
    random.shuffle(order)  # type: ignore[attr-defined]
    metrics, shuffled = metrics_of(centres, halves), metrics_of(centres[order], halves[order])
    picked = np.ix_(order, order)
    expected = {field: getattr(metrics, field)[picked] for field in FIELDS}
    assert_same(replace(metrics, delta=metrics.delta[picked], **expected), shuffled)


@given(rooms())
def test_boxes_are_never_further_apart_than_centres(room: tuple[Millimetres, Millimetres]) -> None:
    metrics = metrics_of(*room)
    assert (metrics.aabb <= metrics.centre).all()
    assert (metrics.horizontal <= metrics.centre).all()


def test_used_distance_is_the_first_that_is_known(
    make: Callable[..., SceneObject], room_of: Callable[[Sequence[SceneObject]], RoomArrays]
) -> None:
    room = room_of(
        [
            make("a box", (0, 0, 0), (0.5, 0.5, 0.5), radius=0.9),
            make("b box", (3, 0, 0), (0.5, 0.5, 0.5)),
            make("c ball", (0, 0, 4), None, radius=0.4),
            make("d point", (0, 0, 1), None),
        ]
    )
    metrics = pair_metrics(room.centers, room.aabb_min, room.aabb_max, room.radius)
    names = np.array(USED_METRICS)[metrics.used_metric]
    assert names[0].tolist() == ["aabb", "aabb", "sphere", "centre"]
    assert names[2].tolist() == ["sphere", "centre", "sphere", "centre"]
    assert metrics.used[0].tolist() == [0.0, 2.0, 4 - (0.9 + 0.4), 1.0]
    assert metrics.sphere[2, 2] == 0.0
    assert np.isnan(metrics.aabb[2]).all()
    assert np.isnan(metrics.footprint_overlap[0, 2])


def test_a_distance_at_a_threshold_is_equal_to_it(
    make: Callable[..., SceneObject], room_of: Callable[[Sequence[SceneObject]], RoomArrays]
) -> None:
    """0.36 m and 0.77 m make 0.85 m exactly, wherever the two stand; plain floats say 0.8500000000000001."""
    for origin in (0.0, 0.1, 1 / 3, 1e4):
        room = room_of(
            [make("a", (origin,) * 3, (0.1,) * 3), make("b", (origin + 0.56, origin, origin + 0.97), (0.1,) * 3)]
        )
        metrics = pair_metrics(room.centers, room.aabb_min, room.aabb_max, room.radius)
        assert metrics.aabb[0, 1] == 0.85
