"""Learners see only scenes before the one they guess at, and noise gives them nothing."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy import stats

from condvln.bias.guesser_view import GuesserView
from condvln.bias.guessers import FIXED, LEARNED
from condvln.bias.regression import BLOCKS, NO_GUESS, blocks, progressive
from schemas.program import CATEGORIES, SHAPES, Program, leaf_truths


def test_blocks_hold_whole_scenes_and_lose_none() -> None:
    scenes = [f"s{k % 37}" for k in range(500)]
    parts = blocks(scenes)
    assert len(parts) == BLOCKS
    assert sorted(np.concatenate(parts).tolist()) == list(range(500))
    named = [{scenes[k] for k in part} for part in parts]
    assert sum(map(len, named)) == 37
    assert max(map(len, parts)) <= 2 * min(map(len, parts))


def test_nobody_learns_from_what_comes_later() -> None:
    scenes = [f"s{k % 12}" for k in range(60)]
    seen: set[int] = set()
    for learned, guessed in progressive(scenes):
        assert seen <= set(learned.tolist())
        assert not {scenes[k] for k in learned} & {scenes[k] for k in guessed}
        seen = set(learned.tolist()) | set(guessed.tolist())
    assert seen == set(range(60))
    assert list(progressive(["one"] * 5)) == []
    assert list(progressive([])) == []


@pytest.mark.parametrize("category", CATEGORIES)
def test_ways_to_leaves_are_the_program_s(category) -> None:
    ways = leaf_truths(category)
    assert len(ways) == SHAPES[category].leaves
    for leaf, way in enumerate(ways):
        truths = [False] * len(SHAPES[category].branches)
        for k, truth in way:
            truths[k] = truth
        program = Program.model_construct(category=category, branches=SHAPES[category].branches)
        assert program.route(truths) == (tuple(k for k, _ in way), leaf)


@pytest.mark.parametrize("name", LEARNED)
def test_guesses_do_not_move_with_later_gold(made_rows, name: str) -> None:
    rows = made_rows(0, scenes=12)
    views = [GuesserView.of(row) for row in rows]
    scenes = [view.scene for view in views]
    guesses = LEARNED[name](views)
    steps = list(progressive(scenes))
    assert set(np.flatnonzero(guesses == NO_GUESS)) >= set(steps[0][0].tolist())
    # All that is guessed in the last step is turned: what was guessed until then, and there too, stays.
    last = set(steps[-1][1].tolist())
    turned = [
        GuesserView.of({**row, "gold_leaf": SHAPES[row["category"]].leaves - 1 - row["gold_leaf"]}) if k in last else g
        for k, (row, g) in enumerate(zip(rows, views, strict=True))
    ]
    if name not in ("bag of words", "words in place", "worth", "purpose"):
        assert (LEARNED[name](turned) == guesses).all()
        return
    # A regression has steps of its own in each category.
    for category in ("simple", "chain"):
        mine = [k for k, view in enumerate(views) if view.category == category]
        own = LEARNED[name]([views[k] for k in mine])
        assert (own == guesses[mine]).all()


def test_right_guesses_at_noise_are_binomial(made_rows) -> None:
    """Statements that recur tempt a learner; over many datasets it is right just as often as a coin, and no more."""
    hits, trials = 0, Counter()
    low = 0
    for seed in range(120):
        views = [GuesserView.of(row) for row in made_rows(seed, scenes=12, each=3, categories=("simple",))]
        guesses = LEARNED["label and room"](views)
        made = np.flatnonzero(guesses != NO_GUESS)
        right = int(sum(views[k].gold == guesses[k] for k in made))
        hits, trials = hits + right, trials + Counter({0.5: len(made)})
        low += stats.binom.sf(right - 1, len(made), 0.5) < 0.05
    assert stats.binom.sf(hits - 1, trials[0.5], 0.5) > 0.001
    assert stats.binom.sf(low - 1, 120, 0.05) > 0.001, "no more small p-values than there should be"


def test_fixed_guessers_by_hand(made_rows) -> None:
    row = made_rows(0, scenes=1, categories=("nested_chain",))[0]
    names = ("bed", "sink", "lamp", "rug")
    for leaf, name, distance, route in zip(
        row["program"]["leaves"], names, (5.0, 2.0, 9.0, 4.0), (30, 20, 10, 40), strict=True
    ):
        leaf["moves"] = [{"label": name, "room": {"label": "kitchen"}}]
        row["leaves"][names.index(name)] = {"geodesic_distance": distance, "route_length": route}
    row["instruction_text"] = "If not, go to the rug. If so, go to the bed, or the sink, or the lamp."
    view = GuesserView.of(row)
    assert {name: guesser(view) for name, guesser in FIXED.items()} == {
        "always then": 0,
        "always else": 3,
        "last leaf": 2,
        "nearest target": 1,
        "farthest target": 2,
        "longest route": 3,
    }
