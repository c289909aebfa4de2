"""docs/metrics.md names every measure, agent and constant as the code has them."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from condvln.evaluation.agents import AGENTS
from condvln.evaluation.aggregate import REPLICATES
from condvln.evaluation.discrete import ERROR_MARGIN
from condvln.evaluation.goal_distances import (
    ASTRAY,
    OFF_FLOOR,
    OFF_NAVMESH,
    RISE,
    SLACK,
    SLIDE,
    SNAPPED,
    Nearness,
)
from condvln.evaluation.measures import FIDELITY_DISTANCE, DistanceMode
from condvln.evaluation.metrics import METRICS, Shown, keys_of, metrics_of
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.score import START_TOLERANCE, Score, ScoreRules, score
from tests.condvln.evaluation.conftest import OpenPlain, task_with


@pytest.fixture(scope="module")
def text(repository: Path) -> str:
    return (repository / "docs" / "metrics.md").read_text(encoding="utf-8")


def test_every_measure_is_defined(text: str) -> None:
    for item in fields(Score):
        assert f"`{item.name}`" in text, item.name


def test_every_metric_is_a_score_and_every_name_of_it_is_its_own() -> None:
    assert {metric.key for metric in METRICS} == {item.name for item in fields(Score)} - {
        "committed_leaf",
        "divergence",
    }
    names = [name for metric in METRICS for name in metric.theirs]
    assert len(names) == len({*names})


@pytest.mark.parametrize("table", ["comparison", "ranking", "plots", "differences"])
def test_tables_that_show_per_cent_have_such_metrics_only(table: Shown) -> None:
    assert {metric.kind for metric in metrics_of(table)} == {"percent"}
    assert table != "ranking" or keys_of(table)[0] == "success", "its interval stands beside it"


def test_every_agent_is_described_and_no_other(text: str) -> None:
    table = text.split("## Reference agents")[1].split("\n## ")[0]
    assert re.findall(r"^\| `([a-z-]+)` \|", table, re.MULTILINE) == list(AGENTS)


def test_constants_are_those_of_the_code(text: str) -> None:
    assert (FIDELITY_DISTANCE, ERROR_MARGIN, START_TOLERANCE, SLACK, SNAPPED, REPLICATES) == (
        3,
        3,
        0.25,
        0.01,
        0.01,
        10_000,
    )
    assert (SLIDE, RISE, ASTRAY, OFF_NAVMESH, OFF_FLOOR) == (1.25, 2, 0.02, 0.1, 0.5)
    action = (
        "1.25 times the action",
        "more than 2 cm from",
        "twice the action",
        "0.1 m on the ground or 0.5 m in\n  height",
    )
    for phrase in (
        *action,
        "· 3 m))",
        "nearer than 3 m",
        "more than 0.25 m",
        "τ + 1 cm",
        "more than 1 cm",
        "10,000 draws",
    ):
        assert phrase in text, phrase


def test_the_warnings_about_the_authors_forks_name_what_the_code_has(text: str) -> None:
    warning = next(p for p in text.split("\n* ") if p.startswith("**Open-Nav's log**"))
    for phrase in ("≤ 3 m", "`SUCCESS_DISTANCE`", "stops at the start", "from its result files"):
        assert phrase in warning, phrase
    assert [f"`--distance {mode}`" in text for mode in get_args(DistanceMode)] == [False, True, True], "the default"


def test_at_three_metres_an_agent_that_stays_succeeds() -> None:
    """Why the page warns of Open-Nav's log: its fixed 3 m are more than many routes are long."""
    task = task_with([{"goals": [[2.5, 0, 0]]}, {"goals": [[0, 0, 6]]}])
    stays = Prediction("e", np.zeros((1, 3)), stopped=True, counts_actions=True)
    found = [
        score(task, stays, Nearness(OpenPlain()), ScoreRules(success_distance=distance)).success
        for distance in (None, 3.0)
    ]
    assert found == [0, 1]


def test_every_table_is_a_table(text: str) -> None:
    widths: list[int] = []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            widths.append(len(re.findall(r"(?<!\\)\|", line)))
        else:
            assert len(set(widths)) <= 1, line
            widths = []
