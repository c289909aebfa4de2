"""Aggregate scores: means by group, axis and success distance, leaf confusion, counterfactual groups, paired
comparison.
"""

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
    """Means of the measures over one group of episodes, with confidence intervals."""

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
    """Return the means over the episodes selected by the mask ``where`` (n,), or over all episodes."""
    chosen = np.ones(len(evaluation), dtype=bool) if where is None else where
    scenes = evaluation.axes["scene"][chosen].astype(str)
    estimates = {name: estimate(evaluation.scores[name][chosen], scenes, seed=seed) for name in measures}
    return Summary(dict(group or {}), int(chosen.sum()), estimates)


def by_axis(evaluation: Evaluation, *axes: str, seed: int = 0, measures: Sequence[str] = MEASURES) -> list[Summary]:
    """Return one summary for each combination of values of ``axes`` that occurs, sorted.

    Raises
    ------
    UsageError : an axis is unknown
    """
    unknown = [axis for axis in axes if axis not in evaluation.axes]
    if unknown:
        raise UsageError(f"no axis {unknown[0]!r}", remedy=f"Choose from {', '.join(evaluation.axes)}")
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
    """Return one summary for each success distance of the sweep."""
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
    """Accuracy over counterfactual groups. The episodes of a group have the same text, but the truths of the conditions
    in this text differ, and so do the gold leaves.

    ``all_right`` is the share of groups in which every episode succeeded; an agent that ignores the conditions succeeds
    in at most one episode of each. ``single`` is the mean success over the same episodes. Intervals resample scenes.
    """

    groups: int
    episodes: int
    all_right: Estimate
    all_leaves_right: Estimate
    single: Estimate


def group_accuracy(evaluation: Evaluation, *, seed: int = 0) -> GroupAccuracy:
    """Return the accuracy over the counterfactual groups that have at least two episodes in the split."""
    members: dict[str, list[int]] = defaultdict(list)
    for row, group in enumerate(evaluation.group_ids):
        if group is not None:
            members[group].append(row)
    rows = [group for group in members.values() if len(group) > 1]
    success, leaf = evaluation.scores["success"], evaluation.scores["leaf_correct"]
    scenes = evaluation.axes["scene"].astype(str)
    # All episodes of a group are in one scene.
    of_groups = scenes[[group[0] for group in rows]]
    flat = [row for group in rows for row in group]

    def share(scores: npt.NDArray[np.float64]) -> Estimate:
        # All are right if the least success is 1; an unknown success makes the group unknown.
        return estimate(np.array([scores[group].min() for group in rows]), of_groups, seed=seed)

    return GroupAccuracy(
        len(rows), len(flat), share(success), share(leaf), estimate(success[flat], scenes[flat], seed=seed)
    )


def leaf_confusion(evaluation: Evaluation) -> dict[str, npt.NDArray[np.int64]]:
    """Return, by category, a table of numbers of episodes: gold leaves as rows, committed leaves as columns. The last
    column counts episodes without a committed leaf.

    Empty if the results do not say which leaf was reached, as in results of other evaluators.
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
        np.add.at(table, (evaluation.gold_leaf[rows], committed), 1)  # −1 (no leaf) indexes the last column
        tables[str(category)] = table
    return tables


def divergences(evaluation: Evaluation, tasks: Sequence[Task]) -> dict[int, tuple[int, int]]:
    """Return, by position on the gold path (0 is the first condition), the number of episodes that reached that
    condition and the number that answered it wrongly.

    Only episodes with a committed leaf count.
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
    """Return the paired test of two agents on one split.

    Raises
    ------
    UsageError : the agents were not evaluated on the same episodes
    """
    if first.episode_ids != second.episode_ids:
        raise UsageError(
            f"{first.agent} and {second.agent} were evaluated on different episodes",
            remedy="Evaluate both on the same split in one call",
        )
    scenes = first.axes["scene"].astype(str)
    return paired_test(first.scores[measure], second.scores[measure], scenes, seed=seed)
