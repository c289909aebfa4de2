"""Scores → means by group: main table, axes, sweeps, confusion of leaves, counterfactual groups, two agents side by
side."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from condvln.evaluation.evaluate import SWEPT, Evaluation
from condvln.evaluation.measures import decisions
from condvln.evaluation.statistics import Estimate, PairedTest, estimate, paired_test
from condvln.evaluation.task import Task
from schemas.errors import UsageError

__all__ = [
    "MEASURES",
    "GroupAccuracy",
    "Summary",
    "by_axis",
    "compare",
    "divergences",
    "group_accuracy",
    "leaf_confusion",
    "summary",
    "sweep_summary",
]

MEASURES: Final = (
    "path_length",
    "navigation_error",
    "oracle_success",
    "success",
    "spl",
    "spl_route",
    "ndtw",
    "sdtw",
    "cls",
    "bsa",
    "csr",
    "bsa_all",
    "csr_all",
    "leaf_correct",
    "wrong_branch",
    "no_commit",
    "steps",
    "collisions",
    "stopped",
    "unreachable",
    "over_budget",
    "missing",
)
"""Columns of a summary, in the order of the tables."""


@dataclass(frozen=True)
class Summary:
    """Means of one group of episodes."""

    group: Mapping[str, Any]
    episodes: int
    estimates: Mapping[str, Estimate]


def summary(
    evaluation: Evaluation,
    where: npt.NDArray[np.bool_] | None = None,
    group: Mapping[str, Any] | None = None,
    *,
    seed: int = 0,
    measures: Sequence[str] = MEASURES,
) -> Summary:
    """Means over the episodes ``where`` (n,), or all."""
    chosen = np.ones(len(evaluation), dtype=bool) if where is None else where
    scenes = evaluation.axes["scene"][chosen].astype(str)
    estimates = {name: estimate(evaluation.scores[name][chosen], scenes, seed=seed) for name in measures}
    return Summary(dict(group or {}), int(chosen.sum()), estimates)


def by_axis(evaluation: Evaluation, *axes: str, seed: int = 0, measures: Sequence[str] = MEASURES) -> list[Summary]:
    """One summary for each combination of values of ``axes`` that occurs, sorted.

    Raises
    ------
    UsageError : no such axis
    """
    unknown = [axis for axis in axes if axis not in evaluation.axes]
    if unknown:
        raise UsageError(f"no axis {unknown[0]!r}", remedy=f"Axes are {', '.join(evaluation.axes)}")
    keys = list(zip(*(evaluation.axes[axis].tolist() for axis in axes), strict=True))
    rows: dict[tuple[Any, ...], list[int]] = defaultdict(list)
    for row, key in enumerate(keys):
        rows[key].append(row)
    found = []
    for key in sorted(rows, key=lambda key: [(value is None, str(type(value)), value) for value in key]):
        where = np.zeros(len(evaluation), dtype=bool)
        where[rows[key]] = True
        found.append(summary(evaluation, where, dict(zip(axes, key, strict=True)), seed=seed, measures=measures))
    return found


def sweep_summary(evaluation: Evaluation, *, seed: int = 0) -> list[Summary]:
    """One summary for each success distance of the sweep."""
    scenes = evaluation.axes["scene"].astype(str)
    return [
        Summary(
            {"success_distance": radius},
            len(evaluation),
            {name: estimate(columns[name], scenes, seed=seed) for name in SWEPT},
        )
        for radius, columns in sorted(evaluation.sweep.items())
    ]


@dataclass(frozen=True)
class GroupAccuracy:
    """Counterfactual groups: episodes that differ in what is true, and so in where to go.

    ``all_right`` is the share of groups in which every episode succeeded: an agent that ignores the condition gets at
    best one of each. ``single`` is the mean success of the same episodes. Intervals draw scenes, as everywhere.
    """

    groups: int
    episodes: int
    all_right: Estimate
    all_leaves_right: Estimate
    single: Estimate


def group_accuracy(evaluation: Evaluation, *, seed: int = 0) -> GroupAccuracy:
    """Summary over the groups that have at least two episodes in the split."""
    members: dict[str, list[int]] = defaultdict(list)
    for row, group in enumerate(evaluation.group_ids):
        if group is not None:
            members[group].append(row)
    rows = [group for group in members.values() if len(group) > 1]
    success, leaf = evaluation.scores["success"], evaluation.scores["leaf_correct"]
    scenes = evaluation.axes["scene"].astype(str)
    # A group is of one scene.
    of_groups = scenes[[group[0] for group in rows]]
    flat = [row for group in rows for row in group]

    def share(scores: npt.NDArray[np.float64]) -> Estimate:
        # All are right where the worst is; one that nobody knows leaves the group unknown.
        return estimate(np.array([scores[group].min() for group in rows]), of_groups, seed=seed)

    return GroupAccuracy(
        len(rows), len(flat), share(success), share(leaf), estimate(success[flat], scenes[flat], seed=seed)
    )


def leaf_confusion(evaluation: Evaluation) -> dict[str, npt.NDArray[np.int64]]:
    """By category, counts of (gold leaf, leaf committed to); the last column counts agents that committed to none.

    Empty where nothing tells which leaf was reached, as in others' results.
    """
    tables: dict[str, npt.NDArray[np.int64]] = {}
    if np.isnan(evaluation.scores["leaf_correct"]).any():
        return tables
    categories = evaluation.axes["category"]
    for category in sorted(set(categories.tolist())):
        rows = np.flatnonzero(categories == category)
        leaves = int(evaluation.n_leaves[rows].max())
        table = np.zeros((leaves, leaves + 1), dtype=np.int64)
        committed = evaluation.scores["committed_leaf"][rows].astype(np.int64)
        np.add.at(table, (evaluation.gold_leaf[rows], committed), 1)  # −1, no leaf, is the last column
        tables[str(category)] = table
    return tables


def divergences(evaluation: Evaluation, tasks: Sequence[Task]) -> dict[int, tuple[int, int]]:
    """By place on the gold route (0 = the first condition): episodes that met it on their way, and that erred there.

    Only episodes that committed to a leaf are counted.
    """
    met: dict[int, int] = defaultdict(int)
    erred: dict[int, int] = defaultdict(int)
    wrong_at = evaluation.scores["divergence"]
    for row, task in enumerate(tasks):
        if evaluation.scores["no_commit"][row]:
            continue
        route = len(decisions(task.program, task.gold_leaf))
        last = route - 1 if np.isnan(wrong_at[row]) else int(wrong_at[row])
        for place in range(last + 1):
            met[place] += 1
        if not np.isnan(wrong_at[row]):
            erred[last] += 1
    return {place: (met[place], erred[place]) for place in sorted(met)}


def compare(first: Evaluation, second: Evaluation, measure: str = "success", *, seed: int = 0) -> PairedTest:
    """Paired test of two agents on one split.

    Raises
    ------
    UsageError : they were not evaluated on the same episodes
    """
    if first.episode_ids != second.episode_ids:
        raise UsageError(
            f"{first.agent} and {second.agent} were evaluated on different episodes",
            remedy="Evaluate both on the same split in one call",
        )
    scenes = first.axes["scene"].astype(str)
    return paired_test(first.scores[measure], second.scores[measure], scenes, seed=seed)
