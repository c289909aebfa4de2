"""Goal points are spread out among those on the same side of walls."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import condvln.episodes.goals as goals_module
from condvln.episodes.footprint import Footprint
from condvln.episodes.goals import _distinct, _spread, goal_points, scene_goals
from condvln.episodes.kernels.spread import farthest_points
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import round_mm
from schemas.config import GoalsConfig, PlacesConfig
from schemas.config.constants import RING_SPACING
from tests.condvln.episodes.floors import apartment, box, grid_floor


class Ways:
    """A pathfinder that knows the geodesic distance to each point by the point's height."""

    def __init__(self) -> None:
        self.asked = 0

    def geodesic_distances(self, start: np.ndarray, ends: np.ndarray) -> np.ndarray:
        self.asked += len(ends)
        return 1e3 * ends[:, 1]


@given(st.integers(1, 40), st.integers(1, 9), st.floats(0.0, 1.0), st.integers(0, 2**32))
def test_few_geodesics_decide_as_all_of_them(n: int, count: int, share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.random((n, 3)) * [3.0, 1e-3, 3.0]
    points[0, 1] = 0.0
    limit = 1e3 * float(np.quantile(points[:, 1], share))
    footprint = Footprint(np.array([1.5, 1.5]), np.array([0.2, 0.4]), np.eye(2))
    pathfinder = Ways()
    found = _spread(points, footprint, count, cast("Pathfinder", pathfinder), limit)
    reached = points[1e3 * points[:, 1] <= limit]
    chosen = reached[farthest_points(reached, count, np.zeros(len(reached), bool), RING_SPACING)]
    assert np.array_equal(found, chosen[np.argsort(footprint.distance(chosen), kind="stable")])
    assert len(found) <= pathfinder.asked <= n


def test_points_far_from_one_another_are_chosen_one_by_one() -> None:
    rng = np.random.default_rng(7)
    for _ in range(60):
        points = rng.integers(0, 6, (int(rng.integers(1, 12)), 3)).astype(np.float64)  # many distances are equal
        excluded = rng.random(len(points)) < 0.3
        excluded[0] = False
        expected = [0]
        while len(expected) < 4:
            gaps = [
                -1.0 if out else min(float(np.linalg.norm(point - points[k])) for k in expected)
                for point, out in zip(points, excluded, strict=True)
            ]
            if max(gaps) < 1.5:
                break
            expected.append(gaps.index(max(gaps)))
        assert farthest_points(points, 4, excluded, 1.5).tolist() == expected[: max(1, len(points))]


def test_distinct_points_are_those_of_numpy() -> None:
    rng = np.random.default_rng(8)
    owner, points = rng.integers(0, 3, 300), round_mm(rng.integers(0, 3, (300, 3)) / 1000)
    whose, found = _distinct(owner, points)
    np.testing.assert_array_equal(np.column_stack([whose, found]), np.unique(np.column_stack([owner, points]), axis=0))
    assert _distinct(owner[:0], points[:0])[1].shape == (0, 3)


@pytest.mark.parametrize("at_once", [1, 300, 100_000])
def test_goal_points_of_an_object_do_not_depend_on_the_others(monkeypatch: pytest.MonkeyPatch, at_once: int) -> None:
    monkeypatch.setattr(goals_module, "TRIED_AT_ONCE", at_once)
    floor = grid_floor(6, 6, lambda x, z: False)
    scene = apartment(box("a", 1, 1), box("b", 3, 3), box("c", 5, 2), box("d", 3.2, 3.9))
    together = scene_goals(scene, floor, PlacesConfig(), GoalsConfig())
    assert list(together) == ["a", "b", "c", "d"]
    for name, points in together.items():
        alone = goal_points(scene.object_of[name], scene.rooms[0], floor, PlacesConfig(), GoalsConfig())
        np.testing.assert_array_equal(points, alone)


@given(st.integers(0, 2**32))
def test_only_points_near_a_footprint_are_inside(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turned = [Rotation.from_euler("y", angle).as_matrix()[np.ix_([0, 2], [0, 2])] for angle in rng.uniform(0, 7, 2)]
    boxes = [Footprint(rng.uniform(-2, 2, 2), rng.uniform(0, 1, 2), axes) for axes in turned]
    points = rng.uniform(-3, 3, (400, 3))
    for footprint in (*boxes, Footprint(boxes[0].center, boxes[0].half, boxes[0].axes, tuple(boxes))):
        assert not (footprint.distance(points)[~footprint.is_near(points)] == 0.0).any()


def test_only_named_objects_get_goal_points() -> None:
    floor = grid_floor(6, 6, lambda x, z: False)
    scene = apartment(box("a", 1, 1), box("b", 3, 3), box("c", 5, 2))
    whole = scene_goals(scene, floor, PlacesConfig(), GoalsConfig())
    some = scene_goals(scene, floor, PlacesConfig(), GoalsConfig(), named=frozenset({"c", "a", "elsewhere"}))
    assert list(whole) == ["a", "b", "c"]
    assert list(some) == ["a", "c"]
    for name, points in some.items():
        np.testing.assert_array_equal(points, whole[name])
