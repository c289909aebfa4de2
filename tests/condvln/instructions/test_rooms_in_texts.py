"""Where a text names the room of a thing, says "there" or "that bedroom", or leaves the room out."""

from __future__ import annotations

import re

import pytest

from condvln.instructions import parse, reading_of, render
from condvln.instructions.text_reading import Phrase, Place
from condvln.verify.text_reader import Unreadable, read
from schemas.errors import FormatError
from schemas.program import SHAPES, Anchor, Condition, Leaf, ObjectRef, Program, Qualifier, RoomRef
from tests.condvln.instructions.hand_written import KITCHEN, LAMP, LIVING, PROGRAM, ROOM, nested_chain


def test_a_relation_asked_again_needs_no_room() -> None:
    text = (
        "If there's a lamp near the bed in the bedroom, see if there's a sink in the kitchen. If there is, go to the "
        "table in the kitchen; if not, go to the stove there. But if there's no lamp near the bed, see if there's a "
        "stool in the kitchen. If so, go to the sofa in the living room; if not, go to the plant there."
    )
    reading = parse(text)
    assert reading.conditions[0] == Phrase("lamp", ("near", ("bed",)), Place("bedroom"))
    assert parse(text.replace(" near the bed", "")).conditions[0] == Phrase("lamp", None, Place("bedroom"))
    assert parse(text.replace("no lamp near the bed", "no lamp")) == reading
    with pytest.raises(FormatError, match="names one condition as"):
        parse(text.replace("no lamp near the bed", "no lamp near the desk"))


def test_a_room_named_by_a_thing_needs_it_once() -> None:
    """ "The bedroom" is the one with the piano, where the text has no other."""
    for seed in range(40):
        text = render(PROGRAM, seed, "x")
        assert len(re.findall("(?:with|that has) the piano", text)) == 1, text
        assert parse(text) == reading_of(PROGRAM)
    two = PROGRAM.model_copy(
        update={
            "leaves": (
                PROGRAM.leaves[0],
                Leaf(
                    moves=(
                        ObjectRef(
                            object_id="s",
                            label="sink",
                            room=RoomRef(room_id="k", label="bedroom", anchor_id="t", anchor_label="toilet"),
                        ),
                    )
                ),
            )
        }
    )
    for seed in range(40):
        assert parse(render(two, seed, "x")) == reading_of(two)


@pytest.mark.parametrize(
    "text",
    [
        "If there's a lamp in the bedroom with the piano, go to the sink in the bedroom with the toilet. If not, go to "
        "the desk in the bedroom.",
        "If there's a lamp in the bedroom with the piano, go to the sink in the bedroom with the toilet, then to the "
        "sofa in the bedroom. If not, go to the desk in the kitchen.",
    ],
)
def test_a_room_that_is_not_clear_is_refused(text: str) -> None:
    with pytest.raises(FormatError):
        parse(text)
    with pytest.raises(Unreadable):
        read(text)


def test_there_is_said_only_where_no_other_room_came_between() -> None:
    """ "See if the book there …" behind stops in two rooms could mean either; so the room is named again."""
    living, office = RoomRef(room_id="l", label="living room"), RoomRef(room_id="o", label="office")
    asked = [Condition(label=label, room=room, truth=False) for label, room in (("lamp", living), ("desk", office))]
    mirror, shelf = (
        ObjectRef(object_id="m", label="mirror", room=living),
        ObjectRef(object_id="s", label="shelf", room=office),
    )
    sofa, chair = (
        ObjectRef(object_id="f", label="sofa", room=office),
        ObjectRef(object_id="c", label="chair", room=office),
    )
    program = Program(
        category="chain",
        conditions=tuple(asked),
        branches=SHAPES["chain"].branches,
        leaves=(Leaf(moves=(mirror, shelf)), Leaf(moves=(sofa,)), Leaf(moves=(chair,))),
    )
    said = {render(program, seed, "x") for seed in range(60)}
    assert len(said) > 20
    for text in said:
        assert parse(text) == reading_of(program)
        assert re.search(
            r"(?:shelf in the office|office shelf).* (?:desk in the office|office has a desk|office for a desk)",
            text,
        ), text


def test_a_thing_named_with_its_room_is_known_from_then_on() -> None:
    """Where a question named it: a listener does not look for the room of a stop in a branch that was not taken."""
    near = Qualifier(predicate="near", anchors=(Anchor(object_id="f", label="sofa"),))
    sofa = ObjectRef(object_id="f", label="sofa", room=LIVING)
    plant = ObjectRef(object_id="p", label="plant", room=LIVING, qualifier=near)
    cup, fork = (ObjectRef(object_id=x, label=x, room=KITCHEN) for x in ("cup", "fork"))
    conditions = (
        Condition(label="vase", room=LIVING, qualifier=near, truth=False),
        Condition(label="sink", room=KITCHEN, truth=False),
        Condition(label="stove", room=KITCHEN, truth=False),
    )
    program = nested_chain(conditions, [(sofa,), (cup,), (fork,), (plant, cup)])
    for seed in range(60):
        text = render(program, seed, "x")
        assert parse(text) == reading_of(program), text
        assert len(re.findall("living room (?:for|sofa|has)|(?:sofa|vase) in the living room", text)) == 2, text
        assert re.search(r"(?:to|to the) plant (?:near|close to) the sofa(?:,| and)", text), text
        assert re.search(r" if there's (?:no vase(?: and |, )|neither a vase nor )", text.lower()), text
    with pytest.raises(FormatError, match="2 rooms could be meant"):
        parse(
            "If there's a lamp in the kitchen, go to the sink in the kitchen, then to the sink in the bathroom. "
            "If not, go to the sink."
        )


def test_that_room_is_said_only_of_a_room_named_shortly_before() -> None:
    """ "That bedroom" is looked for in the words just read, not in a branch that was not taken."""
    box, toy, bed, bat = (ObjectRef(object_id=x, label=x, room=ROOM) for x in ("box", "toy", "pillow", "baseball bat"))
    conditions = (
        Condition(label="vase", room=LIVING, truth=False),
        Condition(label="sink", room=KITCHEN, truth=False),
        Condition(label="stove", room=KITCHEN, truth=False),
    )
    program = nested_chain(conditions, [(box,), (toy,), (bed,), (bat,)])
    asked = nested_chain((LAMP, *conditions[1:]), [(box,), (toy,), (bed,), (bat,)])
    for code, full, short in (
        ("en", "the bedroom with the piano", "that bedroom"),
        ("es", "dormitorio donde está el piano", "ese dormitorio"),
    ):
        met = 0
        for seed in range(20):
            text = render(program, seed, "x", code)
            assert (text.count(full), text.count(short)) == (4, 0), text
            assert parse(text, code) == reading_of(program)
            text = render(asked, seed, "x", code)
            assert parse(text, code) == reading_of(asked)
            read(text, code)
            met += short in text
            for found in re.finditer(short, text):
                before = text[: found.start()]
                assert len(re.findall("[.;:?]", before[before.rindex(full) :])) <= 2, text
        assert met > 5
    with pytest.raises(FormatError, match="0 rooms could be meant"):
        parse("If there's a lamp in the kitchen, go to the bed in that bedroom. If not, go to the sink in the kitchen.")


FAR = (
    "See if there's a lamp in the bedroom with the piano. If there isn't one, go to the sink in the kitchen. If there "
    "is, see if there's a sofa in the kitchen. If there is, go to the box there; if not, go to the toy in that bedroom."
)
BRANCH = (
    "If there's a lamp in the kitchen, go to the toy in the bedroom with the piano. If not, go to the pillow in that "
    "bedroom."
)


@pytest.mark.parametrize("text", [FAR, BRANCH])
def test_that_room_far_from_its_name_is_refused(text: str) -> None:
    with pytest.raises(FormatError, match="too far"):
        parse(text)
    assert parse(text.replace("that bedroom", "the bedroom with the piano"))


def test_the_verifier_refuses_that_room_far_from_its_name() -> None:
    read(FAR.replace("that bedroom", "the bedroom with the piano"))
    with pytest.raises(Unreadable):
        read(FAR)


def test_what_was_asked_about_a_room_is_not_placed_in_it_after_stops_elsewhere() -> None:
    """ "Check whether the plant is east of the TV" behind stops in other rooms leaves a listener to guess the room."""
    east = Qualifier(predicate="east of", anchors=(Anchor(object_id="t", label="television"),))
    near = Qualifier(predicate="near", anchors=(Anchor(object_id="f", label="sofa"),))
    conditions = (
        Condition(label="lamp", room=LIVING, qualifier=near, definite=True, truth=False),
        Condition(label="sink", room=KITCHEN, truth=False),
        Condition(label="plant", room=LIVING, qualifier=east, definite=True, truth=False),
    )
    cup, fork, knife, spoon = (ObjectRef(object_id=x, label=x, room=KITCHEN) for x in ("cup", "fork", "knife", "spoon"))
    program = nested_chain(conditions, [(cup,), (fork,), (knife,), (spoon,)])
    for seed in range(40):
        asked = r"the plant in the living room(?: is|\. if it's) east of the tv"
        assert re.search(asked, render(program, seed, "x").lower())
