"""Faults in leads."""

from __future__ import annotations

import numpy as np
import shapely
from mutation import Document, Files, World, mutator, pick


def _led(files: Files) -> list[Document]:
    return [branch for branch in files.manifest["program"]["branches"] if branch["lead"] is not None]


def _lead_stops(files: Files) -> list[Document]:
    rooms = {branch["lead"]["room_id"] for branch in _led(files)}
    return [stop for leaf in files.manifest["leaves"] for stop in leaf["subgoals"] if stop["object_id"] in rooms]


@mutator
def lead_to_another_room(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The program leads to another room that it names; the text says so."""
    led = _led(files)
    named = [one["room"] for one in (*files.conditions, *(move for leaf in files.leaves for move in leaf["moves"]))]
    if not led:
        return False
    branch = pick(rng, led)
    others = [room for room in named if room["room_id"] != branch["lead"]["room_id"]]
    if not others:
        return False
    branch["lead"] = pick(rng, others)
    files.word()
    return True


@mutator
def leave_a_lead_out(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The program and the text have no lead any more; the ways still do."""
    led = _led(files)
    if not led:
        return False
    pick(rng, led)["lead"] = None
    files.word()
    files.take_leaf(files.manifest["gold_leaf"])
    return True


@mutator
def pass_a_lead_by(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A lead is no subgoal any more."""
    leaves = [leaf for leaf in files.manifest["leaves"] if any(stop in _lead_stops(files) for stop in leaf["subgoals"])]
    if not leaves:
        return False
    del pick(rng, leaves)["subgoals"][0]
    files.repeat_gold()
    return True


@mutator
def lead_elsewhere_in_one_leaf(files: Files, rng: np.random.Generator, world: World) -> bool:
    """On the way to one of several leaves, a lead ends a hand's breadth beside where it ends for the others."""
    stops = _lead_stops(files)
    shared = [stop for stop in stops if sum(one["position"] == stop["position"] for one in stops) > 1]
    if not shared:
        return False
    pick(rng, shared)["position"][0] += 0.1
    files.repeat_gold()
    return True


@mutator
def lead_at_the_wall(files: Files, rng: np.random.Generator, world: World) -> bool:
    """For all leaves, a lead ends on the outline of its room."""
    stops = _lead_stops(files)
    if not stops:
        return False
    stop = pick(rng, stops)
    (x, y, z), room = stop["position"], world.scene.room_of[stop["object_id"]]
    point = shapely.Polygon(room.polygon).boundary.interpolate(0.1)
    for one in stops:
        if one["object_id"] == stop["object_id"]:
            one["position"] = [round(point.x, 3), y, round(point.y, 3)]
    files.repeat_gold()
    return (x, z) != (point.x, point.y)


@mutator
def lead_nowhere(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A lead ends where one starts, from where nothing of its room is seen."""
    stops = _lead_stops(files)
    if not stops:
        return False
    pick(rng, stops)["position"] = list(files.manifest["start_position"])
    files.repeat_gold()
    return True


@mutator
def lead_reached_elsewhere(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The outline of a lead's room has one corner more than the room, a metre outside."""
    stops = [stop for stop in _lead_stops(files) if stop["outline"]]
    if not stops:
        return False
    outline = pick(rng, stops)["outline"]
    outline.append([outline[0][0] - 1.0, outline[0][1] - 1.0])
    files.repeat_gold()
    return True
