"""Multinomial logistic regression on the words of texts, learned from earlier blocks of scenes.

The model is scikit-learn's ``LogisticRegression``: the sum of the log losses plus ½·λ·‖weights‖², intercepts without
penalty. Its loss has one minimum, so the guesses depend neither on the solver nor on rounding (``TIE``).
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from itertools import chain
from typing import Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from condvln.arrays import F64

__all__ = [
    "BLOCKS",
    "NO_GUESS",
    "Guesses",
    "Indices",
    "Labelled",
    "blocks",
    "progressive",
    "regressed",
    "word_features",
]

NO_GUESS: Final = -1
"""The guess in the first block, which is only learned from."""
BLOCKS: Final = 10
"""Number of blocks. The first is only learned from, never guessed."""

Indices = NDArray[np.int64]


def blocks(scenes: Sequence[str], count: int = BLOCKS) -> list[Indices]:
    """Split episodes into about `count` blocks of similar size, and return the ascending episode indices of each block.

    All episodes of a scene are in one block; no block is empty.

    Parameters
    ----------
    scenes : the scene of each episode
    """
    names = sorted(set(scenes), key=lambda name: hashlib.blake2b(name.encode(), digest_size=8).digest())
    rank = {name: k for k, name in enumerate(names)}
    place = np.array([rank[scene] for scene in scenes], dtype=np.int64)
    sizes = np.bincount(place, minlength=len(names))
    # A scene belongs to the block in which the middle of its episodes falls, so that blocks are about equally large.
    middles = (np.cumsum(sizes) - sizes / 2) / max(1, sizes.sum())
    block = np.floor(middles * count).astype(np.int64)
    found = [np.flatnonzero(block[place] == k) for k in range(count)] if len(place) else []
    return [indices for indices in found if len(indices)]


def progressive(scenes: Sequence[str], count: int = BLOCKS) -> Iterator[tuple[Indices, Indices]]:
    """Yield, for each block after the first, two arrays of episode indices: the episodes of all earlier blocks, to
    learn from, and the episodes of the block itself, to guess. The first array begins with the first array of the block
    before, in the same order.
    """
    parts = blocks(scenes, count)
    for k in range(1, len(parts)):
        yield np.concatenate(parts[:k]), parts[k]


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
"""Log-probabilities this close are equal, and the first class is guessed: neither rounding nor the solver may decide.
Far above the solver's error, far below what an accuracy depends on.
"""
TOLERANCE: Final = 1e-6
"""Largest entry of the gradient of the mean loss at which a fit ends. Log-probabilities are then within a tenth of
``TIE`` of those at the minimum.
"""
MOST_ITERATIONS: Final = 1_000
FEW_ENTRIES: Final = 1_000_000
"""A feature matrix of at most so many entries is dense, with which a fit takes half of the time."""


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
    features = word_features([words(view) for view in views])
    guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
    gold = np.array([view.gold for view in views], dtype=np.int64)
    rows = features.toarray() if features.shape[0] * features.shape[1] <= FEW_ENTRIES else features
    for learned, guessed in progressive([view.scene for view in views]):
        if features.shape[1] == 0 or (gold[learned] == gold[learned[0]]).all():
            guesses[guessed] = gold[learned[0]]
        else:
            guesses[guessed] = _predicted(rows[learned], gold[learned], rows[guessed])
    return guesses


def _predicted(learned: csr_matrix | F64, gold: NDArray[np.int64], guessed: csr_matrix | F64) -> Guesses:
    """Fit a regression to the texts `learned`, whose classes are `gold`, and return the class of each text of
    `guessed`.
    """
    # Imported here: the import takes longer than the rest of a small export, and only the gate needs it.
    from sklearn.linear_model import LogisticRegression

    # Over 180 fits of at most 98 texts, lbfgs took 28 times the CPU time of newton-cg, newton-cholesky 150 times.
    model = LogisticRegression(C=1.0 / PENALTY, solver="newton-cg", tol=TOLERANCE, max_iter=MOST_ITERATIONS)
    scores: F64 = model.fit(learned, gold).predict_log_proba(guessed)
    best = (scores >= scores.max(axis=1, keepdims=True) - TIE).argmax(axis=1)
    found: Guesses = model.classes_[best]
    return found


def word_features(texts: Sequence[Iterable[Hashable]]) -> csr_matrix:
    """Return the feature matrix (episodes, words): 1 where a text contains the word. Very rare and very common words
    are left out.
    """
    index: defaultdict[Hashable, int] = defaultdict()
    index.default_factory = index.__len__
    rows = [[index[word] for word in dict.fromkeys(words)] for words in texts]
    columns = np.array([*chain.from_iterable(rows)], dtype=np.int64)
    ends = np.cumsum([0, *map(len, rows)])
    found = csr_matrix((np.ones(len(columns)), columns, ends), shape=(len(rows), len(index)))
    counts = np.bincount(columns, minlength=len(index))
    return found[:, (counts >= LEAST_TEXTS) & (counts <= MOST_TEXTS * len(rows))]
