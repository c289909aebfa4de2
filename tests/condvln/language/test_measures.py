"""Counts against counts by hand."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.language.report import (
    BANNED,
    COMPASS_WORDS,
    EGOCENTRIC_WORDS,
    banned_in,
    distinct,
    masked,
    pieces,
    sentences,
    words,
)

TEXT = "You're facing north-east. Is the TV by the sofa? If so, go there (1); if not, stop."


def test_words_and_sentences() -> None:
    said = "you're facing north-east is the tv by the sofa if so go there 1 if not stop"
    assert words(TEXT) == said.split()
    assert sentences(TEXT) == [
        "You're facing north-east.",
        "Is the TV by the sofa?",
        "If so, go there (1); if not, stop.",
    ]
    assert sentences("Go. . Stop") == ["Go.", "Stop"]
    assert words("¿Hay un sillón?") == ["hay", "un", "sillón"]


def test_nouns_are_masked_whole_and_in_the_plural() -> None:
    assert masked("Walk to the coffee tables in the living room.") == "walk to the _ in the _."
    assert masked("The sofas and lampshade") == "the _ and lampshade"
    assert words(masked("the bed")) == ["the", "_"]


def test_distinct_by_hand() -> None:
    piece = [["go", "to", "the", "bed"], ["go", "to", "the", "sofa"]]
    # go to, to the, the bed | go to, to the, the sofa: four of six differ.
    assert distinct(piece, 1) == 5 / 8
    assert distinct(piece, 2) == 4 / 6
    assert distinct(piece, 3) == 3 / 4
    assert distinct(piece, 4) == 1.0
    assert math.isnan(distinct(piece, 5))


@given(
    st.lists(st.lists(st.sampled_from(["go", "to", "bed", "if"]), max_size=9).map(" ".join), max_size=12), st.randoms()
)
def test_pieces_are_of_one_size_and_know_no_order(texts: list[str], random) -> None:
    found = list(pieces(texts, 10))
    total = sum(len(words(text)) for text in texts)
    # What a piece cuts off a text is not taken up by the next.
    assert len(found) <= max(1, total // 10)
    assert all(sum(map(len, piece)) == 10 for piece in found) or len(found) == 1
    if total >= 10:
        assert found
    random.shuffle(texts)
    assert list(pieces(texts, 10)) == found


@pytest.mark.parametrize(
    ("text", "compass", "egocentric"),
    [
        ("You're facing north-west.", True, False),
        ("Turn left at the bed.", False, True),
        ("Go straight to the sofa south of the bed.", True, True),
        ("Go to the northern lights poster, then the bright lamp.", False, False),
        ("Miras hacia el suroeste.", True, False),
        ("Gira a la izquierda.", False, True),
    ],
)
def test_directions(text: str, compass: bool, egocentric: bool) -> None:
    assert bool(COMPASS_WORDS.search(text.lower())) == compass
    assert bool(EGOCENTRIC_WORDS.search(text.lower())) == egocentric


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("If there's a lamp, go to the bed. Otherwise, go to the sofa.", []),
        ("If that is so, go on.", ["after a no: if that is so"]),
        ("Provided that there is such a bottle, or else go.", ["odd ifs", "or else, failing that", "such a"]),
        ("Go to the lamp situated lower down.", ["situated, located", "up above, lower down"]),
        ("Is the bowl lower down than the picture?", []),
        (
            "All of this is about the kitchen. It happens to have a bed.",
            ["all of this is about", "happens to, one can find"],
        ),
    ],
)
def test_phrases_to_avoid(text: str, names: list[str]) -> None:
    assert sorted(banned_in(text)) == sorted(names)
    assert set(names) <= set(BANNED)
