"""Over the stagings of a layout, each statement is drawn as often true as false, whatever else a staging holds."""

from __future__ import annotations

import random
from collections import defaultdict
from collections.abc import Mapping

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.instructions.informative import informative_weights
from condvln.instructions.predicates import GROUP_OF, PREDICATE_GROUPS
from condvln.instructions.priors import PRIORS
from condvln.instructions.stagings import Statement, even_factors
from schemas.config import PredicateWeights
from schemas.config.constants import STAGINGS

WEIGHTS = {group: getattr(PredicateWeights(), group) for group in PREDICATE_GROUPS}

Truths = Mapping[Statement, bool]
"""The truths of the statements about one staging; a statement that can't be used there is missing."""


def table_of(stagings: list[Truths]) -> pa.Table:
    rows = [
        ("layout", f"layout_{k:02}", *statement, int(truth), int(not truth))
        for k, truths in enumerate(stagings)
        for statement, truth in truths.items()
    ]
    columns = list(zip(*rows, strict=True)) or [()] * len(PRIORS)
    return pa.table([pa.array(c, f.type) for c, f in zip(columns, PRIORS, strict=True)], schema=PRIORS)


def expected(stagings: list[Truths], factors: Mapping[Statement, float]) -> dict[Statement, tuple[float, float]]:
    """How often each statement is drawn false and true, by plain loops over rooms, groups and forms."""
    counts: dict[Statement, list[int]] = defaultdict(lambda: [0, 0])
    for truths in stagings:
        for statement, truth in truths.items():
            counts[statement][truth] += 1
    drawn: dict[Statement, list[float]] = defaultdict(lambda: [0.0, 0.0])
    for truths in stagings:
        forms: dict[tuple[str, bool], dict[bool, dict[Statement, float]]] = {}
        for statement, truth in truths.items():
            n_false, n_true = counts[statement]
            factor = factors.get(statement, 1.0)
            weight = informative_weights(n_true, n_false, STAGINGS)[truth] * (factor if truth else 1.0 / factor)
            form = forms.setdefault((statement[2], statement[4]), {True: {}, False: {}})
            form[truth][statement] = weight
        masses = {form: min(sum(side.values()) for side in sides.values()) for form, sides in forms.items()}
        groups = {GROUP_OF[predicate] for (predicate, _), mass in masses.items() if mass > 0}
        for (predicate, definite), sides in forms.items():
            group = GROUP_OF[predicate]
            mass = masses[predicate, definite]
            if not mass:
                continue
            together = sum(m for (p, _), m in masses.items() if GROUP_OF[p] == group)
            share = WEIGHTS[group] / sum(WEIGHTS[g] for g in groups) * mass / together
            for truth, side in sides.items():
                for statement, weight in side.items():
                    drawn[statement][truth] += share * weight / sum(side.values())
    return {statement: (false, true) for statement, (false, true) in drawn.items()}


def unevenness(drawn: Mapping[Statement, tuple[float, float]]) -> float:
    return sum(abs(true - false) for false, true in drawn.values()) / sum(map(sum, drawn.values()))


def staged(seed: int, stagings: int = 20) -> list[Truths]:
    """Stagings in which each statement is true with its own probability, often the same as in the staging before."""
    rng = random.Random(seed)
    forms = [("near", True), ("near", False), ("east of", True), ("north of", True)]
    statements: list[Statement] = [
        ("apartment", label, predicate, anchor, definite)
        for label in "abcdefgh"
        for predicate, definite in forms
        for anchor in "xyz"
    ]
    rates = {statement: rng.betavariate(0.7, 0.7) for statement in statements}
    return [
        {statement: rng.random() < rates[statement] for statement in statements if rng.random() < 0.35}
        for _ in range(stagings)
    ]


@pytest.mark.parametrize("seed", range(5))
def test_each_statement_is_drawn_as_often_true_as_false(seed: int) -> None:
    stagings = staged(seed)
    before = unevenness(expected(stagings, {}))
    after = unevenness(expected(stagings, even_factors(table_of(stagings), WEIGHTS)))
    assert before > 0.15
    assert after < before / 3


def test_a_statement_that_is_false_where_little_else_is() -> None:
    """`a` is true in two stagings and false in two, but where it is false, fewer others are false than are true where
    it is true.
    """
    a, b, c, d, e, f = (("apartment", label, "near", "x", True) for label in "abcdef")
    stagings: list[Truths] = [
        {a: True, b: True, c: True, d: True, e: False, f: False},
        {a: True, b: True, c: True, e: True, d: False, f: False},
        {a: False, b: False, c: True, d: True, e: True, f: True},
        {a: False, c: False, b: True, d: True, e: True, f: True},
        {b: False, c: False, d: False, e: True, f: True},
        {d: False, e: False, f: True, b: True},
    ]
    false, true = expected(stagings, {})[a]
    assert false > 1.5 * true
    factors = even_factors(table_of(stagings), WEIGHTS)
    assert factors[a] > 1.25
    false, true = expected(stagings, factors)[a]
    assert false == pytest.approx(true, rel=0.05)


@given(st.integers(0, 10_000), st.integers(1, 6))
def test_factors_are_the_same_in_any_order_and_finite(seed: int, count: int) -> None:
    stagings = staged(seed, count)
    table = table_of(stagings)
    factors = even_factors(table, WEIGHTS)
    assert set(factors) == {statement for truths in stagings for statement in truths}
    assert all(2.0**-10 <= factor <= 2.0**10 for factor in factors.values())
    order = random.Random(seed).sample(range(table.num_rows), table.num_rows)
    assert even_factors(table.take(order), WEIGHTS) == factors


def test_groups_of_weight_0_keep_their_weights() -> None:
    stagings = staged(1)
    factors = even_factors(table_of(stagings), {**WEIGHTS, "near": 0.0})
    assert {factor for statement, factor in factors.items() if statement[2] == "near"} == {1.0}
    assert len({factor for statement, factor in factors.items() if statement[2] != "near"}) > 5
    assert even_factors(table_of([]), WEIGHTS) == {}
