"""The classes by which episodes are counted and scored: observability, route length and text length."""

from __future__ import annotations

from bisect import bisect_right
from functools import cache
from itertools import pairwise
from typing import Final

__all__ = ["ROUTE_BOUNDS", "WORD_BOUNDS", "observability_class", "route_class", "words_class"]

ROUTE_BOUNDS: Final = (5, 10, 20)
"""Route lengths in metres at which the next class begins; single rooms seldom reach the second."""

WORD_BOUNDS: Final = (40, 80, 120)
"""Numbers of words at which the next class begins."""


def observability_class(observability: str | None, evidence_in_view: bool | None) -> str | None:
    """Return O0f if all evidence is in the first view, else O0, O1 or O2; None if unknown."""
    return "O0f" if observability == "O0" and evidence_in_view else observability


def route_class(route_length: float) -> str:
    """Return the class of a gold route's length in metres, such as ``05–10 m``; sorting classes as text keeps their
    order.
    """
    return f"{_between(route_length, ROUTE_BOUNDS, 2)} m"


def words_class(words: int) -> str:
    """Return the class of a text's number of words, such as ``040–079``; sorting classes as text keeps their order."""
    return _between(words, WORD_BOUNDS, 3, last=1)


def _between(value: float, bounds: tuple[int, ...], digits: int, last: int = 0) -> str:
    return _classes(bounds, digits, last)[bisect_right(bounds, value)]


@cache
def _classes(bounds: tuple[int, ...], digits: int, last: int) -> list[str]:
    """Return the names of all classes that begin at 0 and at `bounds`."""
    named = [f"{low:0{digits}}–{high - last:0{digits}}" for low, high in pairwise((0, *bounds))]
    return [*named, f"{bounds[-1]:0{digits}}+"]
