"""Conditions that look for one thing in several places, and what is not allowed beside them."""

from __future__ import annotations

import pytest

from condvln.verify.certificate import Certificate
from condvln.verify.program_check import _check_independence
from schemas.program import (
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

BEDROOM, KITCHEN = RoomRef(room_id="r0", label="bedroom"), RoomRef(room_id="r1", label="kitchen")


def asks(label: str, place: str, predicate: Predicate = "on", room: RoomRef = BEDROOM) -> Condition:
    anchor = Anchor(object_id=place, label=place)
    return Condition(label=label, room=room, truth=False, qualifier=Qualifier(predicate=predicate, anchors=(anchor,)))


def refuted(category: Category, *conditions: Condition) -> bool:
    shape = SHAPES[category]
    leaves = [Leaf(moves=(ObjectRef(object_id=f"{k}", label="sink", room=KITCHEN),)) for k in range(shape.leaves)]
    program = Program(category=category, conditions=conditions, branches=shape.branches, leaves=tuple(leaves))
    certificate = Certificate("0", "made", "scene", "val")
    _check_independence(program, certificate)
    return bool(certificate.disagreements)


def test_a_thing_is_looked_for_at_one_place_after_the_other() -> None:
    assert not refuted("chain", asks("book", "desk"), asks("book", "bed"))
    assert not refuted("chain", asks("book", "desk", "in"), asks("book", "bed", "on"))
    assert not refuted("long_chain", asks("book", "desk"), asks("book", "bed"), asks("book", "sofa"))
    assert not refuted("long_chain", asks("book", "desk"), asks("laptop", "bed"), asks("book", "sofa"))
    assert not refuted("nested_chain", asks("book", "desk"), asks("laptop", "bed"), asks("book", "sofa"))


@pytest.mark.parametrize(
    ("category", "conditions"),
    [
        ("nested", [asks("book", "desk"), asks("book", "bed")]),  # it is on the desk, where the second is asked
        ("chain", [asks("book", "desk"), asks("book", "desk")]),
        ("chain", [asks("book", "desk", "on"), asks("book", "desk", "in")]),
        ("chain", [asks("book", "chair"), asks("book", "armchair")]),  # one thing by two names
        ("chain", [asks("book", "desk"), asks("book", "bed", "near")]),
        ("chain", [asks("book", "desk", "north of"), asks("book", "bed", "north of")]),
        ("chain", [asks("book", "desk"), asks("book", "table", room=KITCHEN)]),
        ("nested_chain", [asks("book", "desk"), asks("book", "bed"), asks("laptop", "sofa")]),
    ],
)
def test_two_conditions_of_a_label_are_refuted_elsewhere(category: Category, conditions: list[Condition]) -> None:
    assert refuted(category, *conditions)
