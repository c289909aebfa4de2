"""The optional habitat-sim backend, against a stand-in for its Python API."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from condvln.navigation.habitat_pathfinder import HabitatPathfinder
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.protocol import PathfinderProtocol
from schemas.errors import FormatError, UsageError


class StandIn:
    """habitat_sim.nav.PathFinder as its documentation gives it, answering with our own numbers."""

    def load_nav_mesh(self, path: str) -> bool:
        if Path(path).read_bytes()[:4] != b"TESM":
            return False
        self.ours = Pathfinder.load(path)
        self.nav_mesh_settings = SimpleNamespace(agent_radius=0.1, agent_height=1.5, cell_size=0.05)
        self.seeds: list[int] = []
        return True

    def find_path(self, query: Any) -> bool:
        if hasattr(query, "requested_ends"):
            path = self.ours.find_multi_goal_path(query.requested_start, query.requested_ends)
            query.closest_end_point_index = path.closest_goal
        else:
            path = self.ours.find_path(query.requested_start, query.requested_end)
        query.geodesic_distance, query.points = path.geodesic_distance, list(path.points)
        return path.found

    def snap_point(self, point: np.ndarray, island_index: int = -1) -> np.ndarray:
        return self.ours.snap_point(point, None if island_index < 0 else island_index)

    def get_random_navigable_point(self, max_tries: int = 10, island_index: int = -1) -> np.ndarray:
        island = None if island_index < 0 else island_index
        return self.ours.get_random_navigable_points(1, self.seeds[-1], island)[0]

    def seed(self, seed: int) -> None:
        self.seeds.append(seed)

    def get_bounds(self) -> Any:
        return self.ours.bounds

    def __getattr__(self, name: str) -> Any:
        return getattr(self.ours, name)


@pytest.fixture
def habitat(monkeypatch: pytest.MonkeyPatch) -> None:
    nav = ModuleType("habitat_sim.nav")
    nav.PathFinder = StandIn  # type: ignore[attr-defined]
    nav.ShortestPath = nav.MultiGoalShortestPath = SimpleNamespace  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "habitat_sim", ModuleType("habitat_sim"))
    monkeypatch.setitem(sys.modules, "habitat_sim.nav", nav)


def test_without_habitat_sim_the_error_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "habitat_sim", None)
    monkeypatch.setitem(sys.modules, "habitat_sim.nav", None)
    with pytest.raises(UsageError, match="not installed"):
        HabitatPathfinder(tmp_path / "x.navmesh")


@pytest.mark.usefixtures("habitat")
def test_answers_pass_through(two_islands: Pathfinder, tmp_path: Path) -> None:
    two_islands.save(tmp_path / "x.navmesh")
    backend = HabitatPathfinder.load(tmp_path / "x.navmesh")
    assert isinstance(backend, PathfinderProtocol)
    small, large, lost = [0.2, 0, 0.5], [5.5, 1, 0.5], [90.0, 0, 0]
    points = [small, large, lost]
    for start in points:
        for end in points:
            ours, theirs = two_islands.find_path(start, end), backend.find_path(start, end)
            assert (theirs.geodesic_distance, theirs.closest_goal) == (ours.geodesic_distance, ours.closest_goal)
            np.testing.assert_array_equal(theirs.points, ours.points)
    assert backend.find_multi_goal_path(small, [large, [0.9, 0, 0.5]]).closest_goal == 1
    assert backend.geodesic_distance(small, [large, [0.9, 0, 0.5]]) == pytest.approx(0.7)
    np.testing.assert_array_equal(backend.distance_table(points, points), two_islands.distance_table(points, points))
    np.testing.assert_array_equal(
        backend.geodesic_distances(small, points), two_islands.geodesic_distances(small, points)
    )
    np.testing.assert_array_equal(backend.snap_points(points), two_islands.snap_points(points))
    np.testing.assert_array_equal(backend.snap_point([2.4, 0.5, 0.5], 1), np.float32([4, 1, 0.5]))
    assert backend.get_islands(points).tolist() == [0, 1, -1]
    assert backend.island_radius(1) == backend.island_radius(large) == two_islands.island_radius(1)
    assert backend.island_area(1) == two_islands.island_area(1)
    assert backend.is_navigable(small)
    assert backend.navigable_area == two_islands.navigable_area
    assert backend.num_islands == 2
    np.testing.assert_array_equal(backend.bounds, two_islands.bounds)
    assert backend.settings is not None
    assert backend.settings.agent_radius == 0.1
    drawn = backend.get_random_navigable_points(3, 5, island=1)
    assert set(backend.get_islands(drawn).tolist()) == {1}
    np.testing.assert_array_equal(drawn, backend.get_random_navigable_points(3, 5, island=1))


@pytest.mark.usefixtures("habitat")
def test_a_file_that_habitat_refuses(tmp_path: Path) -> None:
    (tmp_path / "bad.navmesh").write_bytes(b"nothing")
    with pytest.raises(FormatError, match="can't load"):
        HabitatPathfinder(tmp_path / "bad.navmesh")
    with pytest.raises(FormatError, match="can't load"):
        HabitatPathfinder(tmp_path / "none.navmesh")
