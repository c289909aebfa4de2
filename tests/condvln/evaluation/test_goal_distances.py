"""Asking fewer distances changes no number: pruned against unpruned on navmeshes, with points on, beside and off the
floor."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from condvln.evaluation.goal_distances import Nearness
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.score import ScoreRules, score
from condvln.navigation.pathfinder import Pathfinder
from tests.condvln.evaluation.conftest import task_with


def random_walk(pathfinder: Pathfinder, rng: np.random.Generator, steps: int, how: str) -> np.ndarray:
    """Steps of at most 0.25 m on the floor; ``how`` then lifts, shifts or throws them off it."""
    at = pathfinder.get_random_navigable_points(1, rng)[0]
    path = [at]
    heading = rng.uniform(0, 2 * np.pi)
    for _ in range(steps - 1):
        heading += rng.normal(0, 0.5)
        at = pathfinder.try_step(at, at + 0.25 * np.array([np.cos(heading), 0, np.sin(heading)], np.float32))
        path.append(at)
    points = np.array(path, dtype=np.float64)
    if how == "lifted":
        points[:, 1] += rng.uniform(0, 0.3)
    elif how == "beside":
        points += rng.normal(0, 0.02, points.shape)
    elif how == "off":
        points[rng.random(len(points)) < 0.3] += rng.normal(0, 1.5, 3)
    return points


def compare(pathfinder: Pathfinder, seed: int, walks: int) -> int:
    rng = np.random.default_rng(seed)
    asked = 0
    for number in range(walks):
        how = ("floor", "lifted", "beside", "off")[number % 4]
        path = random_walk(pathfinder, rng, 60, how)

        def some(count: int, path: np.ndarray = path) -> np.ndarray:
            near = path[rng.integers(len(path), size=count)] + rng.normal(0, 0.6, (count, 3)) * [1, 0, 1]
            snapped = pathfinder.snap_points(near).astype(np.float64)
            # A goal off the floor now and then: it is then always asked about.
            return np.where(np.isnan(snapped) | (rng.random((count, 1)) < 0.1), near, snapped)

        leaves = [{"goals": some(int(rng.integers(1, 5))), "subgoals": some(int(rng.integers(0, 3)))} for _ in range(2)]
        for tau in (0.5, 1.0, 3.0):
            task = task_with(leaves, start=path[0], reference=path, tau=tau)
            prediction = Prediction("e", path, True, True)
            pruned, full = (
                asdict(score(task, prediction, Nearness(pathfinder, prune=prune), ScoreRules()))
                for prune in (True, False)
            )
            np.testing.assert_equal(pruned, full, err_msg=f"{how} {number} {tau}")
            asked += 1
    return asked


def test_no_number_changes_on_a_made_floor(l_shape: Pathfinder) -> None:
    assert compare(l_shape, 0, 24) == 72


def test_no_number_changes_in_a_real_home(real_data: Path) -> None:
    compare(Pathfinder.load(real_data / "hm3d" / "TEEsavR23oF.basis.navmesh"), 1, 12)


@pytest.mark.soak
def test_no_number_changes_anywhere(real_data: Path) -> None:
    for path in sorted(real_data.glob("**/*.navmesh")):
        if "golden" in path.parts or path.stat().st_size < 1000:
            continue
        compare(Pathfinder.load(path), 2, 4)


def test_unreachable_and_unprojectable_are_infinite(l_shape: Pathfinder) -> None:
    nearness = Nearness(l_shape)
    far = np.array([500.0, 0.0, 500.0])
    here = np.array([1.0, 0.0, 1.0])
    assert nearness.distance(far, here[None]) == np.inf
    assert nearness.distance(here, far[None]) == np.inf
    path = nearness.snap(np.array([far, here]))
    assert nearness.first_within(path, here, 1.0) == 1
    assert nearness.first_within(path, far, 1.0) is None
    assert not nearness.ever_within(path, far[None], 1.0)


def test_first_within_begins_where_it_is_told(l_shape: Pathfinder) -> None:
    nearness = Nearness(l_shape)
    path = nearness.snap(np.array([[x / 10, 0, 1.0] for x in range(40)] * 3))
    goal = np.array([1.0, 0.0, 1.0])
    assert nearness.first_within(path, goal, 0.25) == 8
    assert nearness.first_within(path, goal, 0.25, 9) == 9
    assert nearness.first_within(path, goal, 0.25, 13) == 48
    assert nearness.first_within(path, goal, 0.25, 100) is None
