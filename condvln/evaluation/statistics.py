"""Confidence intervals and tests. Episodes of one scene share its floor plan, so whole scenes are resampled.

Cluster bootstrap as in Cameron, Gelbach and Miller (2008), percentile intervals; paired permutation of the two agents'
labels, a scene at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np
import numpy.typing as npt

__all__ = ["CONFIDENCE", "REPLICATES", "Estimate", "PairedTest", "estimate", "paired_test"]

CONFIDENCE: Final = 0.95
REPLICATES: Final = 10_000
"""Draws of a bootstrap or a permutation test: the third digit of a p-value no longer moves."""

_EXACT_SCENES: Final = 13
"""Up to this many scenes all sign patterns are tried (8,192) in place of random ones."""

Values = npt.NDArray[np.float64]
Labels = npt.NDArray[Any] | Sequence[Any]


@dataclass(frozen=True)
class Estimate:
    """A mean with its interval.

    Attributes
    ----------
    mean : NaN where nothing is defined
    low, high : bounds of the interval; NaN with fewer than two scenes, where nothing can be said
    n : episodes that count; total : episodes asked about, those left out included
    scenes : clusters among those that count
    """

    mean: float
    low: float
    high: float
    n: int
    total: int
    scenes: int


def estimate(
    values: Values, scenes: Labels, *, seed: int = 0, replicates: int = REPLICATES, confidence: float = CONFIDENCE
) -> Estimate:
    """Mean over the episodes where ``values`` (n,) is defined, interval by drawing whole scenes with replacement."""
    defined = ~np.isnan(values)
    n, total = int(defined.sum()), len(values)
    if n == 0:
        return Estimate(float("nan"), float("nan"), float("nan"), 0, total, 0)
    names, cluster = np.unique(np.asarray(scenes)[defined], return_inverse=True)
    mean = float(values[defined].mean())
    if len(names) < 2:
        return Estimate(mean, float("nan"), float("nan"), n, total, len(names))
    sums = np.bincount(cluster, weights=values[defined])
    counts = np.bincount(cluster).astype(np.float64)
    draws = np.random.default_rng(seed).multinomial(len(names), np.full(len(names), 1 / len(names)), size=replicates)
    means = (draws @ sums) / (draws @ counts)
    tail = (1 - confidence) / 2
    low, high = np.quantile(means, [tail, 1 - tail])
    return Estimate(mean, float(low), float(high), n, total, len(names))


@dataclass(frozen=True)
class PairedTest:
    """Difference of two agents on the episodes that both were judged on.

    Attributes
    ----------
    difference : mean of first − second
    p_value : two-sided; the least it can be is 2 ÷ 2^scenes
    exact : all sign patterns were tried
    """

    difference: float
    p_value: float
    n: int
    scenes: int
    exact: bool


def paired_test(
    first: Values, second: Values, scenes: Labels, *, seed: int = 0, replicates: int = REPLICATES
) -> PairedTest:
    """Do two agents differ? The labels of the agents are swapped scene by scene under the null hypothesis.

    Parameters
    ----------
    first, second : (n,) scores of the same episodes; where either is NaN the episode is left out
    """
    defined = ~(np.isnan(first) | np.isnan(second))
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
    # Sums that differ by rounding alone are equal.
    extreme = int((np.abs(signs @ sums) >= observed - 1e-9 * max(1.0, observed)).sum())
    p_value = extreme / len(signs) if exact else (extreme + 1) / (len(signs) + 1)
    return PairedTest(float(sums.sum()) / n, p_value, n, len(names), exact)
