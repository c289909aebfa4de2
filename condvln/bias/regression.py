"""Multinomial logistic regression on the words of texts, learned from earlier blocks of scenes.

All blocks are fitted side by side, by Newton's method, whose steps come from conjugate gradients. The loss is that of
scikit-learn's ``LogisticRegression``: the sum of the log losses plus ½·λ·‖weights‖², intercepts without penalty, one
weight vector instead of two where there are two classes. It has one minimum, so the guesses do not depend on the
solver; scikit-learn's, run to a small gradient, makes the same ones.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from condvln.bias.blocks import NO_GUESS, progressive

__all__ = ["Guesses", "Labelled", "fitted_scores", "regressed", "word_features"]

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
Guesses = NDArray[np.int64]

PENALTY: Final = 10.0
"""λ, the weight of the squared norm beside the sum of the log losses; scikit-learn's ``C`` is its inverse."""
LEAST_TEXTS: Final = 2
"""A word is a feature only if at least this many episodes contain it."""
MOST_TEXTS: Final = 0.95
"""A word is a feature only if at most this share of the episodes contains it; a word in every text carries no
information.
"""
TOLERANCE: Final = 1e-4
"""Norm of the gradient at which a fit ends. The weights are then within 1/λ of it of the minimum."""
TIE: Final = 1e-3
"""Scores this close are equal, and the first class is guessed: neither rounding nor the solver may decide. Far above
the error of scores, far below what an accuracy depends on.
"""
NEWTON_STEPS: Final = 60
GRADIENT_STEPS: Final = 300
"""Largest number of conjugate gradient steps within a Newton step."""
HALVINGS: Final = 30
"""Largest number of times that a Newton step is halved until it lowers the loss."""
LEAST_DESCENT: Final = 1e-4
"""Least share of the descent that its slope promises for which a step is taken (Armijo's rule)."""
ROUNDING: Final = 1e-13
FORCING: Final = 0.05
"""Largest residual that the conjugate gradients of a Newton step may leave, as a share of the gradient."""


class Labelled(Protocol):
    """An example for a regression: its scene and its right answer."""

    @property
    def scene(self) -> str:
        """Name shared by the episodes of one scene."""
        ...

    @property
    def gold(self) -> int:
        """The class to predict."""
        ...


_Labelled = TypeVar("_Labelled", bound=Labelled)


def regressed(views: Sequence[_Labelled], words: Callable[[_Labelled], Iterable[Hashable]]) -> Guesses:
    """Return the guesses of a multinomial logistic regression that learns from earlier blocks of scenes. Its features
    are the words that `words` yields for each view.
    """
    guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
    gold = np.array([view.gold for view in views], dtype=np.int64)
    features = word_features([words(view) for view in views])
    fits = []
    for learned, guessed in progressive([view.scene for view in views]):
        if features.shape[1] == 0 or (gold[learned] == gold[learned[0]]).all():
            guesses[guessed] = gold[learned[0]]
        else:
            fits.append((learned, guessed))
    if fits:
        inside = np.zeros((len(views), len(fits)), dtype=np.bool_)
        for k, (learned, _) in enumerate(fits):
            inside[learned, k] = True
        classes, answers = np.unique(gold, return_inverse=True)
        scores = fitted_scores(features, answers, inside)
        for k, (_, guessed) in enumerate(fits):
            own = scores[guessed, :, k]
            guesses[guessed] = classes[(own >= own.max(axis=1, keepdims=True) - TIE).argmax(axis=1)]
    return guesses


def word_features(texts: Sequence[Iterable[Hashable]]) -> csr_matrix:
    """Return the feature matrix (episodes, words): 1 where a text contains the word. Very rare and very common words
    are left out.
    """
    index: dict[Hashable, int] = {}
    rows = [{index.setdefault(word, len(index)) for word in words} for words in texts]
    lengths = np.fromiter(map(len, rows), dtype=np.int64, count=len(rows))
    columns = np.fromiter(chain.from_iterable(rows), dtype=np.int64, count=int(lengths.sum()))
    counts = np.bincount(columns, minlength=len(index))
    fit = (counts >= LEAST_TEXTS) & (counts <= MOST_TEXTS * len(rows))
    kept = fit[columns]
    left = np.bincount(np.repeat(np.arange(len(rows)), lengths)[kept], minlength=len(rows))
    offsets = np.concatenate([[0], np.cumsum(left)])
    columns = (np.cumsum(fit) - 1)[columns[kept]]
    return csr_matrix((np.ones(len(columns)), columns, offsets), shape=(len(rows), int(fit.sum())))


def fitted_scores(features: csr_matrix, gold: NDArray[np.int64], inside: Bools) -> F64:
    """Fit a regression to each set of texts, and return the scores (texts, classes, fits) that it gives to all texts;
    −∞ for classes that the set does not have.

    Parameters
    ----------
    features : (texts, words)
    gold : (texts,) classes from 0
    inside : (texts, fits), which texts a fit learns from; at least two classes in each
    """
    fits = _Fits.of(features, gold, inside)
    weights = np.zeros((fits.table.shape[1], *fits.absent.shape))
    scores, at = np.empty(fits.hot.shape), np.arange(inside.shape[1])
    for _ in range(NEWTON_STEPS):
        found = fits.scores(weights)
        shares = fits.shares(found)
        gradient = fits.gradient(weights, shares)
        scores[:, :, at] = found
        running = _dot(gradient, gradient) > TOLERANCE**2
        if not running.any():
            break
        at, fits = at[running], fits.subset(running)
        weights = fits.step(*(part[:, :, running] for part in (weights, gradient, found, shares)))
    return scores


def _dot(one: F64, other: F64) -> F64:
    """Return, for each fit, the scalar product of its vectors in `one` and in `other`. Both arrays have the shape
    (words, classes, fits), the result has the shape (fits,).
    """
    found: F64 = np.einsum("wcf,wcf->f", one, other)
    return found


@dataclass(frozen=True)
class _Fits:
    """Losses of fits side by side. Weights have the shape (words and intercept, classes, fits).

    table, transposed : (texts, words and intercept), the features and a column of ones; and its transpose
    hot : (texts, classes, fits), 1 for the right class of a text that a fit learns from
    inside : (texts, 1, fits), 1 for the texts that a fit learns from
    absent : (classes, fits), 0 for the classes that a fit has, else −∞
    penalty : (words and intercept, 1, fits), 0 for the intercept
    """

    table: csr_matrix
    transposed: csr_matrix
    hot: F64
    inside: F64
    absent: F64
    penalty: F64

    @classmethod
    def of(cls, features: csr_matrix, gold: NDArray[np.int64], inside: Bools) -> _Fits:
        """Return the losses of the fits that :func:`fitted_scores` makes from the same arguments."""
        table = _with_ones(features)
        hot = ((gold[:, None] == np.arange(gold.max() + 1))[:, :, None] & inside[:, None, :]).astype(np.float64)
        absent = np.where(hot.any(axis=0), 0.0, -np.inf)
        penalty = np.full((table.shape[1], 1, inside.shape[1]), PENALTY)
        # Two classes have one weight vector w in scikit-learn. Here each has its own, w/2 and −w/2: half the norm.
        penalty[:, :, (absent == 0.0).sum(axis=0) == 2] *= 2.0
        penalty[-1] = 0.0
        return cls(table, table.T.tocsr(), hot, inside[:, None, :].astype(np.float64), absent, penalty)

    def subset(self, mask: Bools) -> _Fits:
        """Return the fits in `mask`."""
        parts = (part[..., mask] for part in (self.hot, self.inside, self.absent, self.penalty))
        return self if mask.all() else _Fits(self.table, self.transposed, *parts)

    def scores(self, weights: F64) -> F64:
        """Return the score of each class for each text, (texts, classes, fits)."""
        return _times(self.table, weights) + self.absent

    def loss(self, weights: F64, scores: F64) -> F64:
        """Return the loss of each fit, (fits,); `scores` are those of the weights."""
        top = scores.max(axis=1, keepdims=True)
        logs = (np.log(np.exp(scores - top).sum(axis=1, keepdims=True)) + top) * self.inside
        right = np.where(self.hot > 0.0, scores, 0.0).sum(axis=1, keepdims=True)
        found: F64 = (logs - right).sum(axis=(0, 1)) + _dot(self.penalty * weights, weights) / 2
        return found

    def gradient(self, weights: F64, shares: F64) -> F64:
        """Return the gradient of the loss; `shares` are those of the weights."""
        return _times(self.transposed, shares - self.hot) + self.penalty * weights

    def step(self, weights: F64, gradient: F64, scores: F64, shares: F64) -> F64:
        """Return the weights after one step of Newton's method, from the weights with this gradient, these scores and
        shares. In each fit, the step is halved until it lowers the loss enough.
        """
        ahead = self._direction(gradient, shares)
        slope, loss = _dot(gradient, ahead), self.loss(weights, scores)
        length = np.ones(len(slope))
        for _ in range(HALVINGS):
            new = weights + length * ahead
            # Near the minimum the loss changes by less than its rounding.
            high = self.loss(new, self.scores(new)) > loss + LEAST_DESCENT * length * slope + ROUNDING * loss
            if not high.any():
                break
            length[high] /= 2
        return new

    def shares(self, scores: F64) -> F64:
        """Return, for each fit, the probability of each class for each text by these scores; 0 for texts that the fit
        does not learn from.
        """
        odds = np.exp(scores - scores.max(axis=1, keepdims=True))
        found: F64 = odds * (self.inside / odds.sum(axis=1, keepdims=True))
        return found

    def _direction(self, gradient: F64, shares: F64) -> F64:
        """Return the direction of Newton's step, found by conjugate gradients (Nocedal and Wright, algorithm 5.2)."""
        left, found = gradient.copy(), np.zeros_like(gradient)
        ahead = -left
        square = _dot(left, left)
        enough = square * np.minimum(FORCING**2, square)
        for _ in range(GRADIENT_STEPS):
            running = square > enough
            if not running.any():
                break
            spread = _times(self.table, ahead)
            spread -= np.einsum("tcf,tcf->tf", shares, spread)[:, None]
            spread *= shares
            curved = _times(self.transposed, spread)
            curved += self.penalty * ahead
            length = np.where(running, square / np.where(running, _dot(ahead, curved), 1.0), 0.0)
            curved *= length
            left += curved
            found += length * ahead
            before, square = square, _dot(left, left)
            ahead *= np.where(running, square / np.where(running, before, 1.0), 0.0)
            ahead -= left
        return found


def _with_ones(features: csr_matrix) -> csr_matrix:
    """Return `features` with a last column of ones."""
    texts, words = features.shape
    places = np.insert(features.indices, features.indptr[1:], words)
    starts = features.indptr + np.arange(texts + 1, dtype=features.indptr.dtype)
    return csr_matrix((np.ones(len(places)), places, starts), shape=(texts, words + 1))


def _times(table: csr_matrix, columns: F64) -> F64:
    """Return the matrix product table · columns for each class and fit; `columns` has the shape (columns of the table,
    classes, fits).
    """
    found: F64 = (table @ columns.reshape(len(columns), -1)).reshape(-1, *columns.shape[1:])
    return found
