"""Tails, intervals and corrections against brute force and other implementations."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from condvln.bias.significance import binomial_tail, holm, interval, p_by_scenes, p_uniform


@given(st.integers(0, 12), st.integers(0, 5), st.integers(0, 4), st.integers(0, 3))
def test_tails_of_mixed_chances_are_those_of_all_outcomes(hits: int, halves: int, thirds: int, quarters: int) -> None:
    trials = {p: n for p, n in ((1 / 2, halves), (1 / 3, thirds), (1 / 4, quarters)) if n}
    if not trials:
        return
    chances = [p for p, n in trials.items() for _ in range(n)]
    exact = sum(
        np.prod([p if right else 1 - p for p, right in zip(chances, outcome, strict=True)])
        for outcome in product((0, 1), repeat=len(chances))
        if sum(outcome) >= hits
    )
    assert binomial_tail(hits, trials) == pytest.approx(float(exact), abs=1e-12)


def test_large_tails_keep_twelve_digits() -> None:
    whole = binomial_tail(10_300, {0.5: 20_000, 0.25: 1})
    parts = 0.25 * stats.binom.sf(10_298, 20_000, 0.5) + 0.75 * stats.binom.sf(10_299, 20_000, 0.5)
    assert whole == pytest.approx(float(parts), abs=1e-12)


def test_scenes_are_tested_as_the_t_test_tests_them() -> None:
    rng = np.random.default_rng(0)
    scenes = np.sort(rng.integers(9, size=200))
    excess = rng.normal(0.05, 1.0, 200)
    sums = np.array([excess[scenes == k].sum() for k in range(9)])
    expected = stats.ttest_1samp(sums, 0.0, alternative="greater").pvalue
    assert p_by_scenes(excess, scenes) == pytest.approx(float(expected))
    assert p_by_scenes(np.full(4, 0.5), np.array([0, 0, 3, 3])) == 0.0
    assert p_by_scenes(np.full(4, -0.5), np.array([0, 0, 3, 3])) == 1.0
    assert p_by_scenes(np.full(4, 0.5), np.zeros(4, dtype=np.int64)) == 0.0


def test_intervals_widen_where_scenes_disagree() -> None:
    right = np.arange(100) % 2 == 0
    alike = interval(right, np.arange(100) // 10)
    exact = stats.binomtest(50, 100).proportion_ci(0.95, "exact")
    assert alike == pytest.approx((exact.low, exact.high))
    apart = interval(np.repeat([True, False], 50), np.arange(100) // 10)
    assert apart[0] < alike[0]
    assert apart[1] > alike[1]
    assert interval(np.ones(20, dtype=bool), np.arange(20))[1] == 1.0
    assert interval(np.zeros(20, dtype=bool), np.arange(20))[0] == 0.0


def test_holm_is_holm() -> None:
    # Sorted: 0.005·4, 0.01·3, 0.03·2, 0.04·1, each at least the one before.
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([]) == []
    assert holm([0.9, 0.8]) == [1.0, 1.0]


@given(st.lists(st.floats(0, 1), min_size=1, max_size=30))
def test_holm_keeps_order_and_never_lowers(p_values: list[float]) -> None:
    corrected = holm(p_values)
    assert all(c >= p for c, p in zip(corrected, p_values, strict=True))
    order = np.argsort(p_values, kind="stable")
    assert (np.diff(np.array(corrected)[order]) >= 0).all()


def test_uniform() -> None:
    assert p_uniform([50, 50, 50, 50]) == 1.0
    assert p_uniform([120, 80]) == pytest.approx(float(stats.chi2.sf(8.0, 1)))
