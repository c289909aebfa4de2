"""How episodes are classed where they are counted and scored: the observability and the horizon as tables name them."""

from __future__ import annotations

from bisect import bisect_right
from typing import Final

__all__ = ["ROUTE_BOUNDS", "WORD_BOUNDS", "observability_class", "route_class", "words_class"]

ROUTE_BOUNDS: Final = (5, 10, 20)
"""Metres by the stops at which a longer class of routes begins; single rooms seldom reach the second."""

WORD_BOUNDS: Final = (40, 80, 120)
"""Words at which a longer class of texts begins."""


def observability_class(observability: str | None, evidence_in_view: bool | None) -> str | None:
    """O0f where all evidence is in the first view, else O0, O1 or O2; None where it is not known."""
    return "O0f" if observability == "O0" and evidence_in_view else observability


def route_class(route_length: float) -> str:
    """Class of a gold route's length in metres: ``05–10 m``; sorted as text, the classes are in order."""
    return f"{_between(route_length, ROUTE_BOUNDS, 2)} m"


def words_class(words: int) -> str:
    """Class of a text's number of words: ``040–079``; sorted as text, the classes are in order."""
    return _between(words, WORD_BOUNDS, 3, last=1)


def _between(value: float, bounds: tuple[int, ...], digits: int, last: int = 0) -> str:
    at = bisect_right(bounds, value)
    low = 0 if at == 0 else bounds[at - 1]
    return f"{low:0{digits}}+" if at == len(bounds) else f"{low:0{digits}}–{bounds[at] - last:0{digits}}"
