"""Faults in the objects, rooms and qualifiers that a program names, or where they are."""

from __future__ import annotations

import copy

import numpy as np
from mutation import Document, Files, World, mutator, pick

from condvln.scene import SceneObject
from condvln.verify.words import words


@mutator
def move_object(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A stop's places are two metres off, in all files."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    by = 2.0 * np.array([np.cos(angle), 0.0, np.sin(angle)])

    def moved(point: list[float]) -> list[float]:
        return [round(float(v), 3) for v in np.array(point) + by]

    leaf = pick(rng, files.manifest["leaves"])
    if leaf["subgoals"] and rng.random() < 0.5:
        subgoal = pick(rng, leaf["subgoals"])
        subgoal["position"] = moved(subgoal["position"])
    else:
        leaf["goals"] = [moved(goal) for goal in leaf["goals"]]
        leaf["reference_path"][-1] = moved(leaf["reference_path"][-1])
    files.repeat_gold()
    return True


@mutator
def replace_a_goal_object(files: Files, rng: np.random.Generator, world: World) -> bool:
    k = int(rng.integers(len(files.leaves)))
    stop = files.leaves[k]["moves"][-1]
    others = [o.object_id for o in world.scene.objects if o.object_id != stop["object_id"]]
    stop["object_id"] = files.manifest["leaves"][k]["object_id"] = pick(rng, others)
    return True


@mutator
def replace_a_label(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The program names another thing than the text."""
    named = pick(rng, [*files.conditions, *(move for leaf in files.leaves for move in leaf["moves"])])
    named["label"] = pick(rng, {*words().nouns} - {named["label"]})
    return True


@mutator
def replace_a_label_as_said(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Text and program agree on a stop of another label."""
    named = pick(rng, [move for leaf in files.leaves for move in leaf["moves"]])
    named["label"] = pick(rng, {*words().nouns} - {named["label"]})
    files.word()
    return True


@mutator
def rename_room(files: Files, rng: np.random.Generator, world: World) -> bool:
    rooms = [c["room"] for c in files.conditions] + [m["room"] for leaf in files.leaves for m in leaf["moves"]]
    room = pick(rng, rooms)
    name = pick(rng, {*words().rooms} - {room["label"]})
    for other in rooms:
        if other["room_id"] == room["room_id"]:
            other["label"] = name
    return True


@mutator
def rename_room_as_said(files: Files, rng: np.random.Generator, world: World) -> bool:
    files_before = files.manifest["instruction_text"]
    rename_room(files, rng, world)
    files.word()
    return bool(files.manifest["instruction_text"] != files_before)


@mutator
def send_to_another_room(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Text and program agree on another room of the scene, for one condition or stop."""
    named = pick(rng, [*files.conditions, *(move for leaf in files.leaves for move in leaf["moves"])])
    rooms = [c["room"] for c in files.conditions] + [m["room"] for leaf in files.leaves for m in leaf["moves"]]
    others = [room for room in rooms if room["room_id"] != named["room"]["room_id"]]
    if not others:
        return False
    before = copy.deepcopy(named)
    named["room"] = pick(rng, others)
    if "truth" in named and not before["witnesses"]:
        return False  # what is absent here may well be absent there
    files.word()
    return True


@mutator
def change_room_anchor(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Name another object as the one that distinguishes a room, or any object in the room if the text names none."""
    rooms = [c["room"] for c in files.conditions] + [m["room"] for leaf in files.leaves for m in leaf["moves"]]
    anchored = [room for room in rooms if room["anchor_id"]]
    if not anchored:
        room = pick(rng, rooms)
        inside = [o for o in world.scene.objects if o.room_id == room["room_id"] and o.label in words().nouns]
        if not inside:
            return False
        anchor = pick(rng, inside)
        room["anchor_id"], room["anchor_label"] = anchor.object_id, anchor.label
        return True
    room = pick(rng, anchored)
    room["anchor_label"] = pick(rng, {*words().nouns} - {room["anchor_label"]})
    return True


def _qualified(files: Files) -> list[Document]:
    """Conditions and stops with anchors."""
    named = [*files.conditions, *(move for leaf in files.leaves for move in leaf["moves"])]
    return [one for one in named if one["qualifier"] and one["qualifier"]["anchors"]]


PREDICATES = (
    "on",
    "near",
    "above",
    "below",
    "higher than",
    "lower than",
    "far from",
    "east of",
    "north-west of",
    "south of",
)


@mutator
def change_qualifier(files: Files, rng: np.random.Generator, world: World) -> bool:
    if not (named := _qualified(files)):
        return False
    qualifier = pick(rng, [one["qualifier"] for one in named if len(one["qualifier"]["anchors"]) == 1] or [None])
    if qualifier is None:
        return False
    qualifier["predicate"] = pick(rng, {*PREDICATES} - {qualifier["predicate"]})
    return True


@mutator
def change_anchor(files: Files, rng: np.random.Generator, world: World) -> bool:
    if not (named := _qualified(files)):
        return False
    anchor = pick(rng, pick(rng, named)["qualifier"]["anchors"])
    anchor["label"] = pick(rng, {*words().nouns} - {anchor["label"]})
    return True


@mutator
def change_anchor_object(files: Files, rng: np.random.Generator, world: World) -> bool:
    if not (named := _qualified(files)):
        return False
    one = pick(rng, named)
    here = [o.object_id for o in world.scene.objects if o.room_id == one["room"]["room_id"]]
    anchor = pick(rng, one["qualifier"]["anchors"])
    anchor["object_id"] = pick(rng, {*here} - {other["object_id"] for other in one["qualifier"]["anchors"]})
    return True


@mutator
def change_qualifier_as_said(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Text and program agree on another relation, which the scene does not have with the margin that it takes."""
    if not (named := _qualified(files)):
        return False
    named = [one for one in named if len(one["qualifier"]["anchors"]) == 1]
    if not named:
        return False
    one = pick(rng, named)
    wrong = [p for p in PREDICATES if p != one["qualifier"]["predicate"] and not _still(one, p, world)]
    if not wrong:
        return False
    one["qualifier"]["predicate"] = pick(rng, wrong)
    files.word()
    return True


def _still(one: Document, predicate: str, world: World) -> bool:
    """Whether what is said of a stop or a condition holds with another predicate to the same anchor."""
    room, anchor = one["room"]["room_id"], one["qualifier"]["anchors"][0]["object_id"]
    own = [one["object_id"]] if "object_id" in one else world.objects_like(room, one["label"])
    statuses = [world.status(room, predicate, name, anchor) for name in own if name != anchor]
    return all(s == -1 for s in statuses) if one.get("truth") is False else 1 in statuses


@mutator
def drop_a_qualifier_as_said(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The stop's label alone fits several things."""
    stops = [move for leaf in files.leaves for move in leaf["moves"] if move["qualifier"]]
    if not stops:
        return False
    pick(rng, stops)["qualifier"] = None
    files.word()
    return True


def _anchor(item: SceneObject) -> Document:
    return {"object_id": item.object_id, "label": item.label}


@mutator
def add_a_needless_qualifier(files: Files, rng: np.random.Generator, world: World) -> bool:
    stops = [move for leaf in files.leaves for move in leaf["moves"] if not move["qualifier"]]
    rng.shuffle(stops)
    for stop in stops:
        here = [o for o in world.scene.objects if o.room_id == stop["room"]["room_id"] and o.label in words().nouns]
        alone = [o for o in here if len(world.objects_like(o.room_id, o.label)) == 1]
        anchors = [o for o in alone if o.object_id != stop["object_id"]]
        if anchors:
            anchor = pick(rng, anchors)
            stop["qualifier"] = {"predicate": "near", "anchors": [_anchor(anchor)]}
            files.word()
            return True
    return False
