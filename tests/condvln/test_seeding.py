"""Random choices: few draws are read from SHAKE-256, in their order, however many are taken at a time."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from condvln.seeding import FEW, FewDraws


def words(count: int) -> list[float]:
    """The definition: the highest 53 of each 64 bits, lowest byte first."""
    digest = hashlib.shake_256(b"7\x1ffew\x1fscene").digest(8 * count)
    return [(int.from_bytes(digest[8 * k : 8 * k + 8], "little") >> 11) / 2**53 for k in range(count)]


@pytest.mark.parametrize("count", [1, FEW, FEW + 1, 3 * FEW])
def test_few_draws_are_the_words_of_a_hash(count: int) -> None:
    draws = FewDraws(7, "few", "scene")
    assert [draws.uniform() for _ in range(count)] == words(count)


@given(st.lists(st.integers(0, 2 * FEW), max_size=6))
def test_arrays_of_draws_continue_each_other(sizes: list[int]) -> None:
    draws = FewDraws(7, "few", "scene")
    assert [x for size in sizes for x in draws.uniforms(size).tolist()] == words(sum(sizes))


def test_single_draws_continue_after_arrays() -> None:
    draws = FewDraws(7, "few", "scene")
    draws.uniforms(3)
    assert draws.uniform() == words(4)[3]
    # One block was taken ahead for single draws.
    np.testing.assert_array_equal(draws.uniforms(2), words(FEW + 5)[FEW + 3 :])
    assert draws.uniform() == words(5)[4]


def test_first_draws_of_many_purposes_are_uniform_and_independent() -> None:
    first, second = np.array([FewDraws(0, "place", k).uniforms(2) for k in range(4000)]).T
    assert stats.kstest(first, "uniform").pvalue > 1e-3
    cells = np.histogram2d(first, second, bins=8, range=[[0, 1], [0, 1]])[0]
    assert stats.chisquare(cells.ravel()).pvalue > 1e-3
