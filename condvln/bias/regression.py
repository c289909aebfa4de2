"""Multinomial logistic regression on the words of texts, learned from earlier blocks of scenes.

All blocks are fitted side by side, by Newton's method (``newton_direction``). The loss is that of
scikit-learn's ``LogisticRegression``: the sum of the log losses plus ½·λ·‖weights‖², intercepts without penalty, one
weight vector instead of two where there are two classes. It has one minimum, so the guesses do not depend on the
solver; scikit-learn's, run to a small gradient, makes the same ones.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import chain, pairwise
from typing import Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from condvln.bias.blocks import NO_GUESS, progressive
from condvln.bias.newton_direction import TOLERANCE, newton_direction
from condvln.compiled import constant

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
TIE: Final = 1e-3
"""Scores this close are equal, and the first class is guessed: neither rounding nor the solver may decide. Far above
the error of scores, far below what an accuracy depends on.
"""
NEWTON_STEPS: Final = 60
HALVINGS: Final = 30
"""Largest number of times that a Newton step is halved until it lowers the loss."""
LEAST_DESCENT: Final = 1e-4
"""Least share of the descent that its slope promises for which a step is taken (Armijo's rule)."""
ROUNDING: Final = 1e-13


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
            own = scores[guessed, k]
            guesses[guessed] = classes[(own >= own.max(axis=1, keepdims=True) - TIE).argmax(axis=1)]
    return guesses


def word_features(texts: Sequence[Iterable[Hashable]]) -> csr_matrix:
    """Return the feature matrix (episodes, words): 1 where a text contains the word. Very rare and very common words
    are left out.
    """
    index: defaultdict[Hashable, int] = defaultdict()
    index.default_factory = index.__len__
    rows = [[*map(index.__getitem__, words)] for words in texts]
    offsets = np.cumsum([0, *map(len, rows)])
    columns = np.fromiter(chain.from_iterable(rows), dtype=np.int64, count=int(offsets[-1]))
    found = csr_matrix((np.ones(len(columns)), columns, offsets), shape=(len(rows), len(index)))
    found.sum_duplicates()
    found.data[:] = 1.0
    counts = np.bincount(found.indices, minlength=len(index))
    fit = (counts >= LEAST_TEXTS) & (counts <= MOST_TEXTS * len(rows))
    return _columns(found, fit)


def _columns(features: csr_matrix, mask: Bools) -> csr_matrix:
    """Return the columns of `features` that are in the mask."""
    kept = mask[features.indices]
    offsets = np.append(0, np.cumsum(kept))[features.indptr]
    columns = (np.cumsum(mask) - 1)[features.indices[kept]]
    return csr_matrix((features.data[kept], columns, offsets), shape=(features.shape[0], int(mask.sum())))


def fitted_scores(features: csr_matrix, gold: NDArray[np.int64], inside: Bools) -> F64:
    """Fit a regression to each set of texts, and return the scores (texts, fits, classes) that it gives to all texts;
    −∞ for classes that the set does not have.

    Parameters
    ----------
    features : (texts, words), 1 where a text contains a word, else 0
    gold : (texts,) classes from 0
    inside : (texts, fits), which texts a fit learns from: all texts of the fit before, and maybe more; at least two
        classes in each
    """
    fits = _Fits.of(features, gold, inside)
    weights = np.zeros(fits.penalty.shape)
    scores, at = np.empty(fits.hot.shape), np.arange(inside.shape[1])
    for _ in range(NEWTON_STEPS):
        found = fits.scores(weights)
        shares = fits.shares(found)
        gradient = fits.gradient(weights, shares)
        scores[:, at] = found
        running = _dot(gradient, gradient) > TOLERANCE**2
        if not running.any():
            break
        if not running.all():
            at, fits = at[running], fits.subset(running)
            weights, gradient, found, shares = (part[:, running] for part in (weights, gradient, found, shares))
        weights = fits.step(weights, gradient, found, shares)
    return scores


def _dot(one: F64, other: F64) -> F64:
    """Return, for each fit, the scalar product of its vectors in `one` and in `other`. Both arrays have the shape
    (words, fits, classes), the result has the shape (fits,).
    """
    found: F64 = np.einsum("wfc,wfc->f", one, other)
    return found


@dataclass(frozen=True)
class _Fits:
    """Losses of fits side by side. Weights have the shape (words and intercept, fits, classes).

    words : (texts, words), the features; equal columns are one
    hot : (texts, fits, classes), 1 for the right class of a text that a fit learns from
    inside : (texts, fits, 1), 1 for the texts that a fit learns from
    absent : (fits, classes), 0 for the classes that a fit has, else −∞
    penalty : (words and intercept, fits, classes), 0 for the intercept
    """

    words: csr_matrix
    hot: F64
    inside: F64
    absent: F64
    penalty: F64

    @classmethod
    def of(cls, features: csr_matrix, gold: NDArray[np.int64], inside: Bools) -> _Fits:
        """Return the losses of the fits that :func:`fitted_scores` makes from the same arguments."""
        words, times = _different(features)
        hot = ((gold[:, None] == np.arange(gold.max() + 1))[:, None] & inside[:, :, None]).astype(np.float64)
        absent = np.where(hot.any(axis=0), 0.0, -np.inf)
        # Words that always occur together have equal weights. One weight, their sum, stands for them: the sum of their
        # squares is its square by their number.
        penalty = np.append(PENALTY / times, 0.0)[:, None, None] * np.ones(absent.shape)
        # Two classes have one weight vector w in scikit-learn. Here each has its own, w/2 and −w/2: half the norm.
        penalty[:, (absent == 0.0).sum(axis=1) == 2] *= 2.0
        return cls(words, hot, inside[:, :, None].astype(np.float64), absent, penalty)

    def subset(self, mask: Bools) -> _Fits:
        """Return the fits in `mask`."""
        return _Fits(self.words, self.hot[:, mask], self.inside[:, mask], self.absent[mask], self.penalty[:, mask])

    def scores(self, weights: F64) -> F64:
        """Return the score of each class for each text, (texts, fits, classes)."""
        products = self.words @ weights[:-1].reshape(len(weights) - 1, -1)
        found: F64 = products.reshape(-1, *weights.shape[1:]) + (weights[-1] + self.absent)
        return found

    def loss(self, weights: F64, scores: F64) -> F64:
        """Return the loss of each fit, (fits,); `scores` are those of the weights."""
        top = _over_classes(np.maximum, scores)
        logs = (np.log(_over_classes(np.add, np.exp(scores - top[..., None]))) + top) * self.inside[..., 0]
        right = _over_classes(np.add, np.where(self.hot > 0.0, scores, 0.0))
        found: F64 = (logs - right).sum(axis=0) + _dot(self.penalty * weights, weights) / 2
        return found

    def gradient(self, weights: F64, shares: F64) -> F64:
        """Return the gradient of the loss; `shares` are those of the weights."""
        found: F64 = self.penalty * weights
        excess = shares - self.hot
        found[:-1] += (self.words.T @ excess.reshape(len(excess), -1)).reshape(-1, *excess.shape[1:])
        found[-1] += excess.sum(axis=0)
        return found

    def step(self, weights: F64, gradient: F64, scores: F64, shares: F64) -> F64:
        """Return the weights after one step of Newton's method, from the weights with this gradient, these scores and
        shares. In each fit, the step is halved until it lowers the loss enough.
        """
        ahead = self._direction(gradient, shares)
        slope, loss = _dot(gradient, ahead), self.loss(weights, scores)
        length = np.ones(len(slope))
        for _ in range(HALVINGS):
            new = weights + length[:, None] * ahead
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
        odds = np.exp(scores - _over_classes(np.maximum, scores)[..., None])
        odds *= self.inside / _over_classes(np.add, odds)[..., None]
        return odds

    def _direction(self, gradient: F64, shares: F64) -> F64:
        """Return the direction of Newton's step."""
        starts, words = (one.astype(np.uint32) for one in (self.words.indptr, self.words.indices))
        begins = (self.inside == 0.0).sum(axis=(1, 2)).astype(np.uint32)
        shares, slope, penalty = (
            np.ascontiguousarray(one).reshape(len(one), -1) for one in (shares, gradient, self.penalty)
        )
        found = newton_direction(starts, words, begins, shares, slope, penalty, constant(gradient.shape[2]))
        return found.reshape(gradient.shape)


def _over_classes(operation: np.ufunc, values: F64) -> F64:
    """Return what `operation` makes of the values of all classes, the last axis. NumPy's own reduction takes several
    times as long over so short an axis.
    """
    found: F64 = reduce(operation, np.moveaxis(values, -1, 0))
    return found


def _different(features: csr_matrix) -> tuple[csr_matrix, NDArray[np.int64]]:
    """Return the different columns of `features`, and how often each of them occurs."""
    columns = features.tocsc()
    first: dict[bytes, int] = {}
    number = [
        first.setdefault(columns.indices[begin:end].tobytes(), len(first)) for begin, end in pairwise(columns.indptr)
    ]
    _, at, times = np.unique(number, return_index=True, return_counts=True)
    return columns[:, at].tocsr(), times
