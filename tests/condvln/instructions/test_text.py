"""Every text reads back to its program, in one way only; and texts read well by rules that can be checked."""

from __future__ import annotations

import re
from collections import Counter

import pytest
from lark import Tree

from condvln.instructions import (
    instruction_id,
    names_compass,
    oracle_linear,
    parse,
    reading_of,
    render,
    render_moves,
    with_preamble,
)
from condvln.instructions.language import LANGUAGES, language
from condvln.instructions.parsing import parser, reading_from_tree
from condvln.instructions.reading import Phrase, Place
from condvln.instructions.rendering import HEADINGS
from condvln.scene import Scene
from schemas.errors import FormatError
from schemas.program import SHAPES, Condition, Leaf, ObjectRef, Program, Qualifier, RoomRef


@pytest.fixture(scope="module", params=LANGUAGES)
def code(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def texts(sampled, code: str) -> list[tuple[Scene, Program, str]]:
    found = []
    for scene, _, _, programs in sampled:
        for program in programs:
            name = instruction_id(scene.family, scene.scene_id, program)
            found.append((scene, program, render(program, 0, name, code)))
    return found


def test_texts_read_back_to_their_programs(texts, code: str) -> None:
    for _, program, text in texts:
        assert parse(text, code) == reading_of(program), text


def test_headings_read_back_too(texts, code: str) -> None:
    for k, (_, program, text) in enumerate(texts[::9]):
        whole = with_preamble(text, 45.0 * (k % 8), code)
        assert parse(whole, code) == reading_of(program, heading=HEADINGS[k % 8])


def assert_one_reading(texts, code: str) -> None:
    words = language(code)
    for _, program, text in texts:
        tree = parser(code, "earley").parse(words.expanded(text.lower()))
        assert not list(tree.find_data("_ambig")), text
        assert isinstance(tree, Tree)
        assert reading_from_tree(tree, words) == reading_of(program)


def test_there_is_no_second_reading(texts, code: str) -> None:
    assert_one_reading(texts[::29], code)


@pytest.mark.soak
def test_there_is_no_second_reading_of_thousands(sampled, code: str) -> None:
    texts = [
        (scene, program, render(program, seed, "soak", code))
        for seed in range(4)
        for scene, _, _, programs in sampled
        for program in programs
    ]
    assert len(texts) >= 5000
    assert_one_reading(texts, code)


def test_texts_are_clean(texts) -> None:
    for _, _, text in texts:
        assert re.fullmatch(r"[^\W_][\w\s,;:.'-]*\.", text), text
        assert not re.search(r"\s\s|\s[,;:.]|[,;:.]{2}|_", text), text
        assert all(sentence[0].isupper() for sentence in text.split(". ")), text


def test_english_articles(texts, code: str) -> None:
    if code != "en":
        pytest.skip("a rule of English")
    for _, _, text in texts:
        for article, start in re.findall(r"\b(an?) (\w)", text.lower()):
            assert (article == "an") == (start in "aeiou"), text


def test_wording_is_decided_by_seed_and_id(texts, code: str) -> None:
    _, program, _ = texts[0]
    assert render(program, 0, "a", code) == render(program, 0, "a", code)
    assert len({render(program, seed, "a", code) for seed in range(20)}) > 15
    assert len({render(program, 0, str(name), code) for name in range(20)}) > 15


def test_rooms_are_named_where_there_are_several_and_only_there(texts, code: str) -> None:
    for scene, _, text in texts:
        reading = parse(text, code)
        named = [p.room for p in reading.conditions] + [p.room for leaf in reading.leaves for p in leaf]
        assert all((room is None) == scene.single_room for room in named)


def test_compass_words_are_noticed(texts, code: str) -> None:
    words = language(code)
    directions = "|".join(sorted(map(re.escape, words.directions.values()), key=len, reverse=True))
    for _, program, text in texts:
        assert names_compass(program) == bool(re.search(rf"\b(?:{directions})\b", words.expanded(text.lower()))), text


def test_texts_of_one_program_differ_in_every_slot(sampled, code: str) -> None:
    programs = [p for _, _, _, programs in sampled for p in programs]
    used: Counter[str] = Counter()
    for k, program in enumerate(programs):
        text = render(program, k, "variety", code).lower()
        for name, phrases in language(code).slots.items():
            used.update((name, p) for p in phrases.texts if p.split("{")[0].strip(" ,") in text)
    unseen = [
        (name, p)
        for name, phrases in language(code).slots.items()
        for p in phrases.texts
        if name != "facing" and not used[name, p]
    ]
    assert unseen == []


def test_an_oracle_linear_twin_keeps_the_stops_in_order(texts, code: str) -> None:
    for _, program, text in texts[::7]:
        moves = oracle_linear(program)
        assert moves == program.leaves[program.gold_leaf()].moves
        linear = render_moves(moves, 0, "x", code)
        nouns = [language(code).nouns[move.label].text for move in moves]
        places = [re.search(rf"\b{re.escape(noun)}\b", linear.lower()) for noun in nouns]
        assert all(places)
        assert len(linear.split()) < len(text.split())


ROOM = RoomRef(room_id="r", label="bedroom", anchor_id="p", anchor_label="piano")
LAMP = Condition(
    label="lamp",
    room=ROOM,
    qualifier=Qualifier(predicate="north-east of", anchor_id="b", anchor_label="bed"),
    truth=False,
)
PROGRAM = Program(
    category="simple",
    conditions=(LAMP,),
    branches=SHAPES["simple"].branches,
    leaves=(
        Leaf(
            moves=(
                ObjectRef(object_id="a", label="alarm clock", room=ROOM),
                ObjectRef(object_id="d", label="desk", room=ROOM),
            )
        ),
        Leaf(moves=(ObjectRef(object_id="s", label="sink", room=RoomRef(room_id="k", label="kitchen")),)),
    ),
)


@pytest.mark.parametrize(
    "text",
    [
        "If there is a lamp north-east of the bed in the bedroom with the piano, go to the alarm clock in the bedroom "
        "with the piano, then stop at the desk in the same room; otherwise, go to the sink in the kitchen.",
        "Check whether the bedroom that has the piano holds a lamp located north-east of the bed. If not, head to the "
        "sink in the kitchen. If so, first go to the alarm clock in the bedroom containing the piano, and stop at the "
        "desk in the bedroom with the piano.",
        "If there's no lamp north-east of the bed in the bedroom with the piano, walk to the sink in the kitchen. If "
        "there is such a lamp, go to the alarm clock in the bedroom with the piano, and end at the desk inside the "
        "same room.",
    ],
)
def test_texts_written_by_hand(text: str) -> None:
    assert parse(text) == reading_of(PROGRAM)
    assert parse("You are facing west. " + text).heading == "west"
    assert parse("  ".join(text.upper().split())) == reading_of(PROGRAM)


def test_a_reading_in_full() -> None:
    reading = parse(render(PROGRAM, 0, "x"))
    piano_room = Place("bedroom", "piano")
    assert reading.conditions == (Phrase("lamp", ("north-east of", "bed"), piano_room),)
    assert reading.leaves == (
        (Phrase("alarm clock", None, piano_room), Phrase("desk", None, piano_room)),
        (Phrase("sink", None, Place("kitchen")),),
    )


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "can't be read"),
        ("Go to the sofa.", "can't be read"),
        ("If there is a lamp, go to the sofa.", "can't be read"),
        ("If there is a lamp, go to the gizmo; otherwise, go to the bed.", "can't be read"),
        ("If there is a lamp, go to the sofa; otherwise, go to the bed. Otherwise, go to the desk.", "can't be read"),
        ("If there is a lamp, go to the sofa; if there is no chair, go to the bed.", "names one condition as"),
        ("If there is a lamp, go to the sofa; if there is no such chair, go to the bed.", "does not point"),
        ("If there is a lamp, go to the sofa in the same room; otherwise, go to the bed.", "first stop"),
    ],
)
def test_what_is_no_instruction_is_refused(text: str, what: str) -> None:
    with pytest.raises(FormatError, match=what):
        parse(text)
