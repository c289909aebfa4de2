"""Numbers come back in order, however few of them are in memory at once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factory import sorting
from factory.sorting import SortedNumbers

numbers = st.integers(0, 9) | st.integers(0, 2**64 - 1) | st.sampled_from([0, 2**64 - 1])


@given(st.lists(st.lists(numbers, max_size=30), max_size=12), st.integers(1, 50))
def test_numbers_come_back_in_order(parts: list[list[int]], at_once: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sorting, "SORTED_AT_ONCE", at_once)
        found = SortedNumbers()
        for part in parts:
            found.add(np.array(part, np.uint64))
        assert [number for piece in found for number in piece.tolist()] == sorted(n for part in parts for n in part)


def test_pieces_are_bounded_however_many_numbers_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sorting, "SORTED_AT_ONCE", 64)
    random = np.random.default_rng(5)
    for count in (100, 1000, 10_000):
        found = SortedNumbers()
        for _ in range(count // 10):
            found.add(random.integers(0, 2**64 - 1, 10, np.uint64))
        assert max(len(piece) for piece in found) <= max(64, count // 64 + 1)
