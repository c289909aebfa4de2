"""Guessers without learning: each picks a leaf by its position in the tree, its position in the text, or its
distance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, lru_cache
from typing import Final

from condvln.bias.guesser_view import GuesserView
from condvln.labels import vocabulary
from schemas.program import SHAPES, Category

__all__ = ["FIXED", "Guesser"]

Guesser = Callable[[GuesserView], int]


@cache
def _constant(category: Category, truth: bool) -> int:
    branches = SHAPES[category].branches
    at = 0
    while at >= 0:
        at = branches[at].then if truth else branches[at].otherwise
    return -1 - at


def always_then(view: GuesserView) -> int:
    """Return the leaf that is reached if every condition is true."""
    return _constant(view.category, True)


def always_else(view: GuesserView) -> int:
    """Return the leaf that is reached if every condition is false."""
    return _constant(view.category, False)


def last_named(view: GuesserView) -> int:
    """Return the leaf whose goal the text names last. A text may give the else part first."""
    text = view.text.lower()
    places = [text.rfind(_noun(leaf.labels[-1])) for leaf in view.leaves]
    return places.index(max(places))


@lru_cache(maxsize=4096)
def _noun(label: str) -> str:
    return vocabulary.entry(label).noun if vocabulary.fit_for_text(label) else label


def nearest(view: GuesserView) -> int:
    """Return the leaf whose goal is nearest to the start by geodesic distance."""
    return _least([leaf.distance for leaf in view.leaves])


def farthest(view: GuesserView) -> int:
    """Return the leaf whose goal is farthest from the start by geodesic distance."""
    return _least([-leaf.distance for leaf in view.leaves])


def longest_route(view: GuesserView) -> int:
    """Return the leaf whose route through all its stops is longest."""
    return _least([-leaf.route for leaf in view.leaves])


def _least(values: list[float]) -> int:
    return values.index(min(values))


FIXED: Final[Mapping[str, Guesser]] = {
    "always then": always_then,
    "always else": always_else,
    "last leaf": last_named,
    "nearest target": nearest,
    "farthest target": farthest,
    "longest route": longest_route,
}
"""Guessers without learning, by their names in reports."""
