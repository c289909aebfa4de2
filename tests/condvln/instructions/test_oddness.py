"""What the parts of a program have to do with each other, and which relations are worth asking."""

from __future__ import annotations

import pytest

from condvln.instructions.programs import oddness, truths_sent_to
from condvln.instructions.statements import _suited
from schemas.program import SHAPES, Anchor, Condition, Leaf, ObjectRef, Program, Qualifier, RoomRef

STUDY = RoomRef(room_id="study", label="study")


def program(then: str, otherwise: str, *, anchor: str = "desk", stop: str | None = None, truth: bool = True) -> Program:
    """Asks whether the book is on the anchor; `stop` comes before the goal that one is sent to if it is."""
    on = Qualifier(predicate="on", anchors=(Anchor(object_id=anchor, label=anchor),))
    asked = Condition(label="book", room=STUDY, qualifier=on, truth=truth, witnesses=("book",) if truth else ())
    moves = [[ObjectRef(object_id=x, label=x, room=STUDY) for x in leaf if x] for leaf in ((stop, then), (otherwise,))]
    leaves = tuple(Leaf(moves=tuple(leaf)) for leaf in moves)
    return Program(category="simple", conditions=(asked,), branches=SHAPES["simple"].branches, leaves=leaves)


@pytest.mark.parametrize(
    ("asked", "odd"),
    [
        (program("desk", "bookshelf"), 0),  # where it is, else where such a thing may be
        (program("sofa", "bookshelf"), 1),  # a place for books, though it is on the desk
        (program("desk", "desk lamp"), 1),  # goes with a book, and is no place for it
        (program("desk", "toilet"), 2),
        (program("toilet", "bookshelf"), 3),
        (program("bookshelf", "desk"), 3),  # it isn't there
        (program("desk", "bookshelf", stop="microwave"), 1),
        (program("desk", "bookshelf", stop="desk lamp"), 0),
        (program("toilet", "bookshelf", anchor="toilet"), 2),  # nobody asks whether the book is on the toilet
    ],
)
def test_what_has_nothing_to_do_with_the_question_is_odd(asked: Program, odd: int) -> None:
    assert oddness(asked) == odd
    opposite = asked.model_copy(update={"conditions": (asked.conditions[0].model_copy(update={"truth": False}),)})
    assert oddness(opposite) == odd, "it is told by what is said, not by what is true"


@pytest.mark.parametrize("truth", [True, False])
def test_one_is_sent_to_the_anchor_or_not(truth: bool) -> None:
    assert truths_sent_to(program("desk", "sofa", truth=truth)) == [truth]
    assert truths_sent_to(program("sofa", "desk", truth=truth)) == []


def test_a_relation_is_asked_where_the_thing_serves_a_purpose() -> None:
    labels, own = ("book", "toilet", "no such label"), ("desk", "toilet", "no such place")
    assert _suited(labels, own, anywhere=False).tolist() == [
        [True, False, True],
        [False, False, True],
        [True, True, True],
    ]
    assert _suited(("dresser",), own, anywhere=False).tolist() == [[False, False, True]]
    assert _suited(("dresser",), own, anywhere=True).tolist() == [[True, True, True]]
