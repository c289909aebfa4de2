"""What the parts of a program have to do with each other, and which relations are worth asking."""

from __future__ import annotations

import pytest

from condvln.instructions.degeneracy import true_shares
from condvln.instructions.programs import excess_of_sent, oddness
from condvln.instructions.statements import _suited
from schemas.program import SHAPES, Anchor, Condition, Leaf, ObjectRef, Predicate, Program, Qualifier, RoomRef

STUDY = RoomRef(room_id="study", label="study")


def program(
    then: str,
    otherwise: str,
    *,
    asked: str = "book",
    predicate: Predicate = "on",
    anchor: str = "desk",
    stop: str | None = None,
    truth: bool = True,
) -> Program:
    """Asks whether the book is on the anchor; `stop` comes before the goal that one is sent to if it is."""
    on = Qualifier(predicate=predicate, anchors=(Anchor(object_id=anchor, label=anchor),))
    condition = Condition(label=asked, room=STUDY, qualifier=on, truth=truth, witnesses=("book",) if truth else ())
    moves = [[ObjectRef(object_id=x, label=x, room=STUDY) for x in leaf if x] for leaf in ((stop, then), (otherwise,))]
    leaves = tuple(Leaf(moves=tuple(leaf)) for leaf in moves)
    return Program(category="simple", conditions=(condition,), branches=SHAPES["simple"].branches, leaves=leaves)


@pytest.mark.parametrize(
    ("asked", "odd"),
    [
        (program("desk", "bed"), 0),  # where it is, else where such a thing may lie
        (program("desk", "plate"), 3),
        (program("desk", "desk lamp"), 2),  # goes with a book, and is no place for it
        (program("sofa", "bed"), 3),  # it is on the desk
        (program("bed", "desk"), 6),  # it isn't there
        (program("desk", "bed", stop="microwave"), 2),
        (program("desk", "bed", stop="desk lamp"), 1),  # a detour, to what goes with the desk
        (program("toilet", "bed", anchor="toilet"), 2),  # nobody asks whether the book is on the toilet
        (program("desk", "bed", asked="painting"), 2),  # nobody looks for a painting
        (program("desk", "bed", predicate="near"), 1),
        (program("desk", "bed", predicate="north of"), 2),
    ],
)
def test_what_has_nothing_to_do_with_the_question_is_odd(asked: Program, odd: int) -> None:
    assert oddness(asked) == odd
    opposite = asked.model_copy(update={"conditions": (asked.conditions[0].model_copy(update={"truth": False}),)})
    assert oddness(opposite) == odd, "it is told by what is said, not by what is true"


def test_what_is_in_a_room_is_gone_to_there() -> None:
    here, there = (
        program("desk", "bed").model_copy(
            update={
                "conditions": (Condition(label="book", room=room, truth=True, witnesses=("book",)),),
            }
        )
        for room in (STUDY, RoomRef(room_id="hall", label="hallway"))
    )
    assert (oddness(here), oddness(there)) == (2, 3), "and whether it is in a room decides little"


def test_the_next_place_to_look_is_in_the_same_room() -> None:
    near = program("desk", "bed")
    then, otherwise = near.leaves
    away = otherwise.moves[0].model_copy(update={"room": RoomRef(room_id="hall", label="hallway")})
    far = near.model_copy(update={"leaves": (then, Leaf(moves=(away,)))})
    assert (oddness(near), oddness(far)) == (0, 1)


def test_one_thing_looked_for_in_two_places_is_one_errand() -> None:
    def chain(second: str) -> int:
        at = [
            Condition(label=label, room=STUDY, truth=False, qualifier=Qualifier(predicate="on", anchors=(anchor,)))
            for label, anchor in zip(
                ("book", second), (Anchor(object_id=x, label=x) for x in ("desk", "bed")), strict=True
            )
        ]
        leaves = [Leaf(moves=(ObjectRef(object_id=x, label=x, room=STUDY),)) for x in ("desk", "bed", "sofa")]
        branches = SHAPES["chain"].branches
        return oddness(Program(category="chain", conditions=tuple(at), branches=branches, leaves=tuple(leaves)))

    assert chain("book") == 0 < chain("towel")


@pytest.mark.parametrize("truth", [True, False])
def test_one_is_sent_to_the_anchor_or_not(truth: bool) -> None:
    assert excess_of_sent(program("desk", "sofa", truth=truth)) == truth - 0.5
    assert excess_of_sent(program("sofa", "desk", truth=truth)) == 0


def test_a_condition_is_true_by_chance_as_often_as_its_leaves_are_gold() -> None:
    assert true_shares("simple") == (1 / 2,)
    assert true_shares("chain") == pytest.approx((1 / 3, 1 / 2))
    assert true_shares("nested") == pytest.approx((2 / 3, 1 / 2))
    # The second is a coin where the first decides, and true for one of the three leaves behind it.
    assert true_shares("long_chain") == pytest.approx((1 / 4, 1 / 4 / 2 + 1 / 4, 2 / 4 / 2 + 1 / 4))


def test_a_relation_is_asked_where_the_thing_serves_a_purpose() -> None:
    labels, own = ("book", "toilet", "no such label"), ("desk", "toilet", "no such place")
    assert _suited(labels, own, anywhere=False).tolist() == [
        [True, False, True],
        [False, False, True],
        [True, True, True],
    ]
    assert _suited(("dresser",), own, anywhere=False).tolist() == [[False, False, True]]
    assert _suited(("dresser",), own, anywhere=True).tolist() == [[True, True, True]]
