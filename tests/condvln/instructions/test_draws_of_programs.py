"""Draws of stops and conditions beside their definitions: the rules, sets of targets, and how often each is drawn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations, pairwise
from typing import cast

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare

from condvln.instructions import LabelPriors
from condvln.instructions.condition_sampler import ConditionSampler
from condvln.instructions.conflicts import Conflicts, RuledOut
from condvln.instructions.degeneracy import Claim, Presupposed
from condvln.instructions.degeneracy import clash as clash_of_claims
from condvln.instructions.stop_sampler import StopSampler
from condvln.instructions.stops import Target, Targets
from condvln.labels import Vocabulary
from condvln.seeding import Draws
from schemas.config import Thresholds
from schemas.config.constants import PLAIN_ROOM_WEIGHT
from schemas.program import RoomRef
from tests.condvln.instructions.made_sampler import made_sampler

LABELS = "abcdef"
ROOMS = ("one", "two", "three")
ALPHA = 1e-4
"""False alarms that a statistical test with a fixed seed may have when it is first written."""


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
    return Claim(draw(room), None, draw(label), anchors, not anchors, len(anchors) == 1 and draw(st.booleans()))


phrases = st.lists(st.tuples(room, label, st.lists(label, max_size=2, unique=True).map(tuple)), max_size=3)


@given(
    st.lists(claims(), min_size=1, max_size=3),
    phrases,
    st.fixed_dictionaries(dict.fromkeys(ROOMS, st.none() | label)),
    st.fixed_dictionaries(dict.fromkeys(LABELS, st.booleans())),
    st.booleans(),
)
def test_what_a_text_excludes_is_what_violates_a_rule(
    made: list[Claim],
    said: list[tuple[str, str, tuple[str, ...]]],
    rooms: dict[str, str | None],
    shared: dict[str, bool],
    search: bool,
) -> None:
    """Whichever things name the rooms."""
    words = cast("Vocabulary", Words(shared))
    excluded = RuledOut(
        Conflicts(made, words), [(where, rooms[where], what, by) for where, what, by in said], rooms, search=search
    )
    for claim in made[:-1]:
        excluded.add(claim)
    stops = {(where, what) for where, what, _ in said}
    pairs = {(where, what, anchor) for where, what, by in said for anchor in by}
    named = {(where, cast("str", rooms[where])) for where, *_ in said if rooms[where]}
    given_ = Presupposed(
        frozenset(stops), frozenset(stops | {(where, anchor) for where, _, anchor in pairs} | named), frozenset(pairs)
    )
    full = [replace(one, room_anchor=rooms[one.room_id]) for one in made]
    violated = clash_of_claims(full[-1], full[:-1], given_, words, search=search)
    found = [rule for rule, statements in excluded.by_rule.items() if statements >> (len(made) - 1) & 1]
    assert (violated is None) == (not found)
    assert violated is None or violated in found


@given(st.integers(2, 9), st.integers(0, 4), st.integers(0, 2), st.integers(0, 2**32))
def test_targets_fit_if_some_choice_of_them_does(t: int, n: int, waypoints: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    apart = np.triu(rng.random((t, t)) < 0.6, 1)
    apart |= apart.T
    named = [LABELS[k] for k in rng.integers(0, 4, t)]
    found = tuple(Target(str(k), k, "one", k, named[k], 1.0, True, True) for k in range(t))
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
    sets = [sum(1 << k for k in np.flatnonzero(mask).tolist()) for mask in (allowed, free)]
    for _ in range(2):  # the second answer was kept
        assert sampler._fit(*sets, n, waypoints) == expected


def test_goals_are_drawn_by_the_weights_of_their_labels() -> None:
    """The first goal by the weight of its label, then evenly among the targets of the label."""
    weights, count = {"a": 1.0, "b": 0.25, "c": 2.0}, {"a": 2, "b": 1, "c": 3}
    found = [
        Target(f"{x}{k}", 0, "one", 0, x, weight, True, True) for x, weight in weights.items() for k in range(count[x])
    ]
    apart = ~np.eye(len(found), dtype=bool)
    sampler = StopSampler(
        Targets(tuple(found), apart, np.zeros_like(apart)), {"one": "kitchen"}, ["one"], ["one"], lambda *_: True
    )
    used = Counter({"c": 3, "a": 1})
    goals, draws = sampler.goal_weights(used, 4.0), Draws(np.random.default_rng(4))
    assert sampler.goal_weights(used, 3.0).labels == ["a", "b"], "c is a goal three times already"
    _, held = sampler.draw_rooms("C0", (1, 1), draws)
    drawn = Counter(sampler.draw_goals(2, 0, held, goals, draws)[0] for _ in range(8000))
    share = {x: weights[x] / (1 + used[x]) for x in weights}
    expected = [8000 * share[t.label] / sum(share.values()) / count[t.label] for t in found]
    assert chisquare([drawn[k] for k in range(len(found))], expected).pvalue > ALPHA


def one_by_one(sampler: ConditionSampler, rooms: list[RoomRef], excluded: int, draws: Draws) -> int | None:
    """Return a true statement as the docstring of `ConditionSampler.draw` says it is drawn, try by try."""
    weights = [PLAIN_ROOM_WEIGHT if room.anchor_id is None else 1.0 for room in rooms]
    for _ in range(sampler._sampling.attempts):
        room = draws.weighted(rooms, weights)
        forms, chances = zip(*sampler._chances[room.room_id, False], strict=True)
        form = draws.weighted(forms, chances)
        true, false = (draws.weighted(*form.among(truth, 0)) for truth in (True, False))
        if not (1 << true | 1 << false) & excluded:
            return int(true)
    return None


def test_conditions_are_drawn_as_if_by_tries(make_scene, facts_maker) -> None:
    """So often none is found, and so often each, whatever the text excludes."""
    scene = make_scene(2, ("kitchen", "living room"), 8, repeats=0.3)
    bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
    sampler = made_sampler(scene, facts_maker(scene), bits).condition_sampler
    rooms = [RoomRef(room_id=name, label=name) for name in sampler.rooms]
    assert len(rooms) == 2
    nothing = sampler.excluded_by((), rooms)
    statements, few = (
        len(sampler.conflicts.statements),
        np.random.default_rng(1).random(len(sampler.conflicts.statements)),
    )
    assert statements > 50
    for share in (0.0, 0.5, 0.93):
        gone = sum(1 << k for k in np.flatnonzero(few < share).tolist()) | nothing.union
        drawn, expected = Counter[int | None](), Counter[int | None]()
        draws, other = Draws(np.random.default_rng(2)), Draws(np.random.default_rng(3))
        for _ in range(4000):
            excluded = sampler.excluded_by((), rooms)
            excluded.by_rule["one_label"] |= gone
            found = sampler.draw(
                (True,), rooms, excluded, draws, luck=draws.uniform(), start_room=None, bearings=0, compass=8
            )
            drawn[None if found is None else found[0].number] += 1
            expected[one_by_one(sampler, rooms, gone, other)] += 1
        often = [key for key in expected if expected[key] >= 20]
        # Two samples of equal size: their difference has the variance of their sum.
        excess = sum((drawn[key] - expected[key]) ** 2 / (drawn[key] + expected[key]) for key in often)
        assert excess < len(often) + 5 * np.sqrt(2 * len(often)), share
        assert sum(drawn[key] for key in often) > 3000
