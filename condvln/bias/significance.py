"""Significance tests of a guesser's accuracy against chance.

An accuracy above chance may come from luck on single episodes, or from a few scenes in which one lucky guess is
repeated. Each has its own test, and the larger p-value counts: the exact binomial tail, which takes episodes as
independent, and a one-sided t-test over scenes (cluster-robust; Cameron and Miller 2015, section II), which takes only
scenes as independent. The confidence interval is the wider of Clopper and Pearson's and the one over scenes.

The tails come from ``scipy.special``: importing ``scipy.stats`` takes longer than all tests of a small export.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft, special

from condvln.arrays import F64, Bools

__all__ = ["CONFIDENCE", "binomial_tail", "holm", "interval", "p_by_scenes", "p_uniform"]

CONFIDENCE: Final = 0.95
LONG: Final = 500
"""Length from which distributions are convolved by fast Fourier transforms."""


def binomial_tail(hits: int, trials: Mapping[float, int]) -> float:
    """Return the probability that at least `hits` guesses are right. `trials` maps each probability p to the number of
    guesses that are right with probability p.

    For several values of p the distributions are convolved; the error is below 1e-12.
    """
    if hits <= 0:
        return 1.0
    if hits > sum(trials.values()):
        return 0.0
    if len(trials) == 1:
        ((chance, n),) = trials.items()
        return float(special.bdtrc(hits - 1, n, chance))
    total = _hits(tuple(sorted(trials.items())))
    return float(np.clip(total[hits:].sum(), 0.0, 1.0))


@lru_cache(maxsize=64)
def _hits(trials: tuple[tuple[float, int], ...]) -> F64:
    """Return the probability of 0, 1, 2, … right guesses. `trials` has pairs (p, number of guesses that are right with
    probability p).
    """
    total = np.ones(1)
    for chance, n in trials:
        total = _convolved(total, _binomial(n, chance))
    return total


def _binomial(n: int, chance: float) -> F64:
    """Return the probabilities of 0, 1, … n successes. They are computed from the likeliest number of successes
    outwards, each from its neighbour's probability and their ratio, so that nothing overflows and the largest
    probabilities are exact.
    """
    mode = min(n, int((n + 1) * chance))
    odds = chance / (1.0 - chance)
    above = np.arange(mode + 1, n + 1)
    below = np.arange(mode, 0, -1)
    up = np.cumprod((n - above + 1) / above * odds)
    down = np.cumprod(below / (n - below + 1) / odds)
    found = np.concatenate([down[::-1], [1.0], up])
    found /= found.sum()
    return found


def _convolved(one: F64, other: F64) -> F64:
    """Return the distribution of the sum of two independent numbers that have the distributions `one` and `other`. If
    both arrays are long, it is computed by fast Fourier transforms.
    """
    if min(len(one), len(other)) < LONG:
        return np.convolve(one, other)
    length = len(one) + len(other) - 1
    size = fft.next_fast_len(length, real=True)
    found: F64 = fft.irfft(fft.rfft(one, size) * fft.rfft(other, size), size)[:length]
    return found


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
    return float(special.stdtr(len(sums) - 1, -mean / error))


def interval(right: Bools, scenes: NDArray[np.int64], confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the bounds (low, high) of the confidence interval of a guesser's accuracy. `right` says which guesses were
    right, `scenes` the scene of each.
    """
    n, hits = len(right), int(right.sum())
    tail = (1.0 - confidence) / 2.0
    low = float(special.betaincinv(hits, n - hits + 1, tail)) if hits else 0.0
    high = float(special.betainccinv(hits + 1, n - hits, tail)) if hits < n else 1.0
    share = hits / n
    counts = np.bincount(scenes)
    residuals = (np.bincount(scenes, weights=right) - share * counts)[counts > 0]
    if len(residuals) < 2:
        return low, high
    k = len(residuals)
    error = float(np.sqrt((residuals**2).sum() * k / (k - 1))) / n
    reach = -float(special.stdtrit(k - 1, tail)) * error
    return max(0.0, min(low, share - reach)), min(1.0, max(high, share + reach))


def p_uniform(counts: Sequence[int]) -> float:
    """Return the p-value of Pearson's χ² test: how likely counts at least as uneven as `counts` are if all classes are
    equally probable.
    """
    even = sum(counts) / len(counts)
    return float(special.chdtrc(len(counts) - 1, sum((count - even) ** 2 for count in counts) / even))


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
