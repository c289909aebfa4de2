"""Texts read by hand and by machine: what they say, and that nothing doubtful is let through."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.instructions import parse, reading_of, render
from condvln.verify.phrasebook import phrasebook
from condvln.verify.phrases import Named, Phrase
from condvln.verify.text_reader import TextReading, Unreadable, read
from condvln.verify.words import words
from schemas.errors import FormatError
from schemas.program import (
    CATEGORIES,
    SHAPES,
    Anchor,
    Condition,
    Leaf,
    ObjectRef,
    Predicate,
    Program,
    Qualifier,
    RoomRef,
    anchors_of,
)

KITCHEN, BEDROOM = Named("kitchen", None), Named("bedroom", "piano")
LAMP = Phrase("lamp", ("near", ("bed",)), None)
SOFA = Phrase("sofa", None, KITCHEN)


def goes(reading: TextReading) -> dict[tuple[bool, ...], list[str]]:
    """Labels of the stops by the truths of the conditions."""
    return {
        tuple(bool(case >> k & 1) for k in range(len(reading.conditions))): [stop.label for stop in moves]
        for case, moves in enumerate(reading.moves)
    }


def test_a_room_is_named_by_a_thing_once_whatever_begins_the_thing_s_noun() -> None:
    reading = read(
        "If there's a lamp in the bedroom with the desk lamp, go to the sofa in the bedroom. If not, go to the sink "
        "in the kitchen."
    )
    assert {stop.room for stop in reading.moves[1]} == {Named("bedroom", "desk lamp")}


def test_a_relation_named_again_needs_no_room() -> None:
    text = (
        "If there's a lamp near the bed in the bedroom with the piano, see if there's a sink in the kitchen. If there "
        "is, go to the table in the kitchen. If there isn't, go to the stove there. If there's no lamp near the bed, "
        "see if there's a stool in the kitchen. If there is, go to the sofa there. If not, go to the bed there."
    )
    reading = read(text)
    assert reading.conditions[0] == Phrase("lamp", ("near", ("bed",)), BEDROOM)
    assert len(reading.conditions) == 3
    assert read(text.replace("no lamp near the bed", "no lamp")) == reading
    for other in ("no lamp near the desk", "no bed near the lamp"):
        with pytest.raises(Unreadable):
            read(text.replace("no lamp near the bed", other))


def test_a_scope_is_the_room_of_all_that_names_none() -> None:
    reading = read("In the kitchen, if there's a lamp, go to the sofa. If not, go to the desk.")
    assert reading.conditions == (Phrase("lamp", None, KITCHEN),)
    assert reading.moves[1] == (SOFA,)


@pytest.mark.parametrize("code", ["en", "es"])
def test_an_answer_can_say_the_relation_of_a_thing_to_find(code: str) -> None:
    text = {
        "en": "Find the lamp in the kitchen. If it's near the bed, go to the sofa there. If not, go to the bed there.",
        "es": "Busca la lámpara de la cocina. Si está cerca de la cama, ve al sofá de la cocina. Si no, ve a la "
        "cama de la cocina.",
    }[code]
    reading = read(text, code)
    assert reading.conditions == (Phrase("lamp", ("near", ("bed",)), KITCHEN, known=True),)
    assert reading.moves[1] == (SOFA,)
    assert parse(text, code).conditions[0].qualifier == ("near", ("bed",))
    other = text.replace("If not", "If it isn't near the desk").replace("Si no", "Si no está cerca del sofá")
    for wrong in (re.sub(r" near the bed| cerca de la cama", "", text), other):
        with pytest.raises(Unreadable):
            read(wrong, code)
        with pytest.raises(FormatError):
            parse(wrong, code)


def test_a_condition_that_decides_nothing_is_none() -> None:
    """ "There's no lamp" is about the lamp that was asked for, not another one whose question stays open."""
    reading = read(
        "Look for a lamp near the bed in the kitchen. If there's no lamp, go to the sofa there. If there is one, go to "
        "the bed there."
    )
    assert reading.conditions == (Phrase("lamp", ("near", ("bed",)), KITCHEN),)


def test_a_room_before_the_relation_of_a_stop() -> None:
    text = (
        "Si en la cocina hay una lámpara, ve al sofá de la cocina que está cerca de la cama. Si no, ve a la cama de la "
        "cocina más cercana al sofá."
    )
    stops = [stop for moves in read(text, "es").moves for stop in moves]
    assert {(stop.label, stop.qualifier, stop.room) for stop in stops} == {
        ("sofa", ("near", ("bed",)), KITCHEN),
        ("bed", ("closest to", ("sofa",)), KITCHEN),
    }
    assert {(stop.label, stop.qualifier) for leaf in parse(text, "es").leaves for stop in leaf} == {
        (stop.label, stop.qualifier) for stop in stops
    }


TREES = {
    # Text with A, B, C for claims and x, y, z, w for moves; where it goes by truths.
    "If A, x. Otherwise, y.": lambda a: "x" if a else "y",
    "If not A, y. If A, x.": lambda a: "x" if a else "y",
    "See if A. If not, y. If so, x.": lambda a: "x" if a else "y",
    "If not A, z. If there is one, see if B: if there is, x; if there isn't, y.": lambda a, b: (
        ("x" if b else "y") if a else "z"
    ),
    "See if A. If not, z. If so, see if B: if so, x; if not, y.": lambda a, b: ("x" if b else "y") if a else "z",
    "If A, x. Otherwise, if B, y. Otherwise, z.": lambda a, b: "x" if a else "y" if b else "z",
    "If A, x. If not, but B, y. If neither fits, z.": lambda a, b: "x" if a else "y" if b else "z",
    "If A, x. Otherwise, if B, y. Otherwise, if C, z. Otherwise, w.": lambda a, b, c: (
        "x" if a else "y" if b else "z" if c else "w"
    ),
    "Follow the first of these that fits. If A, x. If B, y. If C, z. If none of them fits, w.": lambda a, b, c: (
        "x" if a else "y" if b else "z" if c else "w"
    ),
    "If A, see if B: if so, x; if not, y. If not A, see if C: if so, z; if not, w.": lambda a, b, c: (
        ("x" if b else "y") if a else "z" if c else "w"
    ),
}
CLAIMS = {"A": "a lamp", "B": "a bed", "C": "a desk"}
STOPS = {"x": "sofa", "y": "sink", "z": "stool", "w": "oven"}


def worded(pattern: str) -> str:
    for letter, thing in CLAIMS.items():
        pattern = pattern.replace(f"not {letter}", f"there's no {thing.removeprefix('a ')}")
        pattern = pattern.replace(f" {letter}", f" there's {thing}")
    for letter, noun in STOPS.items():
        pattern = pattern.replace(f" {letter}.", f" go to the {noun}.").replace(f" {letter};", f" go to the {noun};")
    return pattern


@pytest.mark.parametrize("pattern", TREES)
def test_trees(pattern: str) -> None:
    reading = read(worded(pattern))
    order = [("lamp", "bed", "desk").index(phrase.label) for phrase in reading.conditions]
    for truths, stops in goes(reading).items():
        meant = [truths[order.index(k)] for k in range(len(order))]
        assert stops == [STOPS[TREES[pattern](*meant)]]


@pytest.mark.parametrize(
    ("pattern", "why"),
    [
        ("If A, see if B: if so, x; if not, y. If not, z.", "2 readings"),  # the last "if not" may be B's
        ("If A, x. If B, y. Otherwise, z.", "no reading"),  # both may hold
        ("If A, see if B: if so, x; if not, y.", "no reading"),  # nothing is said for want of A
        ("If A, x.", "no reading"),
        ("See if A. If so, x. If so, y.", "no reading"),
        ("If A, x. Otherwise, y. Otherwise, z.", "no reading"),
        ("Otherwise, x. If A, y.", "no reading"),
    ],
)
def test_what_is_doubtful_or_incomplete_is_not_a_text(pattern: str, why: str) -> None:
    with pytest.raises(Unreadable, match=why):
        read(worded(pattern))


def test_a_listener_does_not_think_back() -> None:
    """Only A can be meant by "there isn't", and yet it comes after a question about something else."""
    with pytest.raises(Unreadable, match="question before it"):
        read(
            "If there's a lamp, see if the bed is near the desk: if it is, go to the sofa; if it isn't, go to the "
            "sink. If there isn't, go to the stool."
        )


@pytest.mark.parametrize(
    "text",
    [
        "",
        ".",
        "Go to the sofa.",
        "If there's a lamp, go to the lamp near the bed near the sofa. If not, go to the desk.",
        "If there's an lamp, go to the sofa. If not, go to the desk.",
        "If there's a lamp, go to the sofa there. If not, go to the desk.",
        "If there's a lamp, go to the sofa. If it isn't, go to the desk.",
        "If the lamp is near the bed, go to the sofa. If there isn't, go to the desk.",
        "If there's a blorb, go to the sofa. If not, go to the desk.",
        "If there's a lamp, go to the sofa. If not, go to the desk",
        "If there's a lamp go to the sofa. If not, go to the desk.",
    ],
)
def test_not_a_text_of_the_language(text: str) -> None:
    with pytest.raises(Unreadable, match="parsing stops before"):
        read(text)


@pytest.mark.parametrize("place", ["", " in the kitchen", " in the bedroom with the bed"])
def test_the_message_says_where_parsing_stops(place: str) -> None:
    """It is where no clause goes on, not what was looked at ahead to find rooms that are named by an object."""
    with pytest.raises(Unreadable, match=re.escape("parsing stops before 'blorb . if not , go'")):
        read(f"If there's a lamp{place}, go to the blorb. If not, go to the desk.")


def test_many_stops_in_a_row_are_parsed_once_each() -> None:
    """A text of an export is any text: its parsing must end."""
    with pytest.raises(Unreadable):
        read("Go to the sofa" + ", then to the bed" * 100 + " if there's a lamp.")


def test_a_condition_that_is_named_twice_is_one() -> None:
    pattern = (
        "If there's a {} in the kitchen, go to the sofa in the kitchen. If not, and there's a {} in the kitchen, go to "
        "the sink in the kitchen. If not, go to the desk in the bedroom."
    )
    assert len(read(pattern.format("lamp", "bed")).conditions) == 2
    with pytest.raises(Unreadable):
        read(pattern.format("lamp", "lamp"))


# -- against the generator's own renderer and parser, which this reader knows nothing of -------------------------------

NOUNS = sorted(words().nouns)
ROOMS = sorted(words().rooms)
PREDICATES: tuple[Predicate, ...] = ("near", "above", "on", "in", "between", "south-east of", "higher than", "far from")
"""Predicates that conditions and stops may have; `COMPARED` those that only stops have."""
COMPARED: tuple[Predicate, ...] = ("bigger", "smaller", "closest to", "under")


@st.composite
def programs(draw: st.DrawFn) -> Program:
    category = draw(st.sampled_from(CATEGORIES))
    shape = SHAPES[category]
    labels = draw(st.permutations(NOUNS))
    named = iter(labels)
    rooms = [
        RoomRef(
            room_id=f"r{k}", label=label, anchor_id="p" if anchored else None, anchor_label="piano" * anchored or None
        )
        for k, (label, anchored) in enumerate(
            zip(draw(st.permutations(ROOMS))[:3], draw(st.tuples(*[st.booleans()] * 3)), strict=True)
        )
    ]
    some_room = st.sampled_from(rooms)

    def qualifier(predicates: Sequence[Predicate]) -> Qualifier | None:
        if not draw(st.booleans()):
            return None
        predicate = draw(st.sampled_from(predicates))
        anchors = tuple(Anchor(object_id=f"a{k}", label=next(named)) for k in range(anchors_of(predicate)))
        return Qualifier(predicate=predicate, anchors=anchors)

    def stop(k: int) -> ObjectRef:
        told_apart = qualifier((*PREDICATES, *COMPARED))
        return ObjectRef(object_id=f"o{k}", label=next(named), room=draw(some_room), qualifier=told_apart)

    def condition(truth: bool) -> Condition:
        relation = qualifier(PREDICATES)
        return Condition(
            label=next(named),
            room=draw(some_room),
            qualifier=relation,
            definite=relation is not None and draw(st.booleans()),
            truth=truth,
            witnesses=("w",) * truth,
        )

    truths = draw(st.tuples(*[st.booleans()] * len(shape.branches)))
    return Program(
        category=category,
        conditions=tuple(condition(truth) for truth in truths),
        branches=shape.branches,
        leaves=tuple(
            Leaf(moves=tuple(stop(10 * k + j) for j in range(draw(st.integers(1, 3))))) for k in range(shape.leaves)
        ),
    )


@pytest.mark.costly
@settings(max_examples=150)
@given(programs(), st.integers(0, 2**32))
def test_every_rendered_text_reads_as_its_program(program: Program, seed: int) -> None:
    text = render(program, seed, "some-id")
    reading = read(text)
    assert parse(text) == reading_of(program)

    def phrase(named: Condition | ObjectRef) -> Phrase:
        qualifier = named.qualifier and (named.qualifier.predicate, named.qualifier.anchor_labels)
        definite = isinstance(named, Condition) and named.definite
        return Phrase(named.label, qualifier, Named(named.room.label, named.room.anchor_label), definite)

    said = [phrase(condition) for condition in program.conditions]
    assert sorted(map(str, reading.conditions)) == sorted(map(str, said))
    for truths in product((True, False), repeat=len(said)):
        case = sum(1 << reading.conditions.index(p) for p, truth in zip(said, truths, strict=True) if truth)
        assert reading.moves[case] == tuple(map(phrase, program.leaves[program.gold_leaf(truths)].moves))


ROOMS_APART = [
    # The same words mean another room, or nothing, by what comes before them.
    "If there's a lamp in the bedroom with the piano, go to the sofa in that bedroom. If not, go to the bed there.",
    "If there's a lamp in the bedroom with the desk, go to the sofa in that bedroom. If not, go to the bed there.",
    "If there's a lamp in the kitchen, go to the sofa in that bedroom. If not, go to the bed there.",
    "If there's a lamp in the bedroom with the piano, go to the sofa in the bedroom. If not, go to the bed there.",
    "If there's a lamp in the bedroom, go to the sofa in the bedroom. If not, go to the bed there.",
    "If there's a lamp in the bedroom with the piano, see if there's a sink in the kitchen: if so, go to the oven in "
    "the kitchen; if not, go to the stove in the kitchen. If there's no lamp, go to the bed in that bedroom.",
    "If there's a lamp in the bedroom with the piano, go to the oven in the kitchen. If not, go to the bed in that "
    "bedroom.",
    "If there's a lamp in the bedroom with the piano, go to the oven in the kitchen. If not, see if there's a sink in "
    "the kitchen. If there is, go to the oven in the kitchen. If there isn't, go to the bed in that bedroom.",
    "In the kitchen, if there's a lamp, go to the sofa. If not, go to the bed.",
    "In the bedroom, if there's a lamp, go to the sofa. If not, go to the bed.",
    "If there's a lamp, go to the sofa. If not, go to the bed.",
    "See if, in the bedroom with the piano, the lamp is near the bed. If it is, go to the sofa. If not, go to the bed.",
    "See if, in the bedroom with the desk, the lamp is near the bed. If it is, go to the sofa. If not, go to the bed.",
]


def found_in(text: str) -> TextReading | str:
    try:
        return read(text)
    except Unreadable as fault:
        return str(fault)


def test_the_same_words_mean_what_the_words_before_them_say() -> None:
    found = [found_in(text) for text in ROOMS_APART]
    assert len({reading for reading in found if isinstance(reading, TextReading)}) == 8
    assert [found_in(text) for text in ROOMS_APART[::-1]] == found[::-1]


def test_every_noun_of_the_phrasebook_is_one_label() -> None:
    """A noun that stood for two labels would give every text that has it two readings."""
    book = phrasebook()
    for label in NOUNS:
        node = book.tree
        for token in book.tokens(words().nouns[label][0]):
            node = node[token]
        assert [value for kind, value, _ in node[""] if kind == "noun"] == [label]


def test_a_room_is_set_apart_by_the_longest_noun() -> None:
    """ "The bedroom with the table lamp" is one room, not also one with a table."""
    text = "If there's a box in the bedroom with the table lamp, walk to the mirror in the bedroom. If not, walk"
    text += " to the sofa in the bedroom."
    reading = read(text, "en")
    assert {stop.room for moves in reading.moves for stop in moves if stop.label == "mirror"} == {
        Named("bedroom", "table lamp")
    }
