"""The predicates that text can use, and their groups."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from schemas.program import BEARINGS, PREDICATE_GROUPS, QUALIFIER_ONLY, Predicate

__all__ = ["ASKED", "COMPASS", "GROUP_OF", "OF_THINGS", "PREDICATES", "PREDICATE_GROUPS", "sayable"]

COMPASS: Final = PREDICATE_GROUPS["compass"]
"""The eight compass predicates, counter-clockwise from east."""

PREDICATES: Final[tuple[Predicate, ...]] = tuple(p for group in PREDICATE_GROUPS.values() for p in group)

OF_THINGS: Final[tuple[Predicate, ...]] = tuple(p for p in PREDICATES if p not in BEARINGS)
"""Predicates that the scene alone decides, independent of the start."""

GROUP_OF: Final[Mapping[Predicate, str]] = {p: group for group, those in PREDICATE_GROUPS.items() for p in those}
"""Group of each predicate."""

ASKED: Final[tuple[Predicate, ...]] = tuple(p for p in OF_THINGS if p not in QUALIFIER_ONLY)
"""Predicates with anchors that a condition may use; it may also use egocentric ones."""


def sayable(directions: str, *, placed: bool = True) -> frozenset[Predicate]:
    """Return the predicates that text may use if ``instructions.directions`` has the value `directions`.

    placed : programs are placed on a navmesh, so that the start can be chosen for egocentric statements
    """
    allowed = {"compass": COMPASS, "egocentric": BEARINGS if placed else ()}.get(directions, ())
    return frozenset(p for p in PREDICATES if p in allowed or p not in (*COMPASS, *BEARINGS))
