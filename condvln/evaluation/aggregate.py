"""Aggregate scores: means by group, axis and success distance, leaf confusion, counterfactual groups, paired
comparison; with confidence intervals and significance tests.

Episodes of a scene share its floor plan, so whole scenes are resampled. Intervals: cluster bootstrap as in Cameron,
Gelbach and Miller (2008), percentiles. Comparison of two agents: paired permutation of their labels, scene by scene.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from condvln.arrays import F64
from condvln.evaluation.evaluate import SWEPT, Evaluation
from condvln.evaluation.metrics import METRICS
from condvln.evaluation.task import Task
from schemas.errors import UsageError
from schemas.program import leaf_truths

__all__ = [
    "CONFIDENCE",
    "MEASURES",
    "REPLICATES",
    "Estimate",
    "GroupAccuracy",
    "PairedTest",
    "Summary",
    "by_axis",
    "compare",
    "divergences",
    "estimate",
    "group_accuracy",
    "leaf_confusion",
    "paired_test",
    "summary",
    "sweep_summary",
]

MEASURES: Final = tuple(metric.key for metric in METRICS)
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


def by_axis(evaluation: Evaluation, *axes: str, measures: Sequence[str] = MEASURES) -> list[Summary]:
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
        found.append(summary(evaluation, where, dict(zip(axes, key, strict=True)), measures=measures))
    return found


def sweep_summary(evaluation: Evaluation) -> list[Summary]:
    """Return one summary for each success distance of the sweep."""
    scenes = evaluation.axes["scene"].astype(str)
    return [
        Summary(
            {"success_distance": radius},
            len(evaluation),
            {name: estimate(columns[name], scenes) for name in SWEPT},
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


def group_accuracy(evaluation: Evaluation) -> GroupAccuracy:
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
        return estimate(np.array([scores[group].min() for group in rows]), of_groups)

    return GroupAccuracy(len(rows), len(flat), share(success), share(leaf), estimate(success[flat], scenes[flat]))


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
        route = len(leaf_truths(task.program.category)[task.gold_leaf])
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


CONFIDENCE: Final = 0.95
REPLICATES: Final = 10_000
"""Number of bootstrap or permutation draws: the third digit of a p-value no longer changes."""

_KEPT_SCENES: Final = 64
"""Up to this many scenes, draws are kept: 5 MB at most for a number of scenes, of which eight are kept."""

_EXACT_SCENES: Final = 13
"""Up to this many scenes, all sign patterns are enumerated (8,192) instead of drawn."""

Labels = npt.NDArray[Any] | Sequence[Any]


@dataclass(frozen=True)
class Estimate:
    """A mean with its confidence interval.

    Attributes
    ----------
    mean : NaN if no value is defined
    low, high : bounds of the interval; NaN with fewer than two scenes
    n : number of episodes with a value; total : number of all episodes
    scenes : number of scenes with a value
    """

    mean: float
    low: float
    high: float
    n: int
    total: int
    scenes: int


def estimate(
    values: F64, scenes: Labels, *, seed: int = 0, replicates: int = REPLICATES, confidence: float = CONFIDENCE
) -> Estimate:
    """Return the mean over the episodes where ``values`` (n,) is defined, with a bootstrap interval over scenes."""
    defined = np.isfinite(values)
    n, total = int(defined.sum()), len(values)
    if n == 0:
        return Estimate(float("nan"), float("nan"), float("nan"), 0, total, 0)
    names, cluster = np.unique(np.asarray(scenes)[defined], return_inverse=True)
    mean = float(values[defined].mean())
    if len(names) < 2:
        return Estimate(mean, float("nan"), float("nan"), n, total, len(names))
    sums = np.bincount(cluster, weights=values[defined])
    counts = np.bincount(cluster).astype(np.float64)
    draws = (_kept_draws if len(names) <= _KEPT_SCENES else _drawn)(seed, len(names), replicates)
    means = (draws @ sums) / (draws @ counts)
    tail = (1 - confidence) / 2
    low, high = np.quantile(means, [tail, 1 - tail])
    return Estimate(mean, float(low), float(high), n, total, len(names))


def _drawn(seed: int, scenes: int, replicates: int) -> F64:
    """Return how often each scene is drawn in each replicate (replicates, scenes); it is read only."""
    draws = np.random.default_rng(seed).multinomial(scenes, np.full(scenes, 1 / scenes), size=replicates)
    found = draws.astype(np.float64)
    found.flags.writeable = False
    return found


_kept_draws: Final = lru_cache(maxsize=8)(_drawn)
"""All measures of a group, and all groups of as many scenes, have the same draws."""


@dataclass(frozen=True)
class PairedTest:
    """The difference between two agents in a measure, over the episodes that both were scored on.

    Attributes
    ----------
    difference : mean of first − second
    p_value : two-sided; at least 2 ÷ 2^scenes
    exact : all sign patterns were enumerated
    """

    difference: float
    p_value: float
    n: int
    scenes: int
    exact: bool


def paired_test(first: F64, second: F64, scenes: Labels, *, seed: int = 0, replicates: int = REPLICATES) -> PairedTest:
    """Test whether the scores of two agents differ. Under the null hypothesis, the scores of the two agents can be
    swapped in any scene.

    Parameters
    ----------
    first, second : (n,) scores of the same episodes; an episode is left out if either is NaN
    """
    defined = np.isfinite(first) & np.isfinite(second)
    n = int(defined.sum())
    if n == 0:
        return PairedTest(float("nan"), float("nan"), 0, 0, True)
    names, cluster = np.unique(np.asarray(scenes)[defined], return_inverse=True)
    sums = np.bincount(cluster, weights=(first - second)[defined])
    observed = abs(float(sums.sum()))
    exact = len(names) <= _EXACT_SCENES
    if exact:
        signs = np.array(list(product((1.0, -1.0), repeat=len(names))))
    else:
        signs = np.random.default_rng(seed).choice((1.0, -1.0), size=(replicates, len(names)))
    # Sums that differ only by rounding count as equal.
    extreme = int((np.abs(signs @ sums) >= observed - 1e-9 * max(1.0, observed)).sum())
    p_value = extreme / len(signs) if exact else (extreme + 1) / (len(signs) + 1)
    return PairedTest(float(sums.sum()) / n, p_value, n, len(names), exact)
