"""Examples of rejections are conditions that the rule rejects, and each rule has words."""

from __future__ import annotations

import pytest

from condvln.episodes.candidates import REASONS as PLACING
from condvln.explorer.rejected import CLASHES, clash_examples, program_example, rule_text
from condvln.instructions.degeneracy import REASONS as DRAWING
from condvln.instructions.degeneracy import RULES
from schemas.program import Branch, Condition, Leaf, ObjectRef, Program, RoomRef

KITCHEN, BEDROOM = RoomRef(room_id="k", label="kitchen"), RoomRef(room_id="b", label="bedroom")


def stop(label: str, room: RoomRef) -> ObjectRef:
    return ObjectRef(object_id=f"{label}-1", label=label, room=room)


def program(asked: str, room: RoomRef, *goals: tuple[str, RoomRef]) -> Program:
    condition = Condition(label=asked, room=room, truth=True, witnesses=("w",))
    return Program(
        category="simple",
        conditions=(condition,),
        branches=(Branch(condition=0, then=-1, otherwise=-2),),
        leaves=tuple(Leaf(moves=(stop(label, where),)) for label, where in goals),
    )


def test_a_condition_about_a_stop_is_the_example_of_its_rule() -> None:
    programs = {
        "one": program("lamp", KITCHEN, ("sofa", BEDROOM), ("sink", KITCHEN)),
        "two": program("sink", KITCHEN, ("bed", BEDROOM), ("oven", KITCHEN)),
    }
    found = clash_examples(programs, [*RULES])
    assert found["names_stop"] == {
        "example": "sink in kitchen (k), beside the stops sofa (sofa-1), sink (sink-1)",
        "objects": ["sofa-1", "sink-1"],
    }
    assert clash_examples(programs, ["no_waypoint"]) == {}
    assert clash_examples({}, [*RULES]) == {}


def test_a_rejected_candidate_is_told_in_words() -> None:
    found = program_example(program("lamp", KITCHEN, ("sofa", BEDROOM), ("sink", KITCHEN)))
    assert found["example"] == "simple: asks for lamp in kitchen (k); leaf 0: sofa (sofa-1); leaf 1: sink (sink-1)"
    assert found["objects"] == ["sofa-1", "sink-1"]


@pytest.mark.parametrize(("stage", "reasons"), [("programs", DRAWING), ("episodes", PLACING)])
def test_every_reason_has_its_rule_in_words(stage: str, reasons: dict[str, str]) -> None:
    assert all(rule_text(stage, reason) for reason in reasons)
    assert rule_text(stage, "no such reason") == ""


def test_the_rules_of_clashes_are_rules() -> None:
    assert set(RULES) >= CLASHES
