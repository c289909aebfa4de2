"""Seeded faults in published files, each of which makes an episode wrong.

A mutator takes one episode as its files have it and returns it with one fault, or None where it does not apply. Faults
are carried through: where a truth is flipped, the gold leaf, its goals and the record follow, so that nothing but the
scene itself can tell. Those of the kind "said" are worded anew, so that the text agrees with the program.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from condvln.instructions import render, with_preamble
from condvln.instructions.rendering import names_compass
from condvln.relations import TextFacts
from condvln.scene import Scene
from condvln.verify.files import Row
from condvln.verify.heading import heading_of, yaw_of
from condvln.verify.reading import Unreadable, read
from condvln.verify.words import words
from schemas.evaluation import ManifestEpisode
from schemas.program import Program

Document = dict[str, Any]


@dataclass
class Files:
    """One episode as its files have it."""

    manifest: Document
    record: Document
    truth: Document

    @classmethod
    def of(cls, row: Row) -> Files:
        assert row.record is not None
        assert row.truth is not None
        return cls(
            row.manifest.model_dump(mode="json"), copy.deepcopy(dict(row.record)), copy.deepcopy(dict(row.truth))
        )

    def row(self, split: str) -> Row:
        """As it is read back. Raises ValidationError where it is no manifest row any more."""
        return Row(split, ManifestEpisode.model_validate(self.manifest), self.record, self.truth)

    # -- changes that are carried through ------------------------------------------------------------------------------

    def say(self, text: str) -> None:
        """Another text, in both files."""
        self.manifest["instruction_text"] = text
        self.manifest["words"] = self.record["info"]["words"] = len(text.split())
        self.record["instruction"]["instruction_text"] = text
        if self.manifest["max_steps"] == 10 * self.manifest["words"]:
            return
        if self.manifest["max_steps"] < 10 * self.manifest["words"] <= 500:
            self.manifest["max_steps"] = self.record["info"]["max_steps"] = 10 * self.manifest["words"]

    def word(self) -> None:
        """The text that the program as it is now would have."""
        program = Program.model_validate(self.manifest["program"])
        body = render(program, 0, self.manifest["instruction_id"])
        yaw = yaw_of(self.manifest["start_rotation"])
        assert yaw is not None
        if names_compass(program):
            nearest = round(heading_of(yaw) / 45.0) * 45.0 % 360.0
            body = with_preamble(body, nearest)
        self.say(body)

    def follow_truths(self) -> None:
        """Gold leaf and all that hangs on it, as the truths now have it."""
        self.take_leaf(Program.model_validate(self.manifest["program"]).gold_leaf())

    def take_leaf(self, gold: int) -> None:
        """Another gold leaf."""
        manifest, record = self.manifest, self.record
        leaf = manifest["leaves"][gold]
        manifest["gold_leaf"] = gold
        manifest["moves"] = record["info"]["moves"] = len(manifest["program"]["leaves"][gold]["moves"])
        for name in ("geodesic_distance", "route_length"):
            manifest[name] = record["info"][name] = leaf[name]
        self.repeat_gold()

    def repeat_gold(self) -> None:
        """The record repeats the gold leaf of the manifest."""
        leaf = self.manifest["leaves"][self.manifest["gold_leaf"]]
        radius = self.manifest["success_distance"]
        self.record["goals"] = [{"position": goal, "radius": radius} for goal in leaf["goals"]]
        self.record["info"]["subgoals"] = [subgoal["position"] for subgoal in leaf["subgoals"]]
        self.record["reference_path"] = leaf["reference_path"]

    @property
    def conditions(self) -> list[Document]:
        found: list[Document] = self.manifest["program"]["conditions"]
        return found

    @property
    def leaves(self) -> list[Document]:
        found: list[Document] = self.manifest["program"]["leaves"]
        return found


@dataclass(frozen=True)
class World:
    """What a mutator may know of the scene, so that its fault is one."""

    scene: Scene
    facts: dict[str, TextFacts]

    def status(self, room_id: str, predicate: str, subject: str, target: str) -> int:
        order = {name: k for k, name in enumerate(self.scene.arrays(room_id).object_ids)}
        return int(self.facts[room_id].status[predicate][order[subject], order[target]])

    def objects_like(self, room_id: str, label: str) -> list[str]:
        meant = words().meant_by(label)
        return [o.object_id for o in self.scene.objects if o.room_id == room_id and o.label in meant]


Mutator = Callable[[Files, np.random.Generator, World], bool]
"""Puts one fault into the files; False where it does not apply."""

MUTATORS: dict[str, Mutator] = {}


def mutator(function: Mutator) -> Mutator:
    MUTATORS[function.__name__] = function
    return function


def _pick(rng: np.random.Generator, items: Any) -> Any:
    items = list(items)
    return items[rng.integers(len(items))]


# -- truths and leaves -------------------------------------------------------------------------------------------------


@mutator
def flip_truth(files: Files, rng: np.random.Generator, world: World) -> bool:
    condition = _pick(rng, files.conditions)
    condition["truth"] = not condition["truth"]
    condition["witnesses"] = [world.scene.objects[0].object_id] if condition["truth"] else []
    files.follow_truths()
    return True


@mutator
def drop_a_witness(files: Files, rng: np.random.Generator, world: World) -> bool:
    several = [c for c in files.conditions if len(c["witnesses"]) > 1]
    if not several:
        return False
    _pick(rng, several)["witnesses"].pop()
    return True


@mutator
def replace_a_witness(files: Files, rng: np.random.Generator, world: World) -> bool:
    true = [c for c in files.conditions if c["truth"]]
    if not true:
        return False
    condition = _pick(rng, true)
    others = [o.object_id for o in world.scene.objects if o.object_id not in condition["witnesses"]]
    condition["witnesses"][0] = _pick(rng, others)
    return True


@mutator
def swap_gold_leaf(files: Files, rng: np.random.Generator, world: World) -> bool:
    files.take_leaf(_pick(rng, {*range(len(files.leaves))} - {files.manifest["gold_leaf"]}))
    return True


@mutator
def swap_leaves_of_program(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Program, places and record agree on it; the text says otherwise."""
    one, other = rng.choice(len(files.leaves), 2, replace=False)
    for leaves in (files.leaves, files.manifest["leaves"]):
        leaves[one], leaves[other] = leaves[other], leaves[one]
    for k, leaf in enumerate(files.manifest["leaves"]):
        leaf["leaf"] = k
    files.follow_truths()
    return True


@mutator
def swap_leaves_as_said(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Text and program agree on it; the places stay."""
    one, other = rng.choice(len(files.leaves), 2, replace=False)
    files.leaves[one], files.leaves[other] = files.leaves[other], files.leaves[one]
    files.word()
    return True


@mutator
def swap_places_of_leaves(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Only the places of two leaves change with each other."""
    one, other = rng.choice(len(files.leaves), 2, replace=False)
    leaves = files.manifest["leaves"]
    leaves[one], leaves[other] = leaves[other], leaves[one]
    for k, leaf in enumerate(leaves):
        leaf["leaf"] = k
    files.follow_truths()
    return True


@mutator
def swap_conditions(files: Files, rng: np.random.Generator, world: World) -> bool:
    if len(files.conditions) < 2:
        return False
    one, other = rng.choice(len(files.conditions), 2, replace=False)
    files.conditions[one], files.conditions[other] = files.conditions[other], files.conditions[one]
    files.follow_truths()
    return True


# -- objects, rooms, qualifiers ----------------------------------------------------------------------------------------


@mutator
def move_object(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A stop's places are two metres off, in all files."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    by = 2.0 * np.array([np.cos(angle), 0.0, np.sin(angle)])

    def moved(point: list[float]) -> list[float]:
        return [round(float(v), 3) for v in np.array(point) + by]

    leaf = _pick(rng, files.manifest["leaves"])
    if leaf["subgoals"] and rng.random() < 0.5:
        subgoal = _pick(rng, leaf["subgoals"])
        subgoal["position"] = moved(subgoal["position"])
    else:
        leaf["goals"] = [moved(goal) for goal in leaf["goals"]]
        leaf["reference_path"][-1] = leaf["goals"][0]
    files.repeat_gold()
    return True


@mutator
def replace_a_goal_object(files: Files, rng: np.random.Generator, world: World) -> bool:
    k = int(rng.integers(len(files.leaves)))
    stop = files.leaves[k]["moves"][-1]
    others = [o.object_id for o in world.scene.objects if o.object_id != stop["object_id"]]
    stop["object_id"] = files.manifest["leaves"][k]["object_id"] = _pick(rng, others)
    return True


@mutator
def replace_a_label(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The program names another thing than the text."""
    named = _pick(rng, [*files.conditions, *(move for leaf in files.leaves for move in leaf["moves"])])
    named["label"] = _pick(rng, {*words().nouns} - {named["label"]})
    return True


@mutator
def replace_a_label_as_said(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Text and program agree on a stop of another label."""
    named = _pick(rng, [move for leaf in files.leaves for move in leaf["moves"]])
    named["label"] = _pick(rng, {*words().nouns} - {named["label"]})
    files.word()
    return True


@mutator
def rename_room(files: Files, rng: np.random.Generator, world: World) -> bool:
    rooms = [c["room"] for c in files.conditions] + [m["room"] for leaf in files.leaves for m in leaf["moves"]]
    room = _pick(rng, rooms)
    name = _pick(rng, {*words().rooms} - {room["label"]})
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
    named = _pick(rng, [*files.conditions, *(move for leaf in files.leaves for move in leaf["moves"])])
    rooms = [c["room"] for c in files.conditions] + [m["room"] for leaf in files.leaves for m in leaf["moves"]]
    others = [room for room in rooms if room["room_id"] != named["room"]["room_id"]]
    if not others:
        return False
    before = copy.deepcopy(named)
    named["room"] = _pick(rng, others)
    if "truth" in named and not before["witnesses"]:
        return False  # what is absent here may well be absent there
    files.word()
    return True


@mutator
def change_room_anchor(files: Files, rng: np.random.Generator, world: World) -> bool:
    rooms = [c["room"] for c in files.conditions] + [m["room"] for leaf in files.leaves for m in leaf["moves"]]
    anchored = [room for room in rooms if room["anchor_id"]]
    if not anchored:
        return False
    room = _pick(rng, anchored)
    room["anchor_label"] = _pick(rng, {*words().nouns} - {room["anchor_label"]})
    return True


def _qualified(files: Files) -> list[Document]:
    named = [*files.conditions, *(move for leaf in files.leaves for move in leaf["moves"])]
    return [one for one in named if one["qualifier"]]


PREDICATES = ("near", "above", "below", "higher than", "lower than", "far from", "east of", "north-west of", "south of")


@mutator
def change_qualifier(files: Files, rng: np.random.Generator, world: World) -> bool:
    if not (named := _qualified(files)):
        return False
    qualifier = _pick(rng, named)["qualifier"]
    qualifier["predicate"] = _pick(rng, {*PREDICATES} - {qualifier["predicate"]})
    return True


@mutator
def change_anchor(files: Files, rng: np.random.Generator, world: World) -> bool:
    if not (named := _qualified(files)):
        return False
    qualifier = _pick(rng, named)["qualifier"]
    qualifier["anchor_label"] = _pick(rng, {*words().nouns} - {qualifier["anchor_label"]})
    return True


@mutator
def change_anchor_object(files: Files, rng: np.random.Generator, world: World) -> bool:
    if not (named := _qualified(files)):
        return False
    one = _pick(rng, named)
    here = [o.object_id for o in world.scene.objects if o.room_id == one["room"]["room_id"]]
    one["qualifier"]["anchor_id"] = _pick(rng, {*here} - {one["qualifier"]["anchor_id"]})
    return True


@mutator
def change_qualifier_as_said(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Text and program agree on another relation, which the scene does not have with the margin that it takes."""
    if not (named := _qualified(files)):
        return False
    one = _pick(rng, named)
    wanted = {*PREDICATES} - {one["qualifier"]["predicate"]}
    wrong = []
    for predicate in sorted(wanted):
        room, anchor = one["room"]["room_id"], one["qualifier"]["anchor_id"]
        own = [one["object_id"]] if "object_id" in one else world.objects_like(room, one["label"])
        statuses = [world.status(room, predicate, name, anchor) for name in own if name != anchor]
        still = all(s == -1 for s in statuses) if one.get("truth") is False else 1 in statuses
        if not still:
            wrong.append(predicate)
    if not wrong:
        return False
    one["qualifier"]["predicate"] = _pick(rng, wrong)
    files.word()
    return True


@mutator
def drop_a_qualifier_as_said(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The stop's label alone fits several things."""
    stops = [move for leaf in files.leaves for move in leaf["moves"] if move["qualifier"]]
    if not stops:
        return False
    _pick(rng, stops)["qualifier"] = None
    files.word()
    return True


@mutator
def add_a_needless_qualifier(files: Files, rng: np.random.Generator, world: World) -> bool:
    stops = [move for leaf in files.leaves for move in leaf["moves"] if not move["qualifier"]]
    rng.shuffle(stops)
    for stop in stops:
        here = [o for o in world.scene.objects if o.room_id == stop["room"]["room_id"] and o.label in words().nouns]
        alone = [o for o in here if len(world.objects_like(o.room_id, o.label)) == 1]
        anchors = [o for o in alone if o.object_id != stop["object_id"]]
        if anchors:
            anchor = _pick(rng, anchors)
            stop["qualifier"] = {"predicate": "near", "anchor_id": anchor.object_id, "anchor_label": anchor.label}
            files.word()
            return True
    return False


# -- text --------------------------------------------------------------------------------------------------------------


@mutator
def swap_words(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Two neighbouring words change places; sentences that come to mean the same are no faults."""
    text = files.manifest["instruction_text"].split()
    k = int(rng.integers(len(text) - 1))
    text[k], text[k + 1] = text[k + 1], text[k]
    return _say_if_other(files, " ".join(text))


@mutator
def swap_far_words(files: Files, rng: np.random.Generator, world: World) -> bool:
    text = files.manifest["instruction_text"].split()
    one, other = rng.choice(len(text), 2, replace=False)
    text[one], text[other] = text[other], text[one]
    return _say_if_other(files, " ".join(text))


@mutator
def drop_a_word(files: Files, rng: np.random.Generator, world: World) -> bool:
    text = files.manifest["instruction_text"].split()
    del text[rng.integers(len(text))]
    return _say_if_other(files, " ".join(text))


@mutator
def negate_a_clause(files: Files, rng: np.random.Generator, world: World) -> bool:
    text = files.manifest["instruction_text"]
    for affirmed, denied in (("there is a ", "there is no "), ("has a ", "has no "), ("there's a ", "there's no ")):
        if affirmed in text:
            files.say(text.replace(affirmed, denied, 1))
            return True
    return False


@mutator
def replace_a_noun_in_text(files: Files, rng: np.random.Generator, world: World) -> bool:
    program = Program.model_validate(files.manifest["program"])
    label = _pick(rng, [leaf.goal.label for leaf in program.leaves])
    noun = words().nouns[label][0]
    other = _pick(rng, sorted({n for n, _ in words().nouns.values()} - {noun}))
    return _say_if_other(files, files.manifest["instruction_text"].replace(f"the {noun}", f"the {other}"))


@mutator
def face_elsewhere(files: Files, rng: np.random.Generator, world: World) -> bool:
    head, _, rest = files.manifest["instruction_text"].partition(". ")
    for name in ("north-east", "north-west", "south-east", "south-west", "north", "south", "east", "west"):
        if head.endswith(f" {name}"):
            other = _pick(rng, {"north", "east", "south", "west", "north-east"} - {name})
            files.say(f"{head.removesuffix(name)}{other}. {rest}")
            return True
    return False


@mutator
def drop_the_heading(files: Files, rng: np.random.Generator, world: World) -> bool:
    head, _, rest = files.manifest["instruction_text"].partition(". ")
    if " fac" not in head and " look" not in head and "direction" not in head:
        return False
    files.say(rest)
    return True


def _say_if_other(files: Files, text: str) -> bool:
    before = files.manifest["instruction_text"]
    if text.lower() == before.lower():
        return False
    try:
        if read(text) == read(before):
            return False
    except Unreadable:
        pass
    files.say(text)
    return True


# -- places and numbers ------------------------------------------------------------------------------------------------


@mutator
def move_the_start(files: Files, rng: np.random.Generator, world: World) -> bool:
    axis = int(rng.choice([0, 2]))
    start = files.manifest["start_position"]
    start[axis] = files.record["start_position"][axis] = round(start[axis] + float(rng.choice([-2.0, 2.0])), 3)
    for leaf in files.manifest["leaves"]:
        leaf["reference_path"][0] = list(start)
    files.repeat_gold()
    return True


@mutator
def turn_the_start(files: Files, rng: np.random.Generator, world: World) -> bool:
    yaw = (yaw_of(files.manifest["start_rotation"]) or 0.0) + np.radians(float(rng.choice([45, 90, 180, 270])))
    turned = [0.0, float(np.sin(yaw / 2)), 0.0, float(np.cos(yaw / 2))]
    files.manifest["start_rotation"] = files.record["start_rotation"] = turned
    files.record["info"]["start_heading_degrees"] = heading_of(yaw)
    return True


@mutator
def lengthen(files: Files, rng: np.random.Generator, world: World) -> bool:
    leaf, name = _pick(rng, files.manifest["leaves"]), _pick(rng, ("geodesic_distance", "route_length"))
    leaf[name] += float(rng.choice([-1.0, 1.0])) * float(rng.uniform(0.005, 1.0))
    files.take_leaf(files.manifest["gold_leaf"])
    return True


@mutator
def bend_a_path(files: Files, rng: np.random.Generator, world: World) -> bool:
    path = _pick(rng, files.manifest["leaves"])["reference_path"]
    corner = path[rng.integers(len(path))]
    corner[int(rng.choice([0, 2]))] += float(rng.choice([-0.01, 0.01, 0.5]))
    files.repeat_gold()
    return True


@mutator
def cut_a_path(files: Files, rng: np.random.Generator, world: World) -> bool:
    path = _pick(rng, files.manifest["leaves"])["reference_path"]
    if len(path) < 3:
        return False
    del path[rng.integers(1, len(path))]
    files.repeat_gold()
    return True


@mutator
def another_success_distance(files: Files, rng: np.random.Generator, world: World) -> bool:
    files.manifest["success_distance"] = files.record["info"]["success_distance"] = 3.0
    files.repeat_gold()
    return True


@mutator
def another_budget(files: Files, rng: np.random.Generator, world: World) -> bool:
    files.manifest["max_steps"] -= int(rng.integers(1, 50))
    files.record["info"]["max_steps"] = files.manifest["max_steps"]
    return True


@mutator
def another_axis(files: Files, rng: np.random.Generator, world: World) -> bool:
    name = _pick(rng, ("depth", "chain", "moves", "words", "composition"))
    if name == "composition":
        value: Any = _pick(rng, {"C0", "C1", "C2"} - {files.manifest[name]})
    else:
        value = files.manifest[name] + 1
    files.manifest[name] = files.record["info"][name] = value
    return True


@mutator
def another_navmesh(files: Files, rng: np.random.Generator, world: World) -> bool:
    files.manifest["navmesh_sha256"] = files.record["info"]["navmesh_sha256"] = f"{rng.integers(1 << 60):064x}"
    return True


# -- what is seen from where -------------------------------------------------------------------------------------------

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
        _tell(files, _pick(rng, others), level, False)
        return True

    return mutate


for _name, _level in zip(("seen_at_once", "seen_on_the_way", "seen_by_a_detour"), LEVELS, strict=True):
    MUTATORS[_name] = _told_as(_level)


@mutator
def another_first_view(files: Files, rng: np.random.Generator, world: World) -> bool:
    from_start = [one for one in files.manifest["evidence"] if one["observability"] == "O0"]
    if not from_start:
        return False
    place = _pick(rng, from_start)
    _tell(files, place, "O0", not place["in_view"])
    return True


@mutator
def seen_at_once_and_ahead(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The easiest cell claimed for what is in none of its views."""
    ahead = [one for one in files.manifest["evidence"] if not one["in_view"]]
    if not ahead:
        return False
    _tell(files, _pick(rng, ahead), "O0", True)
    return True


@mutator
def other_surfaces(files: Files, rng: np.random.Generator, world: World) -> bool:
    among_boxes = not files.manifest["observability_approximate"]
    files.manifest["observability_approximate"] = among_boxes
    files.record["info"]["observability_approximate"] = among_boxes
    return True


# -- one file by itself ------------------------------------------------------------------------------------------------


@mutator
def change_the_record(files: Files, rng: np.random.Generator, world: World) -> bool:
    name = _pick(rng, ("start_position", "goals", "reference_path", "scene_id", "trajectory_id", "text", "info"))
    record = files.record
    if name == "start_position":
        record[name] = [record[name][0] + 0.01, *record[name][1:]]
    elif name == "goals":
        record[name] = record[name][::-1] if len(record[name]) > 1 else []
    elif name == "reference_path":
        record[name] = record[name][:-1]
    elif name == "text":
        record["instruction"]["instruction_text"] += " "
    elif name == "info":
        del record["info"][_pick(rng, sorted(record["info"]))]
    else:
        record[name] = "elsewhere"
    return True


@mutator
def change_the_truth(files: Files, rng: np.random.Generator, world: World) -> bool:
    truth = files.truth
    kind = int(rng.integers(4))
    if kind == 0:
        truth["forward_steps"] += 1
    elif kind == 1:
        place = truth["locations"][rng.integers(len(truth["locations"]))]
        place[int(rng.choice([0, 2]))] += 0.05
    elif kind == 2:
        truth["locations"] = truth["locations"][:-1]
    else:
        actions = truth.get("actions")
        if not actions:
            return False
        turns = [k for k, action in enumerate(actions) if action in (2, 3)]
        if not turns:
            return False
        k = _pick(rng, turns)
        actions[k] = 5 - actions[k]
        if 1 not in actions[k:]:
            return False  # a turn on the goal leads nowhere else
    return True
