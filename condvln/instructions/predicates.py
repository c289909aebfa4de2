"""The predicates that text can use, and how they read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from schemas.program import Predicate

__all__ = ["COMPASS", "PREDICATES", "PREDICATE_GROUPS"]

COMPASS: Final[tuple[Predicate, ...]] = (
    "east of",
    "north-east of",
    "north of",
    "north-west of",
    "west of",
    "south-west of",
    "south of",
    "south-east of",
)
"""The eight compass predicates, counter-clockwise from east."""

PREDICATE_GROUPS: Final[Mapping[str, tuple[Predicate, ...]]] = {
    "near": ("near",),
    "vertical": ("above", "below"),
    "compass": COMPASS,
    "height": ("higher than", "lower than"),
    "far": ("far from",),
}
"""Predicates that read alike, in the order in which text prefers them; named as the keys of ``sampling.predicates``."""

PREDICATES: Final[tuple[Predicate, ...]] = tuple(p for group in PREDICATE_GROUPS.values() for p in group)
