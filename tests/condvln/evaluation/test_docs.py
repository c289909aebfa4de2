"""docs/metrics.md names every measure, agent and constant as the code has them."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from condvln.evaluation.agents import AGENTS
from condvln.evaluation.goal_distances import (
    Nearness,
)
from condvln.evaluation.metrics import METRICS, Better, Kind, OfSuccess, Shown
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.score import Score, ScoreRules, score
from tests.condvln.evaluation.conftest import OpenPlain, task_with


@pytest.fixture(scope="module")
def text(repository: Path) -> str:
    return (repository / "docs" / "metrics.md").read_text(encoding="utf-8")


def test_every_measure_is_defined(text: str) -> None:
    for item in fields(Score):
        assert f"`{item.name}`" in text, item.name


def test_the_table_of_metrics_has_known_words_only() -> None:
    """A misspelt one would leave a metric out of a table without a word."""
    for metric in METRICS:
        assert {*metric.shown} <= {*get_args(Shown)}, metric.key
        assert metric.kind in get_args(Kind), metric.key
        assert metric.better in get_args(Better), metric.key
        assert metric.success in get_args(OfSuccess), metric.key
    assert {table for metric in METRICS for table in metric.shown} == {*get_args(Shown)}, "no table is empty"


def test_every_metric_is_a_score_and_every_name_of_it_is_its_own() -> None:
    assert {metric.key for metric in METRICS} == {item.name for item in fields(Score)} - {
        "committed_leaf",
        "divergence",
    }
    names = [name for metric in METRICS for name in metric.theirs]
    assert len(names) == len({*names})


def test_every_agent_is_described_and_no_other(text: str) -> None:
    table = text.split("## Reference agents")[1].split("\n## ")[0]
    assert re.findall(r"^\| `([a-z-]+)` \|", table, re.MULTILINE) == list(AGENTS)


def test_at_three_metres_an_agent_that_stays_succeeds() -> None:
    """Why the page warns of Open-Nav's log: its fixed 3 m are more than many routes are long."""
    task = task_with([{"goals": [[2.5, 0, 0]]}, {"goals": [[0, 0, 6]]}])
    stays = Prediction("e", np.zeros((1, 3)), stopped=True, counts_actions=True)
    found = [
        score(task, stays, Nearness(OpenPlain()), ScoreRules(success_distance=distance)).success
        for distance in (None, 3.0)
    ]
    assert found == [0, 1]
