"""Means by group, groups of counterfactuals, confusion, divergence, comparison: against counts by hand."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from condvln.evaluation.aggregate import (
    by_axis,
    compare,
    divergences,
    estimate,
    group_accuracy,
    leaf_confusion,
    summary,
    sweep_summary,
)
from condvln.evaluation.evaluate import Evaluation, evaluate
from condvln.evaluation.measures import first_divergence
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.task import Task
from schemas.errors import UsageError
from schemas.program import CATEGORIES, SHAPES, leaf_truths
from tests.condvln.evaluation.conftest import OpenPlain, program_of, task_with


def fleet(seed: int = 0, count: int = 120) -> list[Task]:
    """Tasks of every category, three scenes, pairs of counterfactuals."""
    rng = np.random.default_rng(seed)
    tasks = []
    for number in range(count):
        category = CATEGORIES[number // 2 % len(CATEGORIES)]
        leaves = SHAPES[category].leaves
        gold = number % 2 if number % 4 < 2 else int(rng.integers(leaves))
        around = [
            {"goals": [[10 * np.cos(a), 0, 10 * np.sin(a)]], "subgoals": [] if number % 3 else [[1.0, 0, 0]]}
            for a in np.arange(leaves) * 2 * np.pi / leaves
        ]
        task = task_with(around, gold, category=category, episode_id=f"e{number}")
        axes = {**task.axes, "scene": f"made/{number // 2 % 3}", "observability": (None, "O0", "O1")[number % 3]}
        group = f"g{number // 2}" if number % 4 < 2 else None
        tasks.append(replace(task, axes=axes, group_id=group))
    return tasks


def choosing(tasks: list[Task], leaf_of: dict[str, int | None]) -> list[Prediction]:
    predictions = []
    for task in tasks:
        leaf = leaf_of[task.episode_id]
        end = task.leaves[leaf].goals[0] if leaf is not None else np.array([0.1, 0, 0])
        predictions.append(Prediction(task.episode_id, np.array([task.start, end]), True, True))
    return predictions


@pytest.fixture(scope="module")
def tasks() -> list[Task]:
    return fleet()


@pytest.fixture(scope="module")
def choice(tasks: list[Task]) -> dict[str, int | None]:
    rng = np.random.default_rng(1)
    return {t.episode_id: [None, *range(len(t.leaves))][rng.integers(len(t.leaves) + 1)] for t in tasks}


@pytest.fixture(scope="module")
def found(tasks: list[Task], choice: dict[str, int | None]) -> Evaluation:
    return evaluate(tasks, choosing(tasks, choice), lambda task: OpenPlain(), agent="random", radii=(0.5, 30.0))


def test_summaries_are_means_over_their_rows(found: Evaluation) -> None:
    whole = summary(found)
    assert whole.episodes == len(found)
    assert whole.estimates["success"].mean == found.scores["success"].mean()
    assert whole.estimates["bsa"].n == int((~np.isnan(found.scores["bsa"])).sum()) < whole.estimates["bsa"].total
    rows = by_axis(found, "category", "observability")
    assert sum(row.episodes for row in rows) == len(found)
    for row in rows:
        where = (found.axes["category"] == row.group["category"]) & (
            found.axes["observability"] == row.group["observability"]
        )
        assert row.estimates["success"].mean == found.scores["success"][where].mean()
    assert [row.group["depth"] for row in by_axis(found, "depth")] == [1, 2, 3]
    assert {row.group["observability"] for row in by_axis(found, "observability")} == {None, "O0", "O1"}
    with pytest.raises(UsageError, match="no axis 'weather'"):
        by_axis(found, "weather")


def test_sweep(found: Evaluation) -> None:
    near, far = sweep_summary(found)
    assert (near.group["success_distance"], far.group["success_distance"]) == (0.5, 30.0)
    assert near.estimates["success"].mean == found.scores["success"].mean()
    assert far.estimates["success"].mean == 1


def test_groups_need_every_member_right(tasks: list[Task], choice: dict[str, int | None], found: Evaluation) -> None:
    groups: dict[str, list[bool]] = {}
    for task in tasks:
        if task.group_id:
            groups.setdefault(task.group_id, []).append(choice[task.episode_id] == task.gold_leaf)
    result = group_accuracy(found)
    assert result.groups == len(groups) == 30
    assert result.episodes == 60
    assert result.all_right == result.all_leaves_right
    assert result.all_right.mean == np.mean([all(g) for g in groups.values()])
    assert (result.all_right.n, result.single.n) == (result.groups, result.episodes)
    # Groups of one scene are no more independent than its episodes: the interval draws scenes.
    members = {g: [row for row, name in enumerate(found.group_ids) if name == g] for g in groups}
    right = np.array([found.scores["success"][rows].all() for rows in members.values()], dtype=float)
    scenes = [found.axes["scene"][rows[0]] for rows in members.values()]
    expected = estimate(right, scenes)
    assert (result.all_right.low, result.all_right.high, result.all_right.scenes) == (
        expected.low,
        expected.high,
        expected.scenes,
    )
    assert result.single.mean == np.mean([right for g in groups.values() for right in g])
    alone = replace(found, group_ids=tuple(f"g{i}" for i in range(len(found))))
    assert group_accuracy(alone).groups == 0


def test_ignoring_the_condition_gets_no_counterfactual_pair_right(tasks: list[Task]) -> None:
    always = evaluate(tasks, choosing(tasks, {t.episode_id: 0 for t in tasks}), lambda task: OpenPlain())
    assert group_accuracy(always).all_right.mean == 0
    assert group_accuracy(always).single.mean == 0.5


def test_where_no_leaf_is_known_none_is_right(found: Evaluation) -> None:
    unknown = np.full(len(found), np.nan)
    theirs = replace(found, scores={**found.scores, "leaf_correct": unknown})
    result = group_accuracy(theirs)
    assert np.isnan(result.all_leaves_right.mean)
    assert (result.all_leaves_right.n, result.all_leaves_right.total) == (0, result.groups)
    assert result.all_right == group_accuracy(found).all_right
    assert leaf_confusion(theirs) == {}


def test_confusion_counts(tasks: list[Task], choice: dict[str, int | None], found: Evaluation) -> None:
    tables = leaf_confusion(found)
    counts = Counter((t.axes["category"], t.gold_leaf, choice[t.episode_id]) for t in tasks)
    assert set(tables) == set(CATEGORIES)
    for (category, gold, leaf), count in counts.items():
        table = tables[str(category)]
        assert table.shape == (SHAPES[category].leaves, SHAPES[category].leaves + 1)
        assert table[gold, table.shape[1] - 1 if leaf is None else leaf] == count
    assert sum(table.sum() for table in tables.values()) == len(tasks)


def test_divergences_count_what_was_met_and_missed(
    tasks: list[Task], choice: dict[str, int | None], found: Evaluation
) -> None:
    met: Counter[int] = Counter()
    erred: Counter[int] = Counter()
    for task in tasks:
        leaf = choice[task.episode_id]
        if leaf is None:
            continue
        right, taken = (leaf_truths(task.program.category)[k] for k in (task.gold_leaf, leaf))
        for place, step in enumerate(right):
            met[place] += 1
            if place >= len(taken) or taken[place] != step:
                erred[place] += 1
                break
    assert divergences(found, tasks) == {place: (met[place], erred[place]) for place in sorted(met)}


@pytest.mark.parametrize("category", CATEGORIES)
def test_decisions_lead_to_their_leaf(category: str) -> None:
    program, routes = program_of(category), leaf_truths(category)
    for leaf, route in enumerate(routes):
        truths = [False] * len(program.conditions)
        for condition, answer in route:
            truths[condition] = answer
        assert program.gold_leaf(truths) == leaf
        assert program.route(truths)[0] == tuple(condition for condition, _ in route)
        for other in range(len(program.leaves)):
            place = first_divergence(program, leaf, other)
            assert (place is None) == (other == leaf)
            if place is not None:
                assert routes[other][:place] == route[:place]
                assert routes[other][place] != route[place]
    assert len({*routes}) == len(program.leaves)
    assert first_divergence(program, 0, -1) is None


def test_agents_are_compared_on_the_same_episodes(tasks: list[Task], found: Evaluation) -> None:
    perfect = evaluate(tasks, choosing(tasks, {t.episode_id: t.gold_leaf for t in tasks}), lambda task: OpenPlain())
    result = compare(perfect, found)
    assert result.difference == pytest.approx(1 - found.scores["success"].mean())
    assert (result.scenes, result.exact) == (3, True)
    assert result.p_value == 2 / 2**3
    with pytest.raises(UsageError, match="different episodes"):
        compare(found, evaluate(tasks[:-1], [], lambda task: OpenPlain()))
