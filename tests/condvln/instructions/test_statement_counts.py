"""Counts of statements about one scene, against plain loops over all rows."""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import Any

import pyarrow as pa
from hypothesis import given
from hypothesis import strategies as st

from condvln.instructions.priors import PRIORS
from condvln.instructions.statement_counts import STATEMENT, StatementCounts
from condvln.instructions.statements import anchor_key

LABELS = ("bed", "lamp", "pot + plant", "rug", "vase")
TYPES = ("bedroom", "kitchen")

labels = st.sampled_from(LABELS)
words = st.just("") | labels
anchors = words | st.tuples(labels, labels).map(anchor_key) | st.tuples(words, words).map(" + ".join)
row = st.fixed_dictionaries(
    {
        "layout": st.sampled_from(("", "one")),
        "staging": st.sampled_from(("", "a", "b")),
        "room_type": st.sampled_from(TYPES),
        "label": words,
        "predicate": st.sampled_from(("", "near", "on")),
        "anchor": anchors,
        "definite": st.booleans(),
        "n_true": st.integers(0, 3),
        "n_false": st.integers(0, 3),
    }
)


@given(st.lists(row, min_size=10, max_size=60), st.sets(st.sampled_from(TYPES)), st.sets(labels), st.booleans())
def test_they_are_those_that_plain_loops_find(
    rows: list[dict[str, Any]], types: set[str], seen: set[str], all_present: bool
) -> None:
    sayable = {"", *seen, *(anchor_key(pair) for pair in combinations(sorted(seen), 2))}
    true: Counter[Any] = Counter()
    false: Counter[Any] = Counter()
    for one in rows:
        read = one["label"] in {"", *seen} and one["anchor"] in sayable
        if one["room_type"] in types and (read or (all_present and not one["predicate"])):
            statement = tuple(one[name] for name in STATEMENT)
            true[statement] += one["n_true"]
            false[statement] += one["n_false"]
    found = StatementCounts(pa.Table.from_pylist(rows, PRIORS)).about(types, seen, all_present=all_present)
    assert found == {one: (true[one], false[one]) for one in true if true[one] + false[one]}
    assert [*found] == sorted(found)
