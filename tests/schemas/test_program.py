"""Programs: the six shapes, their gold leaves by brute force, and what the model refuses."""

from __future__ import annotations

from itertools import product

import pytest
from pydantic import ValidationError

from schemas.program import CATEGORIES, SHAPES, Category, Condition, Leaf, ObjectRef, Program, RoomRef

ROOM = RoomRef(room_id="r", label="kitchen")


def program(category: Category, truths: tuple[bool, ...]) -> Program:
    shape = SHAPES[category]
    return Program(
        category=category,
        conditions=tuple(
            Condition(label=f"c{k}", room=ROOM, truth=t, witnesses=("w",) if t else ()) for k, t in enumerate(truths)
        ),
        branches=shape.branches,
        leaves=tuple(
            Leaf(moves=(ObjectRef(object_id=f"o{k}", label=f"l{k}", room=ROOM),)) for k in range(shape.leaves)
        ),
    )


# The table of the categories, each tree written out as Python: leaves in reading order x, y, z, w.
TREES = {
    "simple": lambda a: 0 if a else 1,
    "nested": lambda a, b: (0 if b else 1) if a else 2,
    "deep_nested": lambda a, b, c: ((0 if c else 1) if b else 2) if a else 3,
    "chain": lambda a, b: 0 if a else (1 if b else 2),
    "long_chain": lambda a, b, c: 0 if a else (1 if b else (2 if c else 3)),
    "nested_chain": lambda a, b, c: (0 if b else 1) if a else (2 if c else 3),
}
SIZES = {  # depth, chain, leaves
    "simple": (1, 1, 2),
    "nested": (2, 1, 3),
    "deep_nested": (3, 1, 4),
    "chain": (1, 2, 3),
    "long_chain": (1, 3, 4),
    "nested_chain": (2, 2, 4),
}


@pytest.mark.parametrize("category", CATEGORIES)
def test_gold_leaf_is_the_tree_s(category: Category) -> None:
    shape = SHAPES[category]
    assert (shape.depth, shape.chain, shape.leaves) == SIZES[category]
    reached = set()
    for truths in product([True, False], repeat=len(shape.branches)):
        made = program(category, truths)
        assert made.gold_leaf() == TREES[category](*truths)
        asked, leaf = made.route()
        assert asked[0] == 0
        assert len(asked) == len(set(asked))
        reached.add(leaf)
    assert reached == set(range(shape.leaves))


@pytest.mark.parametrize("category", CATEGORIES)
def test_each_condition_decides_somewhere(category: Category) -> None:
    n = len(SHAPES[category].branches)
    made = program(category, (True,) * n)
    for k in range(n):
        assert any(
            made.gold_leaf([*t[:k], True, *t[k + 1 :]]) != made.gold_leaf([*t[:k], False, *t[k + 1 :]])
            for t in product([True, False], repeat=n)
        )


def test_round_trip_and_refusals() -> None:
    made = program("nested", (True, False))
    assert Program.model_validate_json(made.model_dump_json()) == made
    with pytest.raises(ValidationError, match="witnesses"):
        Condition(label="x", room=ROOM, truth=False, witnesses=("w",))
    with pytest.raises(ValidationError, match="category"):
        Program(category="chain", conditions=made.conditions, branches=made.branches, leaves=made.leaves)
