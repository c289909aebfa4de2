"""Reference agents order themselves on made episodes: what a ceiling, a floor and a guess must score.

tests/jobs/test_export_families.py asks the same of every family.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from condvln.evaluation.agents import AGENTS, predict_all
from condvln.evaluation.evaluate import evaluate
from condvln.evaluation.split import Export
from condvln.evaluation.task import Task
from condvln.navigation.scene_navmesh import NavmeshFolder


def check_ladder(tasks: list[Task], navmeshes: NavmeshFolder) -> None:
    found = {
        name: evaluate(tasks, predict_all(agent, tasks, navmeshes, seed=1), navmeshes, agent=name)
        for name, agent in AGENTS.items()
    }

    def mean(name: str, measure: str, where: np.ndarray | slice = slice(None)) -> float:
        return float(found[name].scores[measure][where].mean())

    for name in ("perfect", "oracle"):
        for measure in ("success", "oracle_success", "bsa_all", "csr_all", "leaf_correct"):
            assert (found[name].scores[measure] == 1).all(), (name, measure)
        assert (found[name].scores["bsa"] == 1).all()
        assert mean(name, "ndtw") >= 0.95
    # The path's corners are rounded to 1 mm, the route's length is not.
    rounding = np.array([0.002 * len(task.gold.path) / task.gold.route_length for task in tasks])
    assert (found["perfect"].scores["spl_route"] >= 1 - rounding).all()
    np.testing.assert_allclose(found["perfect"].scores["spl_route"], 1, atol=1e-3)
    assert mean("oracle", "spl_route") >= 0.95
    direct = np.array([len(task.gold.subgoals) == 0 for task in tasks])
    assert not direct.any() or mean("oracle", "spl", direct) >= 0.95
    assert (found["oracle"].scores["over_budget"] == 0).all()
    assert (found["wrong-branch"].scores["success"] == 0).all()
    assert mean("wrong-branch", "wrong_branch") >= 0.95
    for name, truth in (("always-then", True), ("always-else", False)):
        expected = [task.gold_leaf == task.program.gold_leaf([truth] * len(task.program.conditions)) for task in tasks]
        assert found[name].scores["success"].tolist() == [float(right) for right in expected], name
    chance = np.array([1 / len(task.leaves) for task in tasks])
    spread = math.sqrt(float((chance * (1 - chance)).sum())) / len(tasks)
    assert abs(mean("random-leaf", "success") - chance.mean()) < 3.5 * spread
    assert mean("stop-at-start", "success") == 0


def test_ladder(made: tuple[Export, Path]) -> None:
    export, root = made
    tasks = export.tasks("train")
    assert len(tasks) >= 10
    check_ladder(tasks, NavmeshFolder((export.folder, root)))
