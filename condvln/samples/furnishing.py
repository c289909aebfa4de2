"""Furnish a room by the recipe of its type (``recipes.yaml``)."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from typing import Any, Final

import yaml

from condvln.samples.catalogue import VARIANTS, Kind, catalogue
from condvln.samples.room_space import Piece, RoomSpace
from condvln.samples.spots import SPOTS, row_of

__all__ = ["MAX_OBJECTS", "MIN_OBJECTS", "ROW", "Recipe", "Step", "furnish", "recipes"]

MIN_OBJECTS: Final = 5
MAX_OBJECTS: Final = 12
"""Bounds of the number of objects in a room; each room draws its number, slightly above the lower bound."""

FILLER: Final = "filler"
"""The recipe that fills up rooms with too few objects."""


@dataclass(frozen=True, slots=True)
class Step:
    """One line of a recipe; see the head of ``recipes.yaml``."""

    kinds: tuple[str, ...]
    at: str
    anchor: tuple[str, ...] = ()
    count: tuple[int, int] = (1, 1)
    chance: float = 1.0
    needed: bool = False
    unless: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Recipe:
    """The steps that furnish a room of one type: those of `first` in the given order, then those of `then` in random
    order.
    """

    first: tuple[Step, ...]
    then: tuple[Step, ...]


ROW: Final = "row"
"""Value of `at` for a step whose kinds form one line along a wall."""


def furnish(rng: random.Random, room: RoomSpace) -> bool:
    """Fill `room` in place with 5 to 12 pieces; return False if the pieces required for its type do not fit."""
    recipe = recipes()[room.label]
    wanted = rng.randint(MIN_OBJECTS + 2, MAX_OBJECTS)
    for step in recipe.first:
        if not _follow(rng, room, step, MAX_OBJECTS) and step.needed:
            return False
    for step in rng.sample(recipe.then, len(recipe.then)):
        _follow(rng, room, step, wanted)
    filler = recipes()[FILLER].then
    for step in rng.sample(filler, len(filler)):
        _follow(rng, room, step, MIN_OBJECTS)
    return len(room.pieces) >= MIN_OBJECTS


def _follow(rng: random.Random, room: RoomSpace, step: Step, most: int) -> bool:
    """Carry out one step while the room holds fewer than `most` pieces. Return True if the step placed a piece, or if
    it was skipped as its recipe allows.
    """
    # All random draws are made first, so that a step depends as little as possible on earlier steps.
    used, count = rng.random() < step.chance, rng.randint(*step.count)
    if step.unless and room.of_kind(step.unless):
        return True
    if not used:
        return not step.needed
    if step.at == ROW:
        return _place_row(rng, room, step)
    anchors: list[int | None] = list(room.of_kind(step.anchor)) if step.anchor else [None]
    if not anchors:
        return False
    rng.shuffle(anchors)
    placed = 0
    variant = rng.randrange(VARIANTS)
    kind = catalogue()[rng.choice(step.kinds)]
    for number in range(count):
        if len(room.pieces) >= most:
            break
        placed += any(
            _place(rng, room, step.at, kind, (variant + smaller) % VARIANTS, anchors[number % len(anchors)])
            for smaller in range(VARIANTS if step.needed else 1)
        )
    return placed > 0


def _place(rng: random.Random, room: RoomSpace, at: str, kind: Kind, variant: int, anchor: int | None) -> bool:
    target = None if anchor is None else room.pieces[anchor]
    parent = anchor if at.startswith("on") else None
    candidates = SPOTS[at](rng, room, kind, variant, target)
    return any(room.add(replace(candidate, parent=parent)) for candidate in candidates)


def _place_row(rng: random.Random, room: RoomSpace, step: Step) -> bool:
    line = [(catalogue()[kind], rng.randrange(VARIANTS)) for kind in step.kinds]
    while len(line) > 1:
        # Shuffled per length, so that the sink is not always at the same end.
        for pieces in row_of(rng, room, rng.sample(line, len(line))):
            before: list[Piece] = list(room.pieces)
            if all(room.add(piece) for piece in pieces):
                return True
            room.restore(before)
        line.pop()
    return False


@cache
def recipes() -> dict[str, Recipe]:
    """Return all recipes by name: one for each room type, and the filler recipe."""
    text = resources.files("condvln.samples").joinpath("recipes.yaml").read_text(encoding="utf-8")
    return {
        label: Recipe(*(tuple(_step(line) for line in recipe.get(part, ())) for part in ("first", "then")))
        for label, recipe in yaml.safe_load(text).items()
    }


def _step(line: dict[str, Any]) -> Step:
    kinds = line.get("row") or line["kind"]
    return Step(
        kinds=(kinds,) if isinstance(kinds, str) else tuple(kinds),
        at=ROW if "row" in line else line["at"],
        anchor=tuple(line.get("anchor", ())),
        count=tuple(line.get("count", (1, 1))),
        chance=line.get("chance", 1.0),
        needed=line.get("needed", False),
        unless=tuple(line.get("unless", ())),
    )
