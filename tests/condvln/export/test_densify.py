"""Dense paths: corners kept, spacing held, length unchanged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from condvln.navigation.points import densify, densify_many

coordinates = st.floats(-30, 30, allow_nan=False)
paths = st.integers(1, 8).flatmap(lambda n: hnp.arrays(np.float64, (n, 3), elements=coordinates))


def length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


@given(paths, st.sampled_from([0.1, 0.25, 1.0]))
def test_corners_spacing_and_length(points: np.ndarray, spacing: float) -> None:
    dense = densify(points, spacing)
    steps = np.linalg.norm(np.diff(dense, axis=0), axis=1)
    assert (steps <= spacing * (1 + 1e-5)).all()
    assert length(dense) == pytest.approx(length(points), abs=1e-5)
    distinct = points[np.concatenate((np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-5, [True]))]
    assert all((dense == corner).all(axis=1).any() for corner in distinct)
    assert (dense[-1] == points[-1]).all()


@given(st.lists(paths, max_size=5))
def test_many_is_one_by_one(many: list[np.ndarray]) -> None:
    points = np.concatenate(many) if many else np.zeros((0, 3))
    offsets = np.concatenate(([0], np.cumsum([len(path) for path in many]))).astype(np.int64)
    dense, ends = densify_many(points, offsets)
    assert len(ends) == len(many) + 1
    for index, path in enumerate(many):
        np.testing.assert_array_equal(dense[ends[index] : ends[index + 1]], densify(path))
