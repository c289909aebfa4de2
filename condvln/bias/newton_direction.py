"""The direction of a Newton step for many logistic regressions side by side, and what it depends on, as kernels.

The regressions are fitted to the same texts; the shares of a text that one of them does not learn from are 0. The
kernel computes in single precision and on whole vectors: a direction may miss a part of the gradient (`FORCING`). Its
caller computes scores, losses and gradients, by which a fit ends, in double precision.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import compiled, constant, inlined, register_warm_up

__all__ = [
    "GRADIENT_STEPS",
    "LANES",
    "TOLERANCE",
    "Lists",
    "Preconditioner",
    "add_rows",
    "head_factor",
    "newton_direction",
    "share_out",
]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
U32 = NDArray[np.uint32]
Floats = NDArray[np.floating[Any]]

TOLERANCE: Final = 1e-4
"""Norm of the gradient at which a fit ends. A weight of n equal words is then within n/λ of it of the minimum, and a
probability within a tenth of what separates scores (``TIE``).
"""
GRADIENT_STEPS: Final = 300
"""Largest number of conjugate gradient steps within a Newton step."""
FORCING: Final = 0.05
"""Largest residual that the conjugate gradients of a Newton step may leave, as a share of the gradient."""
FLOOR: Final = TOLERANCE / 100
"""Residual at which the conjugate gradients end in any case."""
LANES: Final = 8
"""The kernel's arrays have a multiple of so many columns: processors compute with so many numbers at once, and columns
that are left over would take longer than those.
"""


class Lists(NamedTuple):
    """Lists of numbers from 0, one after the other: list k is ``members[begins[k]:begins[k + 1]]``, ascending."""

    begins: U32
    members: U32


class Preconditioner(NamedTuple):
    """An approximate inverse of the Hessian, the same one for each class of each fit. With it, the conjugate gradients
    converge in a third of the steps.

    factor : (head, head) Cholesky factor of :func:`head_factor`, for the first words
    inverse : (words,) inverses of the diagonal, for the other words
    """

    factor: F32
    inverse: F32


@compiled
def add_rows(begins: U32, members: U32, values: Floats, sums: Floats) -> None:
    """Add to each row k of `sums` the rows of `values` that the list k of some :class:`Lists` names."""
    for k in range(len(begins) - 1):
        own = sums[k]
        at, end = np.int64(begins[k]), np.int64(begins[k + 1])
        # Eight at a time, so that the sums are loaded and stored an eighth as often.
        while at + 8 <= end:
            a, b, c, d = values[members[at]], values[members[at + 1]], values[members[at + 2]], values[members[at + 3]]
            at += 4
            e, f, g, h = values[members[at]], values[members[at + 1]], values[members[at + 2]], values[members[at + 3]]
            at += 4
            for j in range(len(own)):
                own[j] += ((a[j] + b[j]) + (c[j] + d[j])) + ((e[j] + f[j]) + (g[j] + h[j]))
        while at < end:
            one = values[members[at]]
            for j in range(len(own)):
                own[j] += one[j]
            at += 1


@compiled
def head_factor(starts: U32, words: U32, texts: int, penalty: F64, curvature: float) -> F64:
    """Return the factor U, upper triangular, with UᵀU = penalty + curvature · XᵀX, for the first ``len(penalty)``
    words. X has a row for each of the first `texts` texts.
    """
    size = len(penalty)
    found = np.zeros((size, size))
    for k in range(size):
        found[k, k] = penalty[k]
    for text in range(texts):
        for at in range(starts[text], starts[text + 1]):
            if words[at] < size:
                row = found[words[at]]
                for other in range(at, starts[text + 1]):
                    if words[other] < size:
                        row[words[other]] += curvature
    for k in range(size):
        pivot = found[k]
        root = np.sqrt(pivot[k])
        for j in range(k, size):
            pivot[j] /= root
        for i in range(k + 1, size):
            factor, row = pivot[i], found[i]
            for j in range(i, size):
                row[j] -= factor * pivot[j]
    return found


@compiled
def share_out(scores: F64, gold: I64, inside: Bools, shares: F64, losses: F64) -> None:
    """Compute the probabilities of classes from their scores.

    Parameters
    ----------
    scores : (texts, fits, classes), −∞ for classes that a fit does not have
    gold : (texts,) right class of each text
    inside : (texts, fits), which texts a fit learns from
    shares : (texts, fits, classes), zeros; gets the probability of each class for each text that a fit learns from
    losses : (fits,), zeros; gets each fit's sum of the negative logarithms of the right classes' probabilities
    """
    texts, fits, classes = scores.shape
    for text in range(texts):
        for fit in range(fits):
            if inside[text, fit]:
                own, share = scores[text, fit], shares[text, fit]
                top, total = own[0], 0.0
                for k in range(1, classes):
                    top = max(top, own[k])
                for k in range(classes):
                    share[k] = np.exp(own[k] - top)
                    total += share[k]
                for k in range(classes):
                    share[k] /= total
                losses[fit] += np.log(total) + top - own[gold[text]]


@compiled
def newton_direction(
    begins: U32,
    words: U32,
    word_begins: U32,
    texts: U32,
    shares: F32,
    gradient: F32,
    penalty: F32,
    factor: F32,
    inverse: F32,
    fits: int,
    classes: int,
) -> F32:
    """Return the direction of Newton's step, found by preconditioned conjugate gradients (Nocedal and Wright, algorithm
    5.3).

    Columns are the classes of the first fit, then those of the second one, and so on, then columns of zeros up to a
    multiple of `LANES`.

    Parameters
    ----------
    begins, words : :class:`Lists` of the words of each text
    word_begins, texts : :class:`Lists` of the texts of each word
    shares : (texts, columns) probability of each class for each text, 0 where a fit does not learn from it
    gradient : (words, columns)
    penalty : (words, columns)
    factor, inverse : the preconditioner
    fits, classes : number of fits, and of classes of each fit

    Returns
    -------
    direction : (words, columns)
    """
    columns = gradient.shape[1]
    left, ahead, found = gradient.copy(), np.zeros_like(gradient), np.zeros_like(gradient)
    near, curved, spread = np.empty_like(gradient), np.empty_like(gradient), np.empty_like(shares)
    sums, length = np.zeros(columns, dtype=np.float32), np.zeros(columns, dtype=np.float32)
    square, known, enough = np.zeros(fits), np.ones(fits), np.zeros(fits)
    for step in range(GRADIENT_STEPS + 1):
        _products(left, left, sums)
        going = False
        for fit in range(fits):
            square[fit] = 0.0
            for j in range(fit * classes, (fit + 1) * classes):
                square[fit] += sums[j]
            if step == 0:
                enough[fit] = max(square[fit] * min(FORCING**2, square[fit]), FLOOR**2)
            going |= square[fit] > enough[fit]
        if not going or step == GRADIENT_STEPS:
            break
        _precondition(factor, inverse, left, near)
        _products(left, near, sums)
        for fit in range(fits):
            total = 0.0
            for j in range(fit * classes, (fit + 1) * classes):
                total += sums[j]
            for j in range(fit * classes, (fit + 1) * classes):
                length[j] = total / known[fit] if step else 0.0
            known[fit] = total if total > 0.0 else 1.0
        for word in range(len(gradient)):
            for j in range(columns):
                ahead[word, j] = length[j] * ahead[word, j] - near[word, j]
        for text in range(len(spread)):
            for j in range(columns):
                spread[text, j] = np.float32(0.0)
        add_rows(begins, words, ahead, spread)
        _weigh(shares, fits, classes, spread)
        for word in range(len(gradient)):
            for j in range(columns):
                curved[word, j] = penalty[word, j] * ahead[word, j]
        add_rows(word_begins, texts, spread, curved)
        _products(ahead, curved, sums)
        for fit in range(fits):
            total = 0.0
            for j in range(fit * classes, (fit + 1) * classes):
                total += sums[j]
            # A fit that is done stays where it is.
            for j in range(fit * classes, (fit + 1) * classes):
                length[j] = known[fit] / total if square[fit] > enough[fit] else 0.0
        for word in range(len(gradient)):
            for j in range(columns):
                found[word, j] += length[j] * ahead[word, j]
                left[word, j] += length[j] * curved[word, j]
    return found


@compiled
def _products(one: F32, other: F32, sums: F32) -> None:
    """Write the scalar product of the columns of `one` and of `other` to `sums`, for each column."""
    sums[:] = np.float32(0.0)
    for word in range(len(one)):
        for j in range(len(sums)):
            sums[j] += one[word, j] * other[word, j]


@inlined
def _precondition(factor: F32, inverse: F32, left: F32, near: F32) -> None:
    """Write the product of the preconditioner and `left` to `near`."""
    size, columns = len(factor), left.shape[1]
    for word in range(len(left)):
        scale = inverse[word] if word >= size else np.float32(1.0)
        for j in range(columns):
            near[word, j] = scale * left[word, j]
    for i in range(size):
        row = near[i]
        for j in range(columns):
            row[j] /= factor[i, i]
        for k in range(i + 1, size):
            below, scale = near[k], factor[i, k]
            for j in range(columns):
                below[j] -= scale * row[j]
    for i in range(size - 1, -1, -1):
        row = near[i]
        for k in range(i + 1, size):
            below, scale = near[k], factor[i, k]
            for j in range(columns):
                row[j] -= scale * below[j]
        for j in range(columns):
            row[j] /= factor[i, i]


@inlined
def _weigh(shares: F32, fits: int, classes: int, spread: F32) -> None:
    """Turn `spread`, by how much the scores of each text change, into by how much its shares do."""
    for text in range(len(spread)):
        row, share = spread[text], shares[text]
        for begin in range(0, fits * classes, classes):
            mean = np.float32(0.0)
            for j in range(begin, begin + classes):
                mean += share[j] * row[j]
            for j in range(begin, begin + classes):
                row[j] = (row[j] - mean) * share[j]


def _warm_up() -> None:
    begins, members = np.array([0, 1, 2], dtype=np.uint32), np.zeros(2, dtype=np.uint32)
    add_rows(begins, members, np.ones((1, 1)), np.zeros((2, 1)))
    inside, scores = np.ones((1, 1), dtype=np.bool_), np.zeros((1, 1, 2))
    share_out(scores, np.zeros(1, dtype=np.int64), inside, np.zeros_like(scores), np.zeros(1))
    factor = head_factor(begins, members, constant(2), np.ones(1), 0.5).astype(np.float32)
    shares, one = np.full((2, LANES), 0.5, dtype=np.float32), np.ones((1, LANES), dtype=np.float32)
    ends = np.array([0, 2], dtype=np.uint32)
    texts = np.arange(2, dtype=np.uint32)
    near = Preconditioner(factor, one[0, :1].copy())
    newton_direction(begins, members, ends, texts, shares, one, one, *near, constant(1), constant(2))


register_warm_up("regressions of the bias gate", _warm_up)
