"""Faults in what text says of left, right, ahead and behind: a bearing turned, a truth flipped, another heading."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from mutation import Document, Files, World, pick

from condvln.verify.standpoint import BEARINGS
from condvln.verify.words import words

__all__ = ["MUTATORS_OF_BEARINGS"]

OPPOSITE = {"left": "right", "right": "left", "ahead": "behind", "behind": "ahead"}

MUTATORS_OF_BEARINGS: dict[str, Callable[[Files, np.random.Generator, World], bool]] = {}
"""They apply to texts that say bearings only, and so are no part of all mutators."""


def mutator(function: Any) -> Any:
    MUTATORS_OF_BEARINGS[function.__name__] = function
    return function


def _bearings(named: list[Document]) -> list[Document]:
    return [one for one in named if one["qualifier"] and one["qualifier"]["predicate"] in BEARINGS]


def _stops(files: Files) -> list[Document]:
    return _bearings([move for leaf in files.leaves for move in leaf["moves"]])


@mutator
def turn_a_condition(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A true condition asks for the opposite direction, and is still said to be true."""
    found = [one for one in _bearings(files.conditions) if one["truth"]]
    if not found:
        return False
    one = pick(rng, found)
    one["qualifier"]["predicate"] = OPPOSITE[one["qualifier"]["predicate"]]
    files.word()
    return True


@mutator
def turn_a_stop(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A stop is said to lie in another direction than it does."""
    found = _stops(files)
    if not found:
        return False
    one = pick(rng, found)
    one["qualifier"]["predicate"] = pick(rng, set(BEARINGS) - {one["qualifier"]["predicate"]})
    files.word()
    return True


@mutator
def flip_the_truth_of_a_bearing(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A condition is said to have the other truth, and the gold leaf follows."""
    found = _bearings(files.conditions)
    if not found:
        return False
    one = pick(rng, found)
    one["truth"] = not one["truth"]
    meant = words().meant_by(one["label"])
    here = [o for o in world.scene.objects if o.room_id == one["room"]["room_id"] and o.label in meant]
    one["witnesses"] = [here[0].object_id] if one["truth"] else []
    files.follow_truths()
    return True


@mutator
def turn_the_start(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The agent faces another way by a quarter or a half turn, so that nothing lies where it is said to lie."""
    if not any(one["truth"] for one in _bearings(files.conditions)) and not _stops(files):
        return False
    y, w = files.manifest["start_rotation"][1], files.manifest["start_rotation"][3]
    yaw = 2.0 * math.atan2(y, w) + math.pi / 2 * pick(rng, (1, 2, 3))
    files.manifest["start_rotation"] = [0.0, math.sin(yaw / 2), 0.0, math.cos(yaw / 2)]
    files.record["start_rotation"] = files.manifest["start_rotation"]
    return True


@mutator
def start_in_another_room(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The start is the goal of a leaf in another room."""
    named = [*_bearings(files.conditions), *_stops(files)]
    rooms = {one["room"]["room_id"] for one in named}
    ways = [
        leaf["goals"][0]
        for leaf, said in zip(files.manifest["leaves"], files.leaves, strict=True)
        if said["moves"][-1]["room"]["room_id"] not in rooms
    ]
    if not named or not ways:
        return False
    files.manifest["start_position"] = files.record["start_position"] = pick(rng, ways)
    return True
