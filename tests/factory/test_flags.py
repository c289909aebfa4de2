"""Flags are an array of booleans that takes a bit for each."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from factory.flags import Flags


@given(st.lists(st.booleans(), max_size=70), st.booleans(), st.data())
def test_flags_are_an_array_of_booleans(values: list[bool], first: bool, data: st.DataObject) -> None:
    flags = Flags(len(values), first)
    assert flags.count() == len(values) * first
    for row, value in enumerate(values):
        flags[row] = value
    expected = np.array(values, dtype=bool)
    assert [flags[row] for row in range(len(values))] == values
    assert (len(flags), flags.count()) == (len(values), int(expected.sum()))
    if values:
        rows = np.array(data.draw(st.lists(st.integers(0, len(values) - 1), max_size=20)), np.int64)
        value = data.draw(st.booleans())
        flags[rows] = value
        expected[rows] = value
        np.testing.assert_array_equal(flags[rows], expected[rows])
    start, stop = sorted(data.draw(st.tuples(st.integers(0, 80), st.integers(0, 80))))
    np.testing.assert_array_equal(flags[start:stop], expected[start:stop])
    others = Flags(len(values))
    for row in range(0, len(values), 3):
        others[row] = True
    assert [*flags.both(others)] == [row for row in range(0, len(values), 3) if expected[row]]
    flags.without(others)
    expected[::3] = False
    np.testing.assert_array_equal(flags[:], expected)
    assert flags.count() == expected.sum()
