"""Clauses: the words of each condition and leaf, wherever the text is in a grammar of ours."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.explorer.episode import LANGUAGES, _expanded, clauses
from condvln.instructions.language import language
from condvln.instructions.rendering import render
from schemas.program import CATEGORIES, SHAPES, Category, Condition, Leaf, ObjectRef, Program, RoomRef
from tests.condvln.explorer.made_rows import made_manifest

LABELS = ("sofa", "bed", "sink", "desk", "plant", "stove", "lamp", "wardrobe")


def program(category: Category) -> Program:
    kitchen, bedroom = RoomRef(room_id="k", label="kitchen"), RoomRef(room_id="b", label="bedroom")
    shape = SHAPES[category]
    conditions = tuple(
        Condition(label=LABELS[k], room=kitchen, truth=bool(k % 2), witnesses=("w",) if k % 2 else ())
        for k in range(len(shape.branches))
    )
    leaves = tuple(
        Leaf(moves=(ObjectRef(object_id=f"o{k}", label=LABELS[4 + k], room=bedroom),)) for k in range(shape.leaves)
    )
    return Program(category=category, conditions=conditions, branches=shape.branches, leaves=leaves)


@pytest.mark.parametrize("code", LANGUAGES)
@pytest.mark.parametrize("category", CATEGORIES)
@pytest.mark.parametrize("seed", range(4))
def test_each_condition_and_leaf_has_its_words(category: Category, seed: int, code: str) -> None:
    made = program(category)
    text = render(made, seed, f"i{seed}", code)
    found = clauses(text, made)
    assert {condition for _, _, condition, _ in found} - {-1} == set(range(len(made.conditions)))
    assert [leaf for _, _, _, leaf in sorted(found, key=lambda c: c[3]) if leaf >= 0] == [*range(len(made.leaves))]
    assert all(0 <= start < end <= len(text) for start, end, _, _ in found)
    assert all(one[1] <= other[0] for one, other in pairwise(found)), "clauses overlap"
    named = language(code).nouns
    for start, end, _, leaf in found:
        assert text[start:end] == text[start:end].strip()
        if leaf >= 0:
            assert named[made.leaves[leaf].goal.label].text in text[start:end]
    first = {condition: text[start:end].lower() for start, end, condition, _ in reversed(found) if condition >= 0}
    assert all(named[made.conditions[k].label].text in words for k, words in first.items())


@pytest.mark.parametrize("code", LANGUAGES)
def test_each_condition_of_a_snapshot_has_its_words(code: str) -> None:
    contracted = 0
    for row in made_manifest(12):
        made = Program.model_validate(row["program"])
        text = render(made, 1, row["instruction_id"], code)
        found = clauses(text, made)
        assert {condition for _, _, condition, _ in found} - {-1} == set(range(len(made.conditions))), text
        assert {leaf for _, _, _, leaf in found} - {-1} == set(range(len(made.leaves))), text
        assert all(one[1] <= other[0] for one, other in pairwise(found)), text
        words = re.compile(r"\b(del|al)\b")
        for start, end, _, _ in found:
            # No clause begins or ends inside a word.
            assert not text[max(0, start - 1) : start + 1].isalpha() or start == 0, text
            assert not text[end - 1 : end + 1].isalpha() or end == len(text), text
            contracted += len(words.findall(text[start:end]))
    assert (contracted > 0) is (code == "es")


@given(st.lists(st.sampled_from(["del", "al", "de", "el", "a", "la", "delta", "sal", ",", "é"]), max_size=12))
def test_contractions_are_expanded_as_the_reader_does(pieces: list[str]) -> None:
    text = " ".join(pieces)
    whole, places = _expanded(text, language("es"))
    assert whole == language("es").expanded(text)
    assert len(places) == len(whole)
    assert "".join(text[start:end] for start, end in dict.fromkeys(places)) == text


def test_other_texts_have_no_clauses() -> None:
    assert clauses("Turn İ around and <b>leave</b>.", program("simple")) == []
