"""Equal points, against NumPy's search for equal rows."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from condvln.formats.distinct_points import distinct_points

few = st.sampled_from([-1.5, -0.0, 0.0, 1e-300, 0.25, 7.0, np.inf])


@given(st.lists(st.tuples(few, few, few), max_size=40))
def test_groups_are_those_of_numpy(rows: list[tuple[float, float, float]]) -> None:
    points = np.array(rows, dtype=np.float64).reshape(-1, 3) + 0.0
    first, group = distinct_points(points)
    expected, index, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(points[first], expected)
    np.testing.assert_array_equal(first, index)
    np.testing.assert_array_equal(group, inverse.reshape(-1))
