"""The compiled sampler decides as plain Python does."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, pairwise
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.instructions.degeneracy import Claim, Presupposed
from condvln.instructions.degeneracy import clash as clash_of_claims
from condvln.instructions.kernels.conditions import RULES, Given, clash
from condvln.instructions.kernels.stops import targets_fit
from condvln.instructions.kernels.stream import cumulative, index, uniform
from condvln.instructions.statement_tables import NumberedStatements
from condvln.instructions.stop_sampler import StopSampler
from condvln.instructions.stops import Target, Targets
from condvln.labels import Vocabulary
from condvln.seeding import BLOCK, Draws

LABELS = "abcdef"
ROOMS = ("one", "two", "three")


class Words:
    """A vocabulary in which some words may name the label that follows, too."""

    def __init__(self, shared: Mapping[str, bool]) -> None:
        self._pairs = [{x, y} for x, y in pairwise(LABELS) if shared[x]]

    def overlapping(self, label: str) -> frozenset[str]:
        return frozenset({label}).union(*(pair for pair in self._pairs if label in pair))


label, room = st.sampled_from(LABELS), st.sampled_from(ROOMS)


@st.composite
def claims(draw: st.DrawFn) -> Claim:
    anchors = tuple(draw(st.lists(label, max_size=2, unique=True)))
    return Claim(draw(room), draw(st.none() | label), draw(label), anchors, not anchors)


presupposed = st.builds(
    Presupposed,
    st.frozensets(st.tuples(room, label), max_size=2),
    st.frozensets(st.tuples(room, label), max_size=3),
    st.frozensets(st.tuples(room, label, label), max_size=2),
)


@given(
    st.lists(claims(), min_size=1, max_size=3), presupposed, st.fixed_dictionaries(dict.fromkeys(LABELS, st.booleans()))
)
def test_rules_are_those_of_degeneracy(made: list[Claim], said: Presupposed, shared: dict[str, bool]) -> None:
    words = cast("Vocabulary", Words(shared))
    numbered = NumberedStatements({}, words)
    table = numbered.claims(made)
    room_of, label_of = numbered.room, numbered.label
    stops = Given(
        np.array([(room_of(one), label_of(x)) for one, x in said.stops], np.int64).reshape(-1, 2),
        np.array([(room_of(one), label_of(x)) for one, x in said.things], np.int64).reshape(-1, 2),
        np.array([(room_of(one), label_of(x), label_of(y)) for one, x, y in said.pairs], np.int64).reshape(-1, 3),
    )
    rule = clash(table, len(made) - 1, stops, numbered.tables.overlap)
    assert (None if rule < 0 else RULES[rule]) == clash_of_claims(made[-1], made[:-1], said, words)


@given(st.integers(2, 9), st.integers(0, 4), st.integers(0, 2), st.integers(0, 2**32))
def test_targets_fit_if_some_choice_of_them_does(t: int, n: int, waypoints: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    apart = np.triu(rng.random((t, t)) < 0.6, 1)
    apart |= apart.T
    named = [LABELS[k] for k in rng.integers(0, 4, t)]
    found = tuple(Target(str(k), k, "one", k, named[k], 1.0, True) for k in range(t))
    targets = Targets(found, apart, np.zeros_like(apart))
    sampler = StopSampler(targets, {"one": "kitchen"}, ["one"], ["one"], lambda _room, _stop: True)
    allowed, free = rng.random(t) < 0.8, rng.random(t) < 0.8

    def chosen(count: int, among: list[int]) -> list[tuple[int, ...]]:
        return [
            some
            for some in combinations(among, count)
            if len({named[k] for k in some}) == count and all(apart[i, j] for i, j in combinations(some, 2))
        ]

    expected = any(
        chosen(waypoints, [k for k in np.flatnonzero(free).tolist() if all(apart[i, k] for i in goals)])
        for goals in chosen(n, np.flatnonzero(allowed).tolist())
    )
    for _ in range(2):  # the second answer was kept
        assert targets_fit(allowed, free, n, waypoints, sampler.tables.questions) == expected


@pytest.mark.parametrize("read", [0, 5, BLOCK])
@pytest.mark.parametrize("count", [1, BLOCK, 3 * BLOCK + 7])
def test_kernels_read_the_same_stream(read: int, count: int) -> None:
    plain, mixed = (Draws(np.random.default_rng(3)) for _ in range(2))
    for draws in (plain, mixed):
        for _ in range(read):
            draws.uniform()
    found = mixed.compiled(lambda stream, left: [uniform(stream, left) for _ in range(count)])
    assert found == [plain.uniform() for _ in range(count)]
    sums = (0.2, 0.2, 1.0, 4.0)
    chosen = mixed.compiled(
        lambda stream, left: (
            [cumulative(np.array(sums), 0, 4, stream, left) for _ in range(50)]
            + [index(7, stream, left) for _ in range(50)]
        )
    )
    assert chosen == [plain.cumulative(sums) for _ in range(50)] + [plain.index(7) for _ in range(50)]
    assert mixed.uniform() == plain.uniform()
