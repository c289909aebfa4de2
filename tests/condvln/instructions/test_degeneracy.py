"""Each rule catches its own kind of bad program and lets its sound neighbour pass."""

from __future__ import annotations

from itertools import product

import pytest

from condvln.instructions.degeneracy import RULES, degeneracies, idle_conditions, outcomes
from condvln.labels import vocabulary
from schemas.program import (
    CATEGORIES,
    SHAPES,
    Anchor,
    Category,
    Condition,
    Leaf,
    ObjectRef,
    Predicate,
    Program,
    Qualifier,
    RoomRef,
)

BEDROOM = RoomRef(room_id="r0", label="bedroom")
PIANO_ROOM = RoomRef(room_id="r0", label="bedroom", anchor_id="p", anchor_label="piano")
CHAIR_ROOM = RoomRef(room_id="r0", label="bedroom", anchor_id="c", anchor_label="armchair")
KITCHEN = RoomRef(room_id="r1", label="kitchen")
OFFICE = RoomRef(room_id="r2", label="office")


def related(predicate: Predicate, anchor: str) -> Qualifier:
    return Qualifier(predicate=predicate, anchors=(Anchor(object_id=f"the {anchor}", label=anchor),))


def asks(label: str, anchor: str = "", room: RoomRef = BEDROOM, predicate: Predicate = "near") -> Condition:
    return Condition(label=label, room=room, qualifier=related(predicate, anchor) if anchor else None, truth=False)


def stop(label: str, anchor: str = "", room: RoomRef = KITCHEN, name: str = "") -> ObjectRef:
    qualifier = related("near", anchor) if anchor else None
    return ObjectRef(object_id=name or f"{label} {anchor}", label=label, room=room, qualifier=qualifier)


def program(category: Category, conditions: list[Condition], leaves: list[list[ObjectRef]]) -> Program:
    return Program(
        category=category,
        conditions=tuple(conditions),
        branches=SHAPES[category].branches,
        leaves=tuple(Leaf(moves=tuple(moves)) for moves in leaves),
    )


def simple(condition: Condition, one: list[ObjectRef] | None = None, other: list[ObjectRef] | None = None) -> Program:
    return program("simple", [condition], [one or [stop("sink")], other or [stop("stove")]])


def nested(first: Condition, second: Condition) -> Program:
    return program("nested", [first, second], [[stop("sink")], [stop("stove")], [stop("table")]])


def chain(first: Condition, second: Condition) -> Program:
    return program("chain", [first, second], [[stop("sink")], [stop("stove")], [stop("kettle")]])


CASES = [
    ("a plain one", simple(asks("lamp", "bed")), ()),
    ("presence", simple(asks("lamp")), ()),
    ("its own anchor", simple(asks("bed", "bed")), ("tautology",)),
    ("a word for its own anchor", simple(asks("chair", "armchair")), ("tautology",)),
    ("the room's own name", simple(asks("piano", room=PIANO_ROOM)), ("tautology",)),
    ("the room's own name in a relation", simple(asks("piano", "bed", PIANO_ROOM)), ("tautology",)),
    ("a room named by the anchor", simple(asks("lamp", "piano", PIANO_ROOM)), ("circular",)),
    ("a room named by the anchor's word", simple(asks("lamp", "chair", CHAIR_ROOM)), ("circular",)),
    ("a room named by a stop", simple(asks("lamp"), [stop("piano", room=PIANO_ROOM)]), ("circular",)),
    ("a room named by a stop's anchor", simple(asks("desk"), [stop("lamp", "piano", PIANO_ROOM)]), ("circular",)),
    ("a stop", simple(asks("lamp", "bed"), [stop("lamp", room=BEDROOM)]), ("names_stop",)),
    ("a word for a stop", simple(asks("chair"), [stop("armchair", room=BEDROOM)]), ("names_stop",)),
    ("a stop's label in another room", simple(asks("lamp", "bed"), [stop("lamp")]), ("two_things",)),
    ("a word for a stop in another room", simple(asks("desk", "chair"), [stop("armchair")]), ("two_things",)),
    ("an anchor's label in another room", simple(asks("lamp", "bed"), [stop("vase", "bed")]), ("two_things",)),
    (
        "a room named by a stop in another room",
        simple(asks("lamp", "bed", PIANO_ROOM), [stop("piano")]),
        ("two_things",),
    ),
    (
        "stops of one label in two rooms",
        simple(asks("lamp"), [stop("desk")], [stop("desk", room=BEDROOM, name="d")]),
        ("two_things",),
    ),
    (
        "an anchor in two rooms",
        nested(asks("lamp", "bed"), asks("vase", "bed", OFFICE)),
        ("two_things",),
    ),
    ("a stop that is only its anchor", simple(asks("lamp", "bed"), [stop("bed", room=BEDROOM)]), ()),
    ("the presence of a stop's label elsewhere", simple(asks("lamp"), [stop("lamp")]), ("names_stop",)),
    ("what a stop's anchor gives away", simple(asks("lamp"), [stop("bed", "lamp", BEDROOM)]), ("given_away",)),
    (
        "what a stop's relation gives away",
        simple(asks("desk", "lamp"), [stop("lamp", "desk", BEDROOM)]),
        ("given_away",),
    ),
    ("another relation of the anchor", simple(asks("desk", "bed"), [stop("lamp", "desk", BEDROOM)]), ()),
    ("one label twice", nested(asks("lamp", "bed"), asks("lamp", "desk")), ("implied",)),
    ("one label in two rooms", nested(asks("lamp", "bed"), asks("lamp", "table", KITCHEN)), ("one_label",)),
    ("the presence of an anchor", nested(asks("lamp", "bed"), asks("bed")), ("implied",)),
    ("an anchor whose presence was asked", nested(asks("bed"), asks("lamp", "bed")), ("implied",)),
    ("the same pair turned round", nested(asks("lamp", "bed"), asks("bed", "lamp")), ("implied",)),
    (
        "a ring",
        program(
            "long_chain",
            [asks("lamp", "bed"), asks("bed", "desk"), asks("desk", "lamp")],
            [[stop(x)] for x in ("sink", "stove", "kettle", "plate")],
        ),
        ("implied",),
    ),
    (
        "a line",
        program(
            "long_chain",
            [asks("lamp", "bed"), asks("bed", "desk"), asks("desk", "wardrobe")],
            [[stop(x)] for x in ("sink", "stove", "kettle", "plate")],
        ),
        (),
    ),
    ("one thing in two places", chain(asks("book", "bed", predicate="on"), asks("book", "desk", predicate="in")), ()),
    (
        "one thing in two places, both of which it may be at",
        nested(asks("book", "bed", predicate="on"), asks("book", "desk", predicate="on")),
        ("implied",),
    ),
    (
        "one thing in one place twice",
        chain(asks("book", "bed", predicate="on"), asks("book", "bed", predicate="in")),
        ("implied",),
    ),
    (
        "one thing near two places",
        chain(asks("book", "bed", predicate="on"), asks("book", "desk")),
        ("implied",),
    ),
    (
        "one thing in places of two rooms",
        chain(asks("book", "bed", predicate="on"), asks("book", "table", KITCHEN, "on")),
        ("one_label",),
    ),
    ("the presence of what is looked for", chain(asks("book"), asks("book", "desk", predicate="on")), ("implied",)),
    ("one target", simple(asks("lamp"), [stop("sink")], [stop("sink")]), ("idle_condition", "one_target")),
    (
        "a room entered twice",
        simple(asks("lamp"), [stop("sink"), stop("desk", room=BEDROOM), stop("kettle")]),
        ("zigzag",),
    ),
    ("two stops in each room", simple(asks("lamp"), [stop("sink"), stop("kettle"), stop("desk", room=BEDROOM)]), ()),
    ("a stop seen twice", simple(asks("lamp"), [stop("sink"), stop("stove"), stop("sink")]), ("repeated_stop",)),
]


@pytest.mark.parametrize(("name", "case", "reasons"), CASES, ids=[name for name, _, _ in CASES])
def test_rules(name: str, case: Program, reasons: tuple[str, ...]) -> None:
    assert degeneracies(case, vocabulary) == reasons


def test_every_rule_is_shown_at_work() -> None:
    assert {reason for _, _, reasons in CASES for reason in reasons} == set(RULES)


@pytest.mark.parametrize("category", CATEGORIES)
def test_outcomes_are_the_programs(category: Category) -> None:
    shape = SHAPES[category]
    sample = program(
        category, [asks(f"x{k}") for k in range(len(shape.branches))], [[stop(f"y{k}")] for k in range(shape.leaves)]
    )
    table = outcomes(category)
    assert set(table) == set(product((True, False), repeat=len(shape.branches)))
    assert all(leaf == sample.gold_leaf(truths) for truths, leaf in table.items())
    assert set(table.values()) == set(range(shape.leaves)), "every leaf can be reached"
    assert idle_conditions(category, [str(k) for k in range(shape.leaves)]) == ()


def test_a_condition_between_equal_goals_is_idle() -> None:
    assert idle_conditions("nested", ["a", "a", "b"]) == (1,)
    assert idle_conditions("nested", ["a", "b", "a"]) == ()
    assert idle_conditions("chain", ["a", "a", "a"]) == (0, 1)
