"""The predicates that text can use, and how they read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from schemas.program import BEARINGS, QUALIFIER_ONLY, Predicate

__all__ = ["ASKED", "COMPASS", "GROUP_OF", "OF_THINGS", "PREDICATES", "PREDICATE_GROUPS", "sayable"]

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
    "on": ("on",),
    "under": ("under",),
    "inside": ("in",),
    "near": ("near",),
    "vertical": ("above", "below"),
    "between": ("between",),
    "closest": ("closest to",),
    "compass": COMPASS,
    "bearing": BEARINGS,
    "size": ("bigger", "smaller"),
    "height": ("higher than", "lower than"),
    "far": ("far from",),
}
"""Predicates that read alike, in the order in which text prefers them; named as the keys of ``sampling.predicates``."""

PREDICATES: Final[tuple[Predicate, ...]] = tuple(p for group in PREDICATE_GROUPS.values() for p in group)

OF_THINGS: Final[tuple[Predicate, ...]] = tuple(p for p in PREDICATES if p not in BEARINGS)
"""Predicates that a scene decides, wherever the start is."""

GROUP_OF: Final[Mapping[Predicate, str]] = {p: group for group, those in PREDICATE_GROUPS.items() for p in those}
"""Group of each predicate."""

ASKED: Final[tuple[Predicate, ...]] = tuple(p for p in OF_THINGS if p not in QUALIFIER_ONLY)
"""Predicates of things and their anchors that a condition may ask for; it may ask for bearings too."""


def sayable(directions: str, *, placed: bool = True) -> frozenset[Predicate]:
    """Predicates that text may use under a value of ``instructions.directions``.

    placed : programs are placed on a navmesh, so that the start can be chosen by what is said of it
    """
    allowed = {"compass": COMPASS, "egocentric": BEARINGS if placed else ()}.get(directions, ())
    return frozenset(p for p in PREDICATES if p in allowed or p not in (*COMPASS, *BEARINGS))
