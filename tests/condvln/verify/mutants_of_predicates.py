"""Faults in what text says of things: a support said as above, a rival that fits as well, a wrong comparison."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
from mutation import Document, Files, World, mutator

from condvln.relations import COMPASS, PAIR_PREDICATES
from condvln.verify.words import words

Change = tuple[Document, str, list[Document]]
"""A stop or a condition, the predicate that it gets, and the anchors."""
Doubt = Callable[[str, str, str, str], bool]
"""Whether a predicate is in doubt, of room, predicate, thing and anchor."""


def _qualified(files: Files, *predicates: str) -> list[Document]:
    """Conditions and stops with one of the predicates."""
    named = [*files.conditions, *(move for leaf in files.leaves for move in leaf["moves"])]
    return [one for one in named if one["qualifier"] and one["qualifier"]["predicate"] in predicates]


def _stops(files: Files) -> list[Document]:
    return [move for leaf in files.leaves for move in leaf["moves"] if move["qualifier"]]


def _alone(world: World, room: str, beside: str) -> list[Document]:
    """Anchors of a room that are alone in their label, and not of the label `beside`."""
    here = [o for o in world.scene.objects if o.room_id == room and o.label in words().nouns]
    return [
        {"object_id": o.object_id, "label": o.label}
        for o in here
        if len(world.objects_like(room, o.label)) == 1 and o.label not in words().meant_by(beside)
    ]


def _said(files: Files, rng: np.random.Generator, ways: list[Change]) -> bool:
    """Make one of the changes."""
    if not ways:
        return False
    one, predicate, anchors = ways[int(rng.integers(len(ways)))]
    one["qualifier"] = {"predicate": predicate, "anchors": anchors}
    files.word()
    return True


def _supported(files: Files, world: World, predicate: str) -> list[Change]:
    """Stops and true conditions about things that rest on another, which are said to have a predicate to it."""
    named = [*files.conditions, *(move for leaf in files.leaves for move in leaf["moves"])]
    ways = []
    for one in named:
        room = one["room"]["room_id"]
        own = [one["object_id"]] if "object_id" in one else one["witnesses"]
        for anchor in _alone(world, room, one["label"]):
            if any(world.status(room, "on", name, anchor["object_id"]) == 1 for name in own):
                ways.append((one, predicate, [anchor]))
    return ways


@mutator
def say_a_support_as_above(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A stop or a true condition is about a thing that rests on another, and says that it is above it."""
    return _said(files, rng, _supported(files, world, "above"))


@mutator
def say_what_a_rival_fits(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A stop is named by a relation that it has, and that another thing of its label has, or may have, too."""
    ways = []
    for stop in _stops(files):
        room, name = stop["room"]["room_id"], stop["object_id"]
        rivals = [x for x in world.objects_like(room, stop["label"]) if x != name]
        for anchor in _alone(world, room, stop["label"]):
            for predicate in PAIR_PREDICATES:
                own = world.status(room, predicate, name, anchor["object_id"])
                if own == 1 and any(world.status(room, predicate, x, anchor["object_id"]) != -1 for x in rivals):
                    ways.append((stop, predicate, [anchor]))
    return _said(files, rng, ways)


@mutator
def say_between_wrong_anchors(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A stop that is told from its rivals is said to be between two things; it is not, or not clearly."""
    ways = []
    for stop in _stops(files):
        room = stop["room"]["room_id"]
        order = {name: k for k, name in enumerate(world.scene.arrays(room).object_ids)}
        for pair in combinations(_alone(world, room, stop["label"]), 2):
            if stop["object_id"] not in {anchor["object_id"] for anchor in pair}:
                places = np.array([[order[anchor["object_id"]] for anchor in pair]])
                if world.facts[room].between(places)[0][order[stop["object_id"]], 0] != 1:
                    ways.append((stop, "between", list(pair)))
    return _said(files, rng, ways)


@mutator
def turn_a_superlative(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The bigger is said to be the smaller; the closest to one thing is said to be the closest to another."""
    ways: list[Change] = []
    for one in _qualified(files, "bigger", "smaller"):
        other = "smaller" if one["qualifier"]["predicate"] == "bigger" else "bigger"
        ways.append((one, other, []))
    for one in _qualified(files, "closest to"):
        room = one["room"]["room_id"]
        ids = world.scene.arrays(room).object_ids
        order = {name: k for k, name in enumerate(ids)}
        rivals = np.zeros((len(ids), len(ids)), dtype=bool)
        mine = order[one["object_id"]]
        rivals[mine, [order[x] for x in world.objects_like(room, one["label"]) if x != one["object_id"]]] = True
        status = world.facts[room].closest(rivals)[0][mine]
        ways += [
            (one, "closest to", [anchor])
            for anchor in _alone(world, room, one["label"])
            if status[order[anchor["object_id"]]] != 1
        ]
    return _said(files, rng, ways)


@mutator
def find_by_a_small_thing(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A stop is named by something that is carried about, however truly."""
    ways = []
    for stop in _stops(files):
        room, name = stop["room"]["room_id"], stop["object_id"]
        for anchor in _alone(world, room, stop["label"]):
            if anchor["label"] in words().roles["portable"]:
                true = [p for p in PAIR_PREDICATES if world.status(room, p, name, anchor["object_id"]) == 1]
                ways += [(stop, predicate, [anchor]) for predicate in true]
    return _said(files, rng, ways)


@mutator
def say_a_support_as_near(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A stop or a true condition is about a thing that rests on another, and says that it is near it."""
    return _said(files, rng, _supported(files, world, "near"))


@mutator
def deny_what_is_not_clearly_so(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A false condition denies that a thing is near, or in a direction, where people might say that it is."""
    ways = []
    for condition in files.conditions:
        if condition["truth"]:
            continue
        room = condition["room"]["room_id"]
        names = world.objects_like(room, condition["label"])
        for anchor in _alone(world, room, condition["label"]) if names else ():
            others = [x for x in names if x != anchor["object_id"]]
            for predicate in ("near", *COMPASS):
                status = {world.status(room, predicate, x, anchor["object_id"]) for x in others}
                if 1 not in status and not all(world.denied(room, predicate, x, anchor["object_id"]) for x in others):
                    ways.append((condition, predicate, [anchor]))
    return _said(files, rng, ways)


def _asked_wrongly(files: Files, world: World, predicates: tuple[str, ...], doubtful: Doubt) -> list[Change]:
    """Conditions and other predicates and anchors for them, which neither truth fits, where `doubtful` of one thing."""
    ways = []
    for condition in files.conditions:
        room = condition["room"]["room_id"]
        for anchor in _alone(world, room, condition["label"]):
            names = [x for x in world.objects_like(room, condition["label"]) if x != anchor["object_id"]]
            for predicate in predicates:
                status = {world.status(room, predicate, x, anchor["object_id"]) for x in names}
                denied = all(world.denied(room, predicate, x, anchor["object_id"]) for x in names)
                if 1 in status or denied or not names:
                    continue
                if any(doubtful(room, predicate, x, anchor["object_id"]) for x in names):
                    ways.append((condition, predicate, [anchor]))
    return ways


@mutator
def ask_the_height_of_what_is_about_level(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A condition asks whether a thing is higher or lower than another, of which neither is clearly so."""

    def level(room: str, predicate: str, name: str, anchor: str) -> bool:
        own, other = (world.scene.object_of[x].box for x in (name, anchor))
        return own is not None and other is not None and abs(float((own - other)[:, 1].mean())) < 0.45

    return _said(files, rng, _asked_wrongly(files, world, ("higher than", "lower than"), level))


@mutator
def say_the_direction_from_one_point(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A condition or a stop takes a direction from centre to centre, which is another one from the nearest point of the
    thing or its anchor."""

    def by_centres(room: str, predicate: str, name: str, anchor: str) -> bool:
        own, other = (world.scene.object_of[x].center for x in (name, anchor))
        azimuth = np.degrees(np.arctan2(other[2] - own[2], own[0] - other[0]))
        off = abs((azimuth - 45.0 * COMPASS.index(predicate) + 180.0) % 360.0 - 180.0)
        return bool(off <= 15.0 or off > 60.0)

    ways = _asked_wrongly(files, world, COMPASS, by_centres)
    for stop in _stops(files):
        room, name = stop["room"]["room_id"], stop["object_id"]
        for anchor in _alone(world, room, stop["label"]):
            for predicate in COMPASS:
                if (
                    anchor["object_id"] != name
                    and world.status(room, predicate, name, anchor["object_id"]) == 0
                    and by_centres(room, predicate, name, anchor["object_id"])
                ):
                    ways.append((stop, predicate, [anchor]))
    return _said(files, rng, ways)


@mutator
def compare_what_no_size_tells_apart(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Of two things of one label, neither of which is larger in every way, the stop is called the bigger or smaller."""
    ways = []
    for stop in _stops(files):
        room, name = stop["room"]["room_id"], stop["object_id"]
        ids = world.scene.arrays(room).object_ids
        alike = world.objects_like(room, stop["label"])
        rivals = np.zeros((len(ids), len(ids)), dtype=bool)
        order = [ids.index(x) for x in alike]
        rivals[np.ix_(order, order)] = True
        np.fill_diagonal(rivals, False)
        sizes = world.facts[room].sizes(rivals)
        ways += [(stop, predicate, []) for predicate, status in sizes.items() if status[ids.index(name)] != 1]
    return _said(files, rng, ways)
