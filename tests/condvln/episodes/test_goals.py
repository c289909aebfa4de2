"""Goal points are spread out among those on the same side of walls."""

from __future__ import annotations

import numpy as np

from condvln.episodes.goals import farthest_points, goal_points, scene_goals
from condvln.episodes.view import SceneView
from condvln.scene import SceneObject
from schemas.config import GoalsConfig, PlacesConfig
from tests.condvln.episodes.floors import RULE, apartment, box, grid_floor


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


def test_only_named_objects_get_goal_points() -> None:
    floor = grid_floor(6, 6, lambda x, z: False)
    scene = apartment(box("a", 1, 1), box("b", 3, 3), box("c", 5, 2))
    whole = scene_goals(scene, floor, PlacesConfig(), GoalsConfig())
    some = scene_goals(scene, floor, PlacesConfig(), GoalsConfig(), named=frozenset({"c", "a", "elsewhere"}))
    assert list(whole) == ["a", "b", "c"]
    assert list(some) == ["a", "c"]
    for name, points in some.items():
        np.testing.assert_array_equal(points, whole[name])


def test_nobody_stops_in_the_plane_of_a_thin_thing() -> None:
    """From there rounding decides whether its face is seen; without a view there are such points."""
    aabb = np.array([[2.2, 0.9, 2.99], [3.0, 1.8, 3.01]])
    mirror = SceneObject("mirror", "zone", "mirror", "mirror", aabb.mean(axis=0), aabb=aabb)
    scene, floor = apartment(mirror), grid_floor(6, 6, lambda x, z: False)
    asked = mirror, scene.rooms[0], floor, PlacesConfig(), GoalsConfig(points=1000)

    def in_plane(points: np.ndarray) -> np.ndarray:
        return np.abs(np.abs(points[:, 2] - 3.0) - 0.01) < 0.01

    assert in_plane(goal_points(*asked)).any()
    seen = goal_points(*asked, sight=(SceneView(scene), RULE))
    assert len(seen)
    assert not in_plane(seen).any()
