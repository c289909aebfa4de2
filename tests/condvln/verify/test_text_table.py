"""The table of texts against reading each text in full, on rendered texts and on texts that were changed at random."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.instructions import render
from condvln.verify.phrasebook import phrasebook
from condvln.verify.text_reader import TextReading, Unreadable, read, read_in_full
from condvln.verify.text_table import TextTable
from schemas.config import WordingConfig
from schemas.program import Program
from tests.condvln.verify.test_text_reader import programs

PIECES = (
    *("there", "if not", "otherwise", "if so", "in that room", "then to the bed", "also", "but", "and", "the", "(1)"),
    *(", then to the sink", ", and stop at the lamp there", "if there's a lamp", "it isn't", "neither", "go to"),
)


def in_full(text: str, code: str) -> TextReading | None:
    """What the text says, by the reader that follows all ways to read it; None if it is not valid."""
    try:
        return read_in_full(text, code)
    except Unreadable:
        return None


def agrees(text: str, code: str) -> bool:
    """Assert that the table says what the whole reader says, or nothing; return whether it says something."""
    known = TextTable.of(phrasebook(code)).function(text)
    if known is not None:
        assert TextReading(*known) == in_full(text, code), text
    return known is not None


@given(programs(), st.integers(0, 2**32), st.sampled_from(["en", "es"]))
def test_the_table_reads_rendered_texts_as_the_whole_reader_does(program: Program, seed: int, code: str) -> None:
    text = render(program, seed, "i", WordingConfig(language=code))
    agrees(text, code)
    assert read(text, code) == in_full(text, code)


@given(programs(), st.integers(0, 2**32), st.data())
def test_the_table_never_says_what_the_whole_reader_does_not(program: Program, seed: int, data: st.DataObject) -> None:
    text = render(program, seed, "i", WordingConfig())
    tokens = re.findall(r"[^\s,.;:?]+|[,.;:?]", text)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(tokens) - 1))
        match data.draw(st.sampled_from(["drop", "repeat", "mark", "piece", "part"])):
            case "drop" if len(tokens) > 1:
                del tokens[at]
            case "repeat":  # the same name twice: names that are equal matter
                tokens[data.draw(st.integers(0, len(tokens) - 1))] = tokens[at]
            case "mark":
                tokens[at] = data.draw(st.sampled_from(",.;:?"))
            case "piece":
                tokens[at:at] = re.findall(r"[^\s,.;:?]+|[,.;:?]", data.draw(st.sampled_from(PIECES)))
            case "part":
                other = data.draw(st.integers(0, len(tokens) - 1))
                tokens[at], tokens[other] = tokens[other], tokens[at]
    agrees(re.sub(r" ([,.;:?])", r"\1", " ".join(tokens)), "en")


@pytest.mark.parametrize(
    "text",
    [
        "If there's a lamp in the kitchen, go to the sofa in the kitchen. If not, go to the sink in the kitchen.",
        "If there's a lamp near the bed, go to the sofa in the kitchen. If not, walk to the desk in the bedroom.",
    ],
)
def test_the_table_answers_plain_texts(text: str) -> None:
    """It is not green because it never answers."""
    assert agrees(text, "en")


def test_equal_names_are_not_taken_for_different_ones() -> None:
    """With other nouns the same words are valid; with the condition named twice they ask one thing two ways."""
    pattern = (
        "If there's a {a} in the kitchen, go to the sofa in the kitchen. If not, and there's a {b} in the kitchen, "
        "go to the sink in the kitchen. If not, go to the desk in the bedroom."
    )
    different, equal = pattern.format(a="lamp", b="bed"), pattern.format(a="lamp", b="lamp")
    for text in (different, equal, different):
        agrees(text, "en")
    assert in_full(different, "en") != in_full(equal, "en")
