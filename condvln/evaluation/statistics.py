"""Confidence intervals and significance tests. Episodes of a scene share its floor plan, so whole scenes are resampled.

Intervals: cluster bootstrap as in Cameron, Gelbach and Miller (2008), percentiles. Comparison of two agents: paired
permutation of their labels, scene by scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any, Final

import numpy as np
import numpy.typing as npt

__all__ = ["CONFIDENCE", "REPLICATES", "Estimate", "PairedTest", "estimate", "paired_test"]

CONFIDENCE: Final = 0.95
REPLICATES: Final = 10_000
"""Number of bootstrap or permutation draws: the third digit of a p-value no longer changes."""

_KEPT_SCENES: Final = 64
"""Up to this many scenes, draws are kept: 5 MB at most for a number of scenes, of which eight are kept."""

_EXACT_SCENES: Final = 13
"""Up to this many scenes, all sign patterns are enumerated (8,192) instead of drawn."""

Values = npt.NDArray[np.float64]
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
    values: Values, scenes: Labels, *, seed: int = 0, replicates: int = REPLICATES, confidence: float = CONFIDENCE
) -> Estimate:
    """Return the mean over the episodes where ``values`` (n,) is defined, with a bootstrap interval over scenes."""
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
    draws = (_kept_draws if len(names) <= _KEPT_SCENES else _drawn)(seed, len(names), replicates)
    means = (draws @ sums) / (draws @ counts)
    tail = (1 - confidence) / 2
    low, high = np.quantile(means, [tail, 1 - tail])
    return Estimate(mean, float(low), float(high), n, total, len(names))


def _drawn(seed: int, scenes: int, replicates: int) -> Values:
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


def paired_test(
    first: Values, second: Values, scenes: Labels, *, seed: int = 0, replicates: int = REPLICATES
) -> PairedTest:
    """Test whether the scores of two agents differ. Under the null hypothesis, the scores of the two agents can be
    swapped in any scene.

    Parameters
    ----------
    first, second : (n,) scores of the same episodes; an episode is left out if either is NaN
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
    # Sums that differ only by rounding count as equal.
    extreme = int((np.abs(signs @ sums) >= observed - 1e-9 * max(1.0, observed)).sum())
    p_value = extreme / len(signs) if exact else (extreme + 1) / (len(signs) + 1)
    return PairedTest(float(sums.sum()) / n, p_value, n, len(names), exact)
