"""Measures against their plain definitions, other people's code, and worked values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fastdtw import fastdtw
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from condvln.evaluation.measures import cls, dtw, dtw_of_costs, ndtw, path_length, spl, without_repeats
from tests.condvln.evaluation import plain

# Whole and half metres too, so that repeats and ties are common.
# To a micrometre: moving a path by metres must not merge points that lay a rounding apart.
micrometres = st.floats(-8, 8, allow_nan=False).map(lambda value: round(value, 6))
coordinate = st.one_of(micrometres, st.integers(-4, 4).map(lambda n: n / 2))
paths = st.integers(1, 12).flatmap(lambda n: hnp.arrays(np.float64, (n, 3), elements=coordinate))


def listed(path: np.ndarray) -> list[tuple[float, ...]]:
    return [tuple(point) for point in path.tolist()]


def check_all(path: np.ndarray, reference: np.ndarray, tau: float) -> None:
    p, r = listed(path), listed(reference)
    assert path_length(path) == pytest.approx(plain.length(p), abs=1e-9)
    assert ndtw(path, reference, tau) == pytest.approx(plain.ndtw(p, r, tau), rel=1e-9)
    assert cls(path, reference, tau) == pytest.approx(plain.cls(p, r, tau), rel=1e-9)
    assert listed(without_repeats(path)) == plain.no_repeats(p)


@pytest.mark.costly
@given(paths, paths, st.sampled_from([0.5, 1.0, 3.0]))
@settings(max_examples=300)
def test_equal_the_plain_definitions(path: np.ndarray, reference: np.ndarray, tau: float) -> None:
    check_all(path, reference, tau)


long_paths = st.integers(1, 60).flatmap(lambda n: hnp.arrays(np.float64, (n, 3), elements=coordinate))


@pytest.mark.costly
@given(long_paths, long_paths)
@settings(max_examples=60)
def test_fast_mode_is_as_vlnce_calls_the_package(path: np.ndarray, reference: np.ndarray) -> None:
    theirs = fastdtw(without_repeats(path), reference, dist=lambda a, b: float(np.linalg.norm(a - b)))[0]
    ours = ndtw(path, reference, fast=True)
    assert ours == pytest.approx(math.exp(-theirs / (len(reference) * 3.0)), rel=1e-9)
    assert ours <= ndtw(path, reference) * (1 + 1e-12)


@given(paths, paths)
def test_laws(path: np.ndarray, reference: np.ndarray) -> None:
    value = ndtw(path, reference)
    assert 0 <= value <= 1
    assert 0 <= cls(path, reference) <= 1 + 1e-12
    assert ndtw(reference, without_repeats(reference)) == 1
    turned = np.stack([path[:, 2], path[:, 1], -path[:, 0]], axis=1) + 3.0
    turned_reference = np.stack([reference[:, 2], reference[:, 1], -reference[:, 0]], axis=1) + 3.0
    assert ndtw(turned, turned_reference) == pytest.approx(value, rel=1e-9)
    costs = np.linalg.norm(path[:, None] - reference[None], axis=2)
    assert dtw_of_costs(costs) == pytest.approx(dtw(path, reference), abs=1e-9)
    assert dtw_of_costs(costs.T.copy()) == pytest.approx(dtw(path, reference), abs=1e-9)


@pytest.mark.parametrize(
    ("success", "shortest", "walked", "value"),
    [
        (True, 10.0, 10.0, 1.0),
        (True, 10.0, 20.0, 0.5),
        (True, 10.0, 5.0, 1.0),
        (False, 10.0, 10.0, 0.0),
        (True, 0.0, 0.0, 1.0),
        (True, 0.0, 3.0, 0.0),
        (True, math.inf, 3.0, 0.0),
        (True, math.nan, 3.0, 0.0),
    ],
)
def test_spl_has_no_undefined_corner(success: bool, shortest: float, walked: float, value: float) -> None:
    assert spl(success, shortest, walked) == value
