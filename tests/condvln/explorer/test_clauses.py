"""Clauses: the words of each condition and leaf, wherever the text is in a grammar of ours."""

from __future__ import annotations

from itertools import pairwise

import pytest

from condvln.explorer.clauses import clauses
from condvln.instructions.rendering import render
from schemas.program import CATEGORIES, SHAPES, Category, Condition, Leaf, ObjectRef, Program, RoomRef

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


@pytest.mark.parametrize("category", CATEGORIES)
@pytest.mark.parametrize("seed", range(4))
def test_each_condition_and_leaf_has_its_words(category: Category, seed: int) -> None:
    made = program(category)
    text = render(made, seed, f"i{seed}")
    found = clauses(text, made)
    assert {condition for _, _, condition, _ in found} - {-1} == set(range(len(made.conditions)))
    assert [leaf for _, _, _, leaf in sorted(found, key=lambda c: c[3]) if leaf >= 0] == [*range(len(made.leaves))]
    assert all(0 <= start < end <= len(text) for start, end, _, _ in found)
    assert all(one[1] <= other[0] for one, other in pairwise(found)), "clauses overlap"
    for start, end, _, leaf in found:
        if leaf >= 0:
            assert made.leaves[leaf].goal.label in text[start:end]
    first = {condition: text[start:end] for start, end, condition, _ in reversed(found) if condition >= 0}
    assert all(made.conditions[k].label in words for k, words in first.items())


def test_other_texts_have_no_clauses() -> None:
    assert clauses("Turn İ around and <b>leave</b>.", program("simple")) == []
