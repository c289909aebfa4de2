"""Every answer that habitat-sim itself gave on twelve real navmeshes, compared bit for bit in float32."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.navigation.pathfinder import Pathfinder

NAVMESHES = [
    "gibson/navmesh/Oyens.navmesh",
    "hm3d/TEEsavR23oF.basis.navmesh",
    *(
        f"replicacad/{folder}/{name}.navmesh"
        for folder in ("navmeshes", "navmeshes_default")
        for name in ("apt_1", "empty_stage", "v3_sc0_staging_00", "v3_sc0_staging_07", "v3_sc1_staging_03")
    ),
]


def single(numbers: Any) -> np.ndarray:
    """float32 array of golden numbers; a null is what JSON can't hold, infinite for a distance and NaN elsewhere."""
    return np.array(numbers, dtype=np.float32)


@pytest.fixture(scope="module", params=NAVMESHES)
def golden(request: pytest.FixtureRequest, real_data: Path) -> tuple[Pathfinder, dict[str, Any]]:
    answers = real_data / "navmesh_golden" / "queries" / f"{request.param.replace('/', '__')}.json.gz"
    with gzip.open(answers) as file:
        return Pathfinder.load(real_data / request.param), json.load(file)


def test_paths(golden: tuple[Pathfinder, dict[str, Any]]) -> None:
    pathfinder, answers = golden
    cases = answers["find_path"]
    assert len(cases) == 200
    starts, ends = single([c["start"] for c in cases]), single([c["end"] for c in cases])
    expected = single([np.inf if c["geodesic_distance"] is None else c["geodesic_distance"] for c in cases])
    np.testing.assert_array_equal(pathfinder.geodesic_distances(starts, ends), expected)
    paths = pathfinder.find_paths(starts, ends)
    assert [p.found for p in paths] == [c["found"] for c in cases]
    for path, case in zip(paths, cases, strict=True):
        np.testing.assert_array_equal(path.points, single(case["points"]).reshape(-1, 3))


def test_snaps(golden: tuple[Pathfinder, dict[str, Any]]) -> None:
    pathfinder, answers = golden
    cases = answers["snap_point"]
    expected = single([c["snapped"] or [np.nan] * 3 for c in cases])
    np.testing.assert_array_equal(pathfinder.snap_points([c["point"] for c in cases]), expected)


def test_islands(golden: tuple[Pathfinder, dict[str, Any]]) -> None:
    pathfinder, answers = golden
    cases = answers["island"]
    assert pathfinder.get_islands([c["point"] for c in cases]).tolist() == [c["index"] for c in cases]
    radii = single([pathfinder.island_radius(c["point"]) for c in cases])
    np.testing.assert_array_equal(radii, single([c["radius"] for c in cases]))
    found = [[pathfinder.island_radius(i), pathfinder.island_area(i)] for i in range(pathfinder.num_islands)]
    np.testing.assert_array_equal(single(found), single(answers["islands"]))
    assert np.float32(pathfinder.navigable_area) == np.float32(answers["area"])


def test_navigability(golden: tuple[Pathfinder, dict[str, Any]]) -> None:
    pathfinder, answers = golden
    for case in answers["is_navigable"]:
        assert pathfinder.is_navigable(case["point"], case["max_y_delta"]) is case["navigable"]


@pytest.mark.parametrize(("kind", "sliding"), [("try_step", True), ("try_step_no_sliding", False)])
def test_steps(golden: tuple[Pathfinder, dict[str, Any]], kind: str, sliding: bool) -> None:
    pathfinder, answers = golden
    cases = answers[kind]
    reached = pathfinder.try_steps([c["start"] for c in cases], [c["end"] for c in cases], sliding)
    np.testing.assert_array_equal(reached, single([c["result"] for c in cases]))


def test_obstacles(golden: tuple[Pathfinder, dict[str, Any]]) -> None:
    pathfinder, answers = golden
    for case in answers["distance_to_closest_obstacle"]:
        expected = case["answer"]
        hit = pathfinder.closest_obstacle_surface_point(case["point"], case["max_search_radius"])
        assert np.float32(hit.hit_dist) == np.float32(np.inf if expected[0] is None else expected[0])
        assert hit.hit_dist == pathfinder.distance_to_closest_obstacle(case["point"], case["max_search_radius"])
        np.testing.assert_array_equal(hit.hit_pos, single(expected[1:4]))
        np.testing.assert_array_equal(hit.hit_normal, single(expected[4:]))
