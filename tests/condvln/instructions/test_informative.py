"""Counts over rooms keep statements and labels from telling the truth."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.instructions.balance import informative_weights, label_weights
from condvln.instructions.priors import PRIORS
from schemas.config.constants import EVIDENCE, STAGINGS


@given(st.integers(0, 400), st.integers(0, 400), st.sampled_from([STAGINGS, EVIDENCE]))
def test_a_statement_is_asked_as_often_true_as_false(n_true: int, n_false: int, evidence: int) -> None:
    weights = informative_weights(n_true, n_false, evidence)
    if n_true + n_false >= evidence and 0 in (n_true, n_false):
        assert weights == {True: 0.0, False: 0.0}
    else:
        assert min(weights.values()) > 0.0
    if min(n_true, n_false) >= 20:
        assert n_true * weights[True] == pytest.approx(n_false * weights[False], rel=0.03)
    assert weights[True] <= 1.0
    assert weights[False] <= 1.0


Counted = list[tuple[str, str, bool, int, int]]
"""Label, anchor, definite, number of rooms in which the statement is true, number in which it is false."""

COUNTED = st.lists(
    st.tuples(st.sampled_from("ab"), st.sampled_from("xyz"), st.booleans(), st.integers(0, 30), st.integers(0, 30)),
    max_size=16,
)


def table_of(counted: Counted) -> pa.Table:
    rows = [("", "", "bedroom", label, "near", *rest, 0) for label, *rest in counted]
    columns = list(zip(*rows, strict=True)) or [()] * len(PRIORS)
    return pa.table([pa.array(c, f.type) for c, f in zip(columns, PRIORS, strict=True)], schema=PRIORS)


@given(COUNTED)
def test_a_label_is_asked_as_often_true_as_false_in_either_form(counted: Counted) -> None:
    """Over all rooms, true and false statements about a label get equal weights, however rare each statement is."""
    factors = label_weights(table_of(counted))
    sums: dict[tuple[str, bool], dict[str, np.ndarray]] = {}
    for label, anchor, definite, *counts in counted:
        statements = sums.setdefault((label, definite), {})
        statements[anchor] = statements.get(anchor, np.zeros(2, dtype=np.int64)) + counts
    assert {(label, definite) for _, label, _, definite in factors} == set(sums)
    for (label, definite), statements in sums.items():
        factor = factors["bedroom", label, "near", definite]
        drawn = np.zeros(2)
        for n_true, n_false in statements.values():
            weights = informative_weights(int(n_true), int(n_false), EVIDENCE)
            drawn += (n_false * weights[False], n_true * weights[True])
        assert drawn[0] * factor[0] == pytest.approx(drawn[1] * factor[1])
        assert max(factor) == pytest.approx(1.0 if drawn.all() else 0.0), "no more is lost than must be"


def test_rows_of_one_statement_are_added() -> None:
    parts: Counted = [("a", "x", True, 1, 2), ("a", "x", True, 3, 1), ("a", "y", True, 5, 9)]
    whole: Counted = [("a", "x", True, 4, 3), ("a", "y", True, 5, 9)]
    assert label_weights(table_of(parts)) == label_weights(table_of(whole))
