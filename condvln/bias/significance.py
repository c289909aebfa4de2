"""Significance tests of a guesser's accuracy against chance.

An accuracy above chance may come from luck on single episodes, or from a few scenes in which one lucky guess is
repeated. Each has its own test, and the larger p-value counts: the exact binomial tail, which takes episodes as
independent, and a one-sided t-test over scenes (cluster-robust; Cameron and Miller 2015, section II), which takes only
scenes as independent. The confidence interval is the wider of Clopper and Pearson's and the one over scenes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats

__all__ = ["CONFIDENCE", "binomial_tail", "holm", "interval", "p_by_scenes", "p_uniform"]

CONFIDENCE: Final = 0.95

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


def binomial_tail(hits: int, trials: Mapping[float, int]) -> float:
    """Return the probability that at least `hits` guesses are right. `trials` maps each probability p to the number of
    guesses that are right with probability p.

    For several values of p the distributions are convolved; the error is below 1e-12.
    """
    if hits <= 0:
        return 1.0
    if len(trials) == 1:
        ((chance, n),) = trials.items()
        return float(stats.binom.sf(hits - 1, n, chance))
    total = np.ones(1)
    for chance, n in sorted(trials.items()):
        total = signal.fftconvolve(total, stats.binom.pmf(np.arange(n + 1), n, chance))
    return float(np.clip(total[hits:].sum(), 0.0, 1.0))


def p_by_scenes(excess: F64, scenes: NDArray[np.int64]) -> float:
    """Return the one-sided p-value of a t-test over scenes. The test asks whether the sums of `excess` in the scenes
    are above 0 on average.

    excess : right − chance of each episode

    Returns 0 if every scene has the same positive sum, or if there are fewer than two scenes (then no test is possible,
    and the binomial test decides).
    """
    sums = np.bincount(scenes, weights=excess)
    sums = sums[np.bincount(scenes) > 0]
    if len(sums) < 2:
        return 0.0
    mean, error = float(sums.mean()), float(sums.std(ddof=1)) / len(sums) ** 0.5
    if error < 1e-12:
        return 0.0 if mean > 1e-12 else 1.0
    return float(stats.t.sf(mean / error, len(sums) - 1))


def interval(right: Bools, scenes: NDArray[np.int64], confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the bounds (low, high) of the confidence interval of a guesser's accuracy. `right` says which guesses were
    right, `scenes` the scene of each.
    """
    n, hits = len(right), int(right.sum())
    tail = (1.0 - confidence) / 2.0
    low = float(stats.beta.ppf(tail, hits, n - hits + 1)) if hits else 0.0
    high = float(stats.beta.isf(tail, hits + 1, n - hits)) if hits < n else 1.0
    share = hits / n
    counts = np.bincount(scenes)
    residuals = (np.bincount(scenes, weights=right) - share * counts)[counts > 0]
    if len(residuals) < 2:
        return low, high
    k = len(residuals)
    error = float(np.sqrt((residuals**2).sum() * k / (k - 1))) / n
    reach = float(stats.t.isf(tail, k - 1)) * error
    return max(0.0, min(low, share - reach)), min(1.0, max(high, share + reach))


def p_uniform(counts: Sequence[int]) -> float:
    """Return the p-value of Pearson's χ² test: how likely counts at least as uneven as `counts` are if all classes are
    equally probable.
    """
    return float(stats.chisquare(counts).pvalue)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return the p-values after Holm's correction (1979), in the same order. Rejecting all hypotheses whose corrected
    p-value is below α keeps the family-wise error at most α.
    """
    order = np.argsort(p_values, kind="stable")
    corrected = np.empty(len(order))
    factors = np.arange(len(order), 0, -1)
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(np.asarray(p_values, dtype=np.float64)[order] * factors))
    found: list[float] = corrected.tolist()
    return found
