"""The regression of the bias gate against scikit-learn's, and its guesses against rounding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from sklearn.linear_model import LogisticRegression

from condvln.bias.blocks import NO_GUESS, progressive
from condvln.bias.regression import LEAST_TEXTS, PENALTY, TIE, fitted_scores, regressed, word_features


@dataclass(frozen=True)
class View:
    scene: str
    text: str
    gold: int


def drawn(seed: int, texts: int, classes: int) -> tuple[csr_matrix, np.ndarray]:
    """Word features of random texts, and answers that some of the words predict."""
    rng = np.random.default_rng(seed)
    table = rng.random((texts, 30)) < rng.random(30)
    gold = (table[:, :3].sum(axis=1) + rng.integers(2, size=texts)) % classes
    return csr_matrix(table.astype(float)), gold.astype(np.int64)


@given(st.integers(0, 2**32 - 1), st.integers(2, 5), st.permutations(range(80)))
@settings(max_examples=10)
def test_words_that_always_occur_together_count_each(seed: int, classes: int, order: list[int]) -> None:
    """Some columns occur twice or three times; scikit-learn gets them all, and ours in another order."""
    features, gold = drawn(seed, 60, classes)
    features = features[:, [*range(30), *range(30), *range(20)]][:, order]
    (scores,) = np.moveaxis(fitted_scores(features, gold, np.ones((60, 1), dtype=np.bool_)), 1, 0)
    model = LogisticRegression(C=1 / PENALTY, solver="newton-cholesky", tol=1e-12, max_iter=1000)
    model.fit(features, gold)
    odds = np.exp(scores - scores.max(axis=1, keepdims=True))[:, model.classes_]
    assert odds / odds.sum(axis=1, keepdims=True) == pytest.approx(model.predict_proba(features), abs=TIE / 10)


@given(st.integers(0, 2**32 - 1), st.integers(2, 6), st.lists(st.integers(12, 60), min_size=1, max_size=4))
@settings(max_examples=10)
def test_probabilities_are_those_of_scikit_learn(seed: int, classes: int, sizes: list[int]) -> None:
    """In all fits side by side, whichever classes a fit has."""
    features, gold = drawn(seed, 60, classes)
    inside = np.arange(60)[:, None] < np.array(sorted(sizes))
    inside = inside[:, [len(set(gold[mask].tolist())) > 1 for mask in inside.T]]
    if not inside.shape[1]:
        return
    scores = fitted_scores(features, gold, inside)
    for k, mask in enumerate(inside.T):
        model = LogisticRegression(C=1 / PENALTY, solver="newton-cholesky", tol=1e-12, max_iter=1000)
        model.fit(features[mask], gold[mask])
        own = scores[:, k]
        assert set(np.flatnonzero(np.isfinite(own[0])).tolist()) == set(model.classes_.tolist())
        odds = np.exp(own - own.max(axis=1, keepdims=True))
        mine = (odds / odds.sum(axis=1, keepdims=True))[:, model.classes_]
        assert mine == pytest.approx(model.predict_proba(features), abs=TIE / 10)


def test_guesses_are_those_of_scikit_learn() -> None:
    """Scene by scene, with the same words."""
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
