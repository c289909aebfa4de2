"""The guesses of the bias gate's regression depend neither on the solver nor on rounding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.linear_model import LogisticRegression

from condvln.bias.regression import LEAST_TEXTS, NO_GUESS, PENALTY, progressive, regressed, word_features


@dataclass(frozen=True)
class View:
    scene: str
    text: str
    gold: int


def test_guesses_do_not_depend_on_the_solver() -> None:
    """Another solver, run to a far smaller gradient, guesses the same."""
    rng = np.random.default_rng(3)
    words = np.array([f"w{k}" for k in range(40)])
    views = []
    for k in range(240):
        said = words[rng.random(40) < 0.3]
        gold = ("w1" in said) + 2 * ("w2" in said) if rng.random() < 0.7 else int(rng.integers(4))
        views.append(View(f"s{k % 24}", " ".join(said), int(gold)))
    guesses = regressed(views, lambda view: view.text.split())
    features = word_features([view.text.split() for view in views])
    gold = np.array([view.gold for view in views])
    expected = np.full(len(views), NO_GUESS)
    for learned, guessed in progressive([view.scene for view in views]):
        model = LogisticRegression(C=1 / PENALTY, solver="newton-cholesky", tol=1e-12, max_iter=1000)
        expected[guessed] = model.fit(features[learned], gold[learned]).predict(features[guessed])
    assert (guesses == expected).all()
    assert (guesses[guesses != NO_GUESS] == gold[guesses != NO_GUESS]).mean() > 0.4, "the words do predict"


@given(st.permutations(range(60)))
@settings(max_examples=10)
def test_equal_scores_guess_the_first_class_in_any_order(order: list[int]) -> None:
    """Each word is as often right for every class, so only rounding could prefer one."""
    views = [View(f"s{k // 6}", f"{'even' if k % 2 else 'odd'} text", k % 6 // 2) for k in range(60)]
    guesses = regressed([views[k] for k in order], lambda view: view.text.split())
    assert set(guesses.tolist()) == {NO_GUESS, 0}


def test_one_class_or_no_words_guess_what_was_first() -> None:
    alike = [View(f"s{k % 8}", f"word{k % 3} here", 1) for k in range(40)]
    assert set(regressed(alike, lambda view: view.text.split()).tolist()) == {NO_GUESS, 1}
    silent = [View(f"s{k % 8}", "", k % 2) for k in range(40)]
    steps = list(progressive([view.scene for view in silent]))
    guesses = regressed(silent, lambda view: view.text.split())
    for learned, guessed in steps:
        assert set(guesses[guessed].tolist()) == {silent[learned[0]].gold}


def test_features_are_the_words_that_are_neither_rare_nor_everywhere() -> None:
    texts = [["all", "half", "half"] if k % 2 else ["all", f"once{k}"] for k in range(40)]
    texts[0] += ["twice"]
    texts[2] += ["twice"]
    table = word_features(texts).toarray()
    assert LEAST_TEXTS == 2
    assert sorted(table.sum(axis=0).tolist()) == [2.0, 20.0]
    assert set(table.ravel().tolist()) == {0.0, 1.0}
