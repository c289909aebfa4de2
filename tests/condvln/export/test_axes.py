"""Classes of the axes: exact at their bounds, and in order as text."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.export.splits import OBSERVED, observability_class, oddness_class, route_class, words_class


@pytest.mark.parametrize(
    ("metres", "name"),
    [
        (0.0, "00–05 m"),
        (4.999, "00–05 m"),
        (5.0, "05–10 m"),
        (10.0, "10–20 m"),
        (19.999, "10–20 m"),
        (20.0, "20+ m"),
        (1e6, "20+ m"),
    ],
)
def test_routes(metres: float, name: str) -> None:
    assert route_class(metres) == name


@pytest.mark.parametrize(
    ("words", "name"), [(0, "000–039"), (39, "000–039"), (40, "040–079"), (119, "080–119"), (120, "120+")]
)
def test_words(words: int, name: str) -> None:
    assert words_class(words) == name


@pytest.mark.parametrize(
    ("oddness", "name"), [(None, None), (0, "00"), (1, "01–02"), (2, "01–02"), (5, "03–05"), (10, "06–10"), (11, "11+")]
)
def test_oddness(oddness: int | None, name: str | None) -> None:
    assert oddness_class(oddness) == name


@given(st.floats(0, 100), st.floats(0, 100))
def test_classes_sort_as_what_they_class(one: float, other: float) -> None:
    low, high = sorted((one, other))
    assert route_class(low) <= route_class(high)
    assert words_class(round(2 * low)) <= words_class(round(2 * high))


def test_a_first_view_that_shows_all_is_told_apart() -> None:
    assert [observability_class("O0", seen) for seen in (True, False, None)] == ["O0f", "O0", "O0"]
    assert [observability_class(name, False) for name in ("O1", "O2", None)] == ["O1", "O2", None]
    assert [*OBSERVED] == ["O0f", "O0", "O1", "O2"], "each class has its meaning"
