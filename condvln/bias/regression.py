"""Multinomial logistic regression on the words of texts, learned from earlier blocks of scenes.

All blocks are fitted side by side, by Newton's method (``newton_direction``). The loss is that of
scikit-learn's ``LogisticRegression``: the sum of the log losses plus ½·λ·‖weights‖², intercepts without penalty, one
weight vector instead of two where there are two classes. It has one minimum, so the guesses do not depend on the
solver; scikit-learn's, run to a small gradient, makes the same ones.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any, Final, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, csr_matrix

from condvln.bias.blocks import NO_GUESS, progressive
from condvln.bias.newton_direction import (
    LANES,
    TOLERANCE,
    Lists,
    Preconditioner,
    add_rows,
    head_factor,
    newton_direction,
    share_out,
)
from condvln.compiled import constant

__all__ = [
    "Guesses",
    "Labelled",
    "Occurrences",
    "coded_features",
    "combined",
    "dense",
    "fitted_scores",
    "guessed_from",
    "regressed",
    "word_features",
]

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
MOST_SPARSE: Final = 64
"""Largest ratio of the largest of some numbers to their count for which a table is made of them, not a sorted copy."""
MOST_IN_HEAD: Final = 256
"""Largest number of words, the most frequent ones, whose products are in the preconditioner."""


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

Occurrences = tuple[NDArray[np.integer[Any]], NDArray[np.integer[Any]]]
"""Features of one kind: the index of a text, ascending, and the number of a feature that it has, each in one array."""


def regressed(views: Sequence[_Labelled], words: Callable[[_Labelled], Iterable[Hashable]]) -> Guesses:
    """Return the guesses of a multinomial logistic regression that learns from earlier blocks of scenes. Its features
    are the words that `words` yields for each view.
    """
    return _guesses(views, word_features([words(view) for view in views]))


def guessed_from(views: Sequence[_Labelled], features: csc_matrix) -> Guesses:
    """Return the guesses of :func:`regressed` from the features that :func:`coded_features` returns."""
    return _guesses(views, _usual(features))


def _guesses(views: Sequence[_Labelled], features: csc_matrix) -> Guesses:
    guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
    gold = np.array([view.gold for view in views], dtype=np.int64)
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


def word_features(texts: Sequence[Iterable[Hashable]]) -> csc_matrix:
    """Return the feature matrix (episodes, words): 1 where a text contains the word. Very rare and very common words
    are left out.
    """
    index: defaultdict[Hashable, int] = defaultdict()
    index.default_factory = index.__len__
    rows = [[*map(index.__getitem__, words)] for words in texts]
    columns = np.array([*chain.from_iterable(rows)], dtype=np.int64)
    return _usual(coded_features(len(rows), [(np.repeat(np.arange(len(rows)), [*map(len, rows)]), columns)]))


def coded_features(texts: int, kinds: Iterable[Occurrences]) -> csc_matrix:
    """Return the matrix (texts, features) of features of several kinds: 1 where a text has the feature."""
    places, width = [], 0
    for row, code in kinds:
        number = dense(code)
        places.append((number + width) * texts + row)
        width += int(number.max(initial=-1)) + 1
    # Sorted by features, then by texts, as the matrix is stored; half as long numbers take half of the time.
    found: NDArray[np.integer[Any]] = np.concatenate(places)
    found = found.astype(np.int32 if width * texts < 1 << 31 else np.int64)
    found.sort()
    found = found[np.append(True, found[1:] != found[:-1])] if len(found) else found
    columns = found // max(texts, 1)
    begins = np.append(0, np.cumsum(np.bincount(columns, minlength=width)))
    return csc_matrix((np.ones(len(found)), found - columns * texts, begins), shape=(texts, width))


def _usual(features: csc_matrix) -> csc_matrix:
    """Return `features` without very rare and very common ones."""
    counts = np.diff(features.indptr)
    return _columns(features, np.flatnonzero((counts >= LEAST_TEXTS) & (counts <= MOST_TEXTS * features.shape[0])))


def _columns(features: csc_matrix, chosen: NDArray[np.integer[Any]]) -> csc_matrix:
    """Return the columns of `features` with the numbers `chosen`, in this order."""
    sizes = np.diff(features.indptr)[chosen]
    begins = np.append(0, np.cumsum(sizes))
    members = features.indices[np.repeat(features.indptr[chosen] - begins[:-1], sizes) + np.arange(begins[-1])]
    return csc_matrix((np.ones(len(members)), members, begins), shape=(features.shape[0], len(chosen)))


def combined(*codes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return one number for each combination of numbers from 0; the arrays are equally long."""
    found = codes[0]
    for code in codes[1:]:
        found = dense(found) * (code.max(initial=0) + 1) + code
    return found


def dense(codes: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Return numbers from 0 without gaps, in the order of `codes`, which are not below 0."""
    most = int(codes.max(initial=0))
    if most > MOST_SPARSE * (len(codes) + MOST_SPARSE):
        number: NDArray[np.int64] = np.unique(codes, return_inverse=True)[1].reshape(-1)
        return number
    seen = np.zeros(most + 1, dtype=np.int64)
    seen[codes] = 1
    found: NDArray[np.int64] = (np.cumsum(seen) - 1)[codes]
    return found


def fitted_scores(features: csr_matrix | csc_matrix, gold: NDArray[np.int64], inside: Bools) -> F64:
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
    scores, at = np.empty(fits.hot.shape), np.arange(inside.shape[1])
    found = fits.at(np.zeros((len(fits.penalty), *fits.hot.shape[1:])))
    for _ in range(NEWTON_STEPS):
        gradient = fits.gradient(found)
        scores[:, at] = found.scores
        running = _dot(gradient, gradient) > TOLERANCE**2
        if not running.any():
            break
        if not running.all():
            at, fits, found, gradient = at[running], fits.subset(running), found.subset(running), gradient[:, running]
        found = fits.step(found, gradient)
    return scores


def _dot(one: F64, other: F64) -> F64:
    """Return, for each fit, the scalar product of its vectors in `one` and in `other`. Both arrays have the shape
    (words, fits, classes), the result has the shape (fits,).
    """
    found: F64 = np.einsum("wfc,wfc->f", one, other)
    return found


class _Place(NamedTuple):
    """Weights of fits side by side, (words, fits, classes), and what follows from them.

    scores : (texts, fits, classes), of each class for each text
    shares : (texts, fits, classes), the probabilities of the classes; 0 for texts that a fit does not learn from
    loss : (fits,)
    """

    weights: F64
    scores: F64
    shares: F64
    loss: F64

    def subset(self, mask: Bools) -> _Place:
        """Return the weights of the fits in `mask`."""
        return _Place(self.weights[:, mask], self.scores[:, mask], self.shares[:, mask], self.loss[mask])


@dataclass(frozen=True)
class _Fits:
    """Losses of fits side by side. Weights have the shape (words, fits, classes).

    words, texts : the words of each text and the texts of each word: first the intercept, which is in all texts, then
        the features, the most frequent one first; equal features are one
    gold : (texts,), the right class of each text
    inside : (texts, fits), which texts a fit learns from
    hot : (texts, fits, classes), 1 for the right class of a text that a fit learns from
    absent : (fits, classes), 0 for the classes that a fit has, else −∞
    penalty : (words, fits, 1), 0 for the intercept
    """

    words: Lists
    texts: Lists
    gold: NDArray[np.int64]
    inside: Bools
    hot: F64
    absent: F64
    penalty: F64
    preconditioner: Preconditioner

    @classmethod
    def of(cls, features: csr_matrix | csc_matrix, gold: NDArray[np.int64], inside: Bools) -> _Fits:
        """Return the losses of the fits that :func:`fitted_scores` makes from the same arguments."""
        columns, times = _different(features)
        hot = ((gold[:, None] == np.arange(gold.max() + 1))[:, None] & inside[:, :, None]).astype(np.float64)
        absent = np.where(hot.any(axis=0), 0.0, -np.inf)
        # Words that always occur together have equal weights. One weight, their sum, stands for them: the sum of their
        # squares is its square by their number.
        penalty = np.append(0.0, PENALTY / times)[:, None, None] * np.ones((len(absent), 1))
        # Two classes have one weight vector w in scikit-learn. Here each has its own, w/2 and −w/2: half the norm.
        penalty[:, (absent == 0.0).sum(axis=1) == 2] *= 2.0
        words, middle = columns.tocsr(), len(absent) // 2
        classes = int((absent[middle] == 0.0).sum())
        near = _preconditioner(words[inside[:, middle]], penalty[:, middle, 0], classes)
        lists = _lists(words), _lists(columns)
        return cls(*lists, gold.astype(np.int64), np.ascontiguousarray(inside), hot, absent, penalty, near)

    def subset(self, mask: Bools) -> _Fits:
        """Return the fits in `mask`."""
        inside = np.ascontiguousarray(self.inside[:, mask])
        hot, penalty = (one[:, mask] for one in (self.hot, self.penalty))
        absent = self.absent[mask]
        return _Fits(self.words, self.texts, self.gold, inside, hot, absent, penalty, self.preconditioner)

    def at(self, weights: F64) -> _Place:
        """Return the scores, shares and losses of these weights."""
        scores = _sums(self.words, weights)
        scores += self.absent
        shares, loss = np.zeros_like(scores), _dot(self.penalty * weights, weights) / 2
        share_out(scores, self.gold, self.inside, shares, loss)
        return _Place(weights, scores, shares, loss)

    def gradient(self, place: _Place) -> F64:
        """Return the gradient of the loss."""
        found: F64 = self.penalty * place.weights + _sums(self.texts, place.shares - self.hot)
        return found

    def step(self, place: _Place, gradient: F64) -> _Place:
        """Return where one step of Newton's method leads from the weights with this gradient. In each fit, the step is
        halved until it lowers the loss enough.
        """
        ahead = self._direction(gradient, place.shares)
        slope, loss = _dot(gradient, ahead), place.loss
        length = np.ones(len(slope))
        for _ in range(HALVINGS):
            new = self.at(place.weights + length[:, None] * ahead)
            # Near the minimum the loss changes by less than its rounding.
            high = new.loss > loss + LEAST_DESCENT * length * slope + ROUNDING * loss
            if not high.any():
                break
            length[high] /= 2
        return new

    def _direction(self, gradient: F64, shares: F64) -> F64:
        """Return the direction of Newton's step."""
        fits, classes = gradient.shape[1:]
        penalty = np.broadcast_to(self.penalty, gradient.shape)
        found = newton_direction(
            *self.words,
            *self.texts,
            _whole_vectors(shares),
            _whole_vectors(gradient),
            _whole_vectors(penalty),
            *self.preconditioner,
            constant(fits),
            constant(classes),
        )
        return found[:, : fits * classes].reshape(gradient.shape).astype(np.float64)


def _sums(lists: Lists, values: F64) -> F64:
    """Return for each list the sum of the rows of `values` that it names."""
    found = np.zeros((len(lists.begins) - 1, *values.shape[1:]))
    add_rows(*lists, np.ascontiguousarray(values).reshape(len(values), -1), found.reshape(len(found), -1))
    return found


def _whole_vectors(values: F64) -> NDArray[np.float32]:
    """Return the rows of `values` in single precision, each followed by zeros up to a multiple of `LANES`."""
    columns = math.prod(values.shape[1:])
    found = np.zeros((len(values), -(-columns // LANES) * LANES), dtype=np.float32)
    found[:, :columns] = values.reshape(len(values), -1)
    return found


def _preconditioner(learned: csr_matrix, penalty: F64, classes: int) -> Preconditioner:
    """Return an approximate inverse of the Hessian of a fit: that for equal shares, without the products of two words
    one of which is rare. It suits fits to more and to fewer texts well enough.

    learned : (texts, words) of the texts that the fit learns from; penalty : (words,)
    """
    # The factor of so many words costs half as much in each step as the words of the texts.
    size = min(learned.shape[1], MOST_IN_HEAD, math.isqrt(learned.nnz))
    most_frequent = np.ascontiguousarray(penalty[:size])
    factor = head_factor(*_lists(learned), constant(learned.shape[0]), most_frequent, 1.0 / classes)
    inverse = 1.0 / (penalty + np.bincount(learned.indices, minlength=len(penalty)) / classes)
    return Preconditioner(factor.astype(np.float32), inverse.astype(np.float32))


def _lists(words: csr_matrix | csc_matrix) -> Lists:
    """Return the words of each text; of a matrix in columns, the texts of each word."""
    return Lists(words.indptr.astype(np.uint32), words.indices.astype(np.uint32))


def _different(features: csr_matrix | csc_matrix) -> tuple[csc_matrix, NDArray[np.int64]]:
    """Return the different columns of `features`, the most frequent words first, after a column of ones, and how often
    each of them occurs.
    """
    columns, texts = features.tocsc(), features.shape[0]
    numbers: dict[bytes, int] = {}
    number: list[int] = []
    at: list[int] = []
    for k, (begin, end) in enumerate(pairwise(columns.indptr.tolist())):
        number.append(numbers.setdefault(columns.indices[begin:end].tobytes(), len(numbers)))
        if number[-1] == len(at):
            at.append(k)
    order = np.argsort(-np.diff(columns.indptr)[at], kind="stable")
    words = _columns(columns, np.array(at, dtype=np.int64)[order])
    members, begins = np.append(np.arange(texts), words.indices), np.append(0, texts + words.indptr)
    found = csc_matrix((np.ones(len(members)), members, begins), shape=(texts, len(at) + 1))
    return found, np.bincount(number)[order]
