"""Over the stagings of a layout, the truths of a statement are about as uneven as a fair coin's, whatever else a
staging holds.
"""

from __future__ import annotations

import random
from collections import defaultdict
from collections.abc import Mapping

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.instructions.balance import (
    MANY_STAGINGS,
    MANY_STAGINGS_IMBALANCE,
    informative_weights,
    staging_factors,
)
from condvln.instructions.expected_draws import FULL_MASS
from condvln.instructions.predicates import GROUP_OF, PREDICATE_GROUPS
from condvln.instructions.priors import PRIORS
from condvln.instructions.statement_counts import Statement
from schemas.config import PredicateWeights
from schemas.config.constants import STAGINGS

WEIGHTS = {group: getattr(PredicateWeights(), group) for group in PREDICATE_GROUPS}

Truths = Mapping[Statement, bool]
"""The truths of the statements about one staging; a statement that can't be used there is missing."""


def table_of(stagings: list[Truths]) -> pa.Table:
    rows = [
        ("layout", f"layout_{k:02}", *statement, int(truth), int(not truth), 0)
        for k, truths in enumerate(stagings)
        for statement, truth in truths.items()
    ]
    columns = list(zip(*rows, strict=True)) or [()] * len(PRIORS)
    return pa.table([pa.array(c, f.type) for c, f in zip(columns, PRIORS, strict=True)], schema=PRIORS)


def expected(stagings: list[Truths], factors: Mapping[Statement, float]) -> dict[Statement, list[float]]:
    """How often each statement is drawn in each staging, negative where it is false, by plain loops over rooms, groups
    and forms.
    """
    counts: dict[Statement, list[int]] = defaultdict(lambda: [0, 0])
    for truths in stagings:
        for statement, truth in truths.items():
            counts[statement][truth] += 1
    drawn: dict[Statement, list[float]] = {statement: [0.0] * len(stagings) for statement in counts}
    for k, truths in enumerate(stagings):
        forms: dict[tuple[str, bool], dict[bool, dict[Statement, float]]] = {}
        for statement, truth in truths.items():
            n_false, n_true = counts[statement]
            factor = factors.get(statement, 1.0)
            weight = informative_weights(n_true, n_false, STAGINGS)[truth] * (factor if truth else 1.0 / factor)
            form = forms.setdefault((statement[2], statement[4]), {True: {}, False: {}})
            form[truth][statement] = weight
        masses = {form: min(sum(side.values()) for side in sides.values()) for form, sides in forms.items()}
        groups: dict[str, float] = defaultdict(float)
        for (predicate, _), mass in masses.items():
            groups[GROUP_OF[predicate]] += mass
        used = {group: WEIGHTS[group] * min(1.0, mass / FULL_MASS) for group, mass in groups.items()}
        for (predicate, definite), sides in forms.items():
            group = GROUP_OF[predicate]
            mass = masses[predicate, definite]
            if not mass:
                continue
            share = used[group] / sum(used.values()) * mass / groups[group]
            for truth, side in sides.items():
                for statement, weight in side.items():
                    drawn[statement][k] += (1 if truth else -1) * share * weight / sum(side.values())
    return drawn


def share(draws: list[float]) -> float:
    """The excess of true draws, as a share of all."""
    return sum(draws) / sum(map(abs, draws))


def fair_imbalance(draws: list[float]) -> float:
    """The share that a coin's excess has on average (its root mean square)."""
    return sum(x * x for x in draws) ** 0.5 / sum(map(abs, draws))


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


@pytest.mark.parametrize(("number", "part"), list(MANY_STAGINGS_IMBALANCE._asdict().items()))
@pytest.mark.parametrize("seed", range(5))
def test_the_excess_is_a_part_of_a_coin_s_and_of_the_truth_in_more_stagings(
    seed: int, number: str, part: float
) -> None:
    stagings = staged(seed)
    unfitted = expected(stagings, {})
    factors = staging_factors(table_of(stagings), WEIGHTS)
    drawn = expected(stagings, {statement: getattr(own, number) for statement, own in factors.items()})
    said = {statement: [truths[statement] for truths in stagings if statement in truths] for statement in drawn}
    clear = [s for s, truths in said.items() if 2 * sum(truths) != len(truths) and any(drawn[s])]
    assert len(clear) > 30
    off = {}
    for s in clear:
        usual = 1 if 2 * sum(said[s]) > len(said[s]) else -1
        off[s] = abs(share(drawn[s]) - usual * part * fair_imbalance(unfitted[s]))
    draws = {s: sum(map(abs, drawn[s])) for s in clear}
    assert sum(off[s] * draws[s] for s in clear) < 0.08 * sum(draws.values())


def test_a_statement_that_is_false_where_little_else_is() -> None:
    """`a` is true in three stagings and false in two, but where it is false, fewer others are false than are true where
    it is true.
    """
    a, b, c, d, e, f = (("apartment", label, "near", "x", True) for label in "abcdef")
    stagings: list[Truths] = [
        {a: True, b: True, c: True, d: True, e: False, f: False},
        {a: True, b: True, c: True, e: True, d: False, f: False},
        {a: True, b: True, c: True, d: False, e: False, f: True},
        {a: False, b: False, c: True, d: True, e: True, f: True},
        {a: False, c: False, b: True, d: True, e: True, f: True},
        {b: False, c: False, d: False, e: True, f: True},
        {d: False, e: False, f: True, b: True},
    ]
    stagings *= 2
    assert len(stagings) >= MANY_STAGINGS
    unfitted = expected(stagings, {})[a]
    assert share(unfitted) < -0.05
    factors = staging_factors(table_of(stagings), WEIGHTS)
    assert factors[a].one > factors[a].several > 1.25
    excess = [share(expected(stagings, {s: own[k] for s, own in factors.items()})[a]) for k in range(2)]
    assert all(0.0 < one < 1.5 * fair_imbalance(unfitted) for one in excess)


@given(st.integers(0, 10_000), st.integers(1, 6))
def test_factors_are_the_same_in_any_order_and_finite(seed: int, count: int) -> None:
    stagings = staged(seed, count)
    table = table_of(stagings)
    factors = staging_factors(table, WEIGHTS)
    assert set(factors) == {statement for truths in stagings for statement in truths}
    assert all(2.0**-10 <= factor <= 2.0**10 for own in factors.values() for factor in own)
    order = random.Random(seed).sample(range(table.num_rows), table.num_rows)
    assert staging_factors(table.take(order), WEIGHTS) == factors
