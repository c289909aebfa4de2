"""Intervals and tests: closed forms, coverage, exact enumeration."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.evaluation.aggregate import estimate, paired_test


def test_mean_counts_and_exclusions() -> None:
    found = estimate(np.array([1.0, 0.0, np.nan, 1.0]), ["a", "a", "b", "c"])
    assert (found.mean, found.n, found.total, found.scenes) == (pytest.approx(2 / 3), 3, 4, 2)
    nothing = estimate(np.array([np.nan]), ["a"])
    assert (nothing.n, nothing.total) == (0, 1)
    assert math.isnan(nothing.mean)
    one = estimate(np.array([1.0, 0.0]), ["a", "a"])
    assert one.mean == 0.5
    assert math.isnan(one.low)


def test_equal_scenes_give_a_point() -> None:
    found = estimate(np.array([1.0, 0.0] * 8), np.repeat(np.arange(8), 2))
    assert (found.low, found.high) == (0.5, 0.5)


def test_the_interval_is_that_of_scenes_not_of_episodes() -> None:
    rng = np.random.default_rng(0)
    # Every scene is all right or all wrong: 30 independent facts, however many episodes they hold.
    scenes = np.repeat(np.arange(30), 100)
    values = np.repeat(rng.integers(0, 2, 30).astype(float), 100)
    found = estimate(values, scenes)
    spread = math.sqrt(found.mean * (1 - found.mean) / 30)
    assert found.high - found.low == pytest.approx(2 * 1.96 * spread, rel=0.15)
    shuffled = estimate(values, rng.permutation(scenes))
    assert shuffled.high - shuffled.low < (found.high - found.low) / 4


def test_coverage_of_the_interval() -> None:
    rng = np.random.default_rng(1)
    inside = 0
    for trial in range(200):
        effects = rng.normal(0.5, 0.1, 40)
        sizes = rng.integers(5, 30, 40)
        scenes = np.repeat(np.arange(40), sizes)
        values = (rng.random(len(scenes)) < effects[scenes]).astype(float)
        found = estimate(values, scenes, seed=trial, replicates=800)
        inside += found.low <= 0.5 <= found.high
    assert inside >= 180  # 95 % of 200, less the percentile interval's known shortfall


def test_seeded() -> None:
    values, scenes = np.random.default_rng(2).random(60), np.arange(60) % 9
    assert estimate(values, scenes, seed=3) == estimate(values, scenes, seed=3)
    assert estimate(values, scenes, seed=3) != estimate(values, scenes, seed=4)
    assert estimate(values, [f"scene {s}" for s in scenes], seed=3).low == estimate(values, scenes, seed=3).low


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1), st.integers(0, 5)), min_size=1, max_size=25))
def test_few_scenes_are_enumerated_exactly(rows: list[tuple[float, float, int]]) -> None:
    first, second, scenes = (np.array(column) for column in zip(*rows, strict=True))
    found = paired_test(first, second, scenes)
    sums = {s: sum(a - b for a, b, t in rows if t == s) for s in set(scenes.tolist())}
    observed = abs(sum(sums.values()))
    patterns = list(itertools.product((1, -1), repeat=len(sums)))
    extreme = sum(abs(sum(x * s for x, s in zip(sums.values(), p, strict=True))) >= observed - 1e-9 for p in patterns)
    assert found.exact
    assert found.p_value == pytest.approx(extreme / len(patterns))
    assert found.difference == pytest.approx(np.mean(first - second), abs=1e-12)
    swapped = paired_test(second, first, scenes)
    assert swapped.p_value == pytest.approx(found.p_value)


def test_many_scenes_by_chance_and_null_p_values_are_uniform() -> None:
    rng = np.random.default_rng(5)
    small = 0
    for trial in range(200):
        scenes = np.repeat(np.arange(20), 5)
        first, second = rng.random(100), rng.random(100)
        found = paired_test(first, second, scenes, seed=trial, replicates=500)
        assert not found.exact
        assert 0 < found.p_value <= 1
        small += found.p_value < 0.05
    assert 2 <= small <= 20
    clear = paired_test(np.ones(100), np.zeros(100), np.repeat(np.arange(20), 5), replicates=500)
    assert clear.p_value == pytest.approx(1 / 501)
    assert clear.difference == 1


def test_undefined_pairs_are_left_out() -> None:
    found = paired_test(np.array([1, np.nan, 0.0]), np.array([0, 1, np.nan]), ["a", "b", "c"])
    assert (found.n, found.scenes, found.difference) == (1, 1, 1)
    assert paired_test(np.array([np.nan]), np.array([1.0]), ["a"]).n == 0
