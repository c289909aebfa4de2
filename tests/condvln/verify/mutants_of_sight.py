"""Faults in what is told to be seen from where."""

from __future__ import annotations

import numpy as np
from mutation import MUTATORS, Document, Files, Mutator, World, mutator, pick

LEVELS = ("O0", "O1", "O2")


def _tell(files: Files, place: Document, level: str, in_view: bool) -> None:
    """Another level and view of one condition's evidence, and the row's as they follow."""
    place["observability"], place["in_view"] = level, in_view
    evidence = files.manifest["evidence"]
    told = {
        "observability": max(one["observability"] for one in evidence),
        "evidence_in_view": all(one["in_view"] for one in evidence),
    }
    files.manifest.update(told)
    files.record["info"].update(told)


def _told_as(level: str) -> Mutator:
    def mutate(files: Files, rng: np.random.Generator, world: World) -> bool:
        others = [one for one in files.manifest["evidence"] if one["observability"] != level]
        if not others:
            return False
        _tell(files, pick(rng, others), level, False)
        return True

    return mutate


for _name, _level in zip(("seen_at_once", "seen_on_the_way", "seen_by_a_detour"), LEVELS, strict=True):
    MUTATORS[_name] = _told_as(_level)


@mutator
def another_first_view(files: Files, rng: np.random.Generator, world: World) -> bool:
    from_start = [one for one in files.manifest["evidence"] if one["observability"] == "O0"]
    if not from_start:
        return False
    place = pick(rng, from_start)
    _tell(files, place, "O0", not place["in_view"])
    return True


@mutator
def seen_at_once_and_ahead(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The easiest cell claimed for what is in none of its views."""
    ahead = [one for one in files.manifest["evidence"] if not one["in_view"]]
    if not ahead:
        return False
    _tell(files, pick(rng, ahead), "O0", True)
    return True


@mutator
def other_surfaces(files: Files, rng: np.random.Generator, world: World) -> bool:
    among_boxes = not files.manifest["observability_approximate"]
    files.manifest["observability_approximate"] = among_boxes
    files.record["info"]["observability_approximate"] = among_boxes
    return True


def _appears(factor: float) -> Mutator:
    """Evidence that appears so many times as large; a floor gets an angle."""

    def mutate(files: Files, rng: np.random.Generator, world: World) -> bool:
        place = pick(rng, files.manifest["evidence"])
        degrees = place["degrees"]
        place["degrees"] = 3.0 if degrees is None else round(degrees * factor, 2)
        return True

    return mutate


for _name, _factor in (("a_smaller_angle", 0.8), ("a_larger_angle", 1.25)):
    MUTATORS[_name] = _appears(_factor)


@mutator
def no_angle(files: Files, rng: np.random.Generator, world: World) -> bool:
    some = [one for one in files.manifest["evidence"] if one["degrees"] is not None]
    if not some:
        return False
    pick(rng, some)["degrees"] = None
    return True
