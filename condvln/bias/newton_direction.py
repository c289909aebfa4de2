"""The direction of a Newton step for many logistic regressions side by side, as one compiled kernel.

The regressions are fitted to the same texts. Each learns from all texts that the one before learns from, and from more:
so the regressions that have a text are the last ones, and the kernel leaves out the others.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import compiled, constant, inlined, register_warm_up

__all__ = ["GRADIENT_STEPS", "TOLERANCE", "Preconditioner", "head_factor", "newton_direction"]

F64 = NDArray[np.float64]
U32 = NDArray[np.uint32]

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


class Preconditioner(NamedTuple):
    """An approximate inverse of the Hessian, the same one for each class of each fit. With it, the conjugate gradients
    converge in a third of the steps.

    factor : (head, head) Cholesky factor of :func:`head_factor`, for the first words
    inverse : (words,) inverses of the diagonal, for the other words
    """

    factor: F64
    inverse: F64


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
def newton_direction(
    starts: U32,
    words: U32,
    begins: U32,
    shares: F64,
    gradient: F64,
    penalty: F64,
    factor: F64,
    inverse: F64,
    classes: int,
) -> F64:
    """Return the direction of Newton's step, found by preconditioned conjugate gradients (Nocedal and Wright, algorithm
    5.3).

    Columns are the classes of the first fit, then those of the second one, and so on. The intercept is the weight of
    the word 0, which is in all texts.

    Parameters
    ----------
    starts, words : (texts + 1,) and (entries,), the words of text t are ``words[starts[t]:starts[t + 1]]``, ascending
    begins : (texts,) number of fits that do not learn from a text: it is in all fits after these
    shares : (texts, columns) probability of each class for each text, 0 where a fit does not learn from it
    gradient : (words, columns)
    penalty : (words, fits)
    factor, inverse : the preconditioner
    classes : number of classes of each fit

    Returns
    -------
    direction : (words, columns)
    """
    columns = gradient.shape[1]
    left, ahead, found = gradient.copy(), np.zeros_like(gradient), np.zeros_like(gradient)
    near, curved, spread = np.empty_like(gradient), np.empty_like(gradient), np.empty(columns)
    sums, length = np.zeros(columns), np.zeros(columns)
    fits = columns // classes
    square, known, enough = np.zeros(fits), np.ones(fits), np.zeros(fits)
    for step in range(GRADIENT_STEPS + 1):
        sums[:] = 0.0
        for word in range(len(gradient)):
            for j in range(columns):
                sums[j] += left[word, j] * left[word, j]
        low = columns
        for fit in range(fits - 1, -1, -1):
            square[fit] = 0.0
            for j in range(fit * classes, (fit + 1) * classes):
                square[fit] += sums[j]
            if step == 0:
                enough[fit] = max(square[fit] * min(FORCING**2, square[fit]), FLOOR**2)
            if square[fit] > enough[fit]:
                low = fit * classes
        if low == columns or step == GRADIENT_STEPS:
            break
        _precondition(factor, inverse, left, low, near)
        sums[:] = 0.0
        for word in range(len(gradient)):
            for j in range(low, columns):
                sums[j] += left[word, j] * near[word, j]
        for fit in range(low // classes, fits):
            total = 0.0
            for j in range(fit * classes, (fit + 1) * classes):
                total += sums[j]
            for j in range(fit * classes, (fit + 1) * classes):
                length[j] = total / known[fit] if step else 0.0
            known[fit] = total if total > 0.0 else 1.0
        for word in range(len(gradient)):
            for j in range(low, columns):
                ahead[word, j] = length[j] * ahead[word, j] - near[word, j]
        _curve(starts, words, begins, shares, ahead, penalty, classes, low, curved, spread)
        sums[:] = 0.0
        for word in range(len(gradient)):
            for j in range(low, columns):
                sums[j] += ahead[word, j] * curved[word, j]
        for fit in range(low // classes, fits):
            total = 0.0
            for j in range(fit * classes, (fit + 1) * classes):
                total += sums[j]
            # A fit that is done stays where it is.
            for j in range(fit * classes, (fit + 1) * classes):
                length[j] = known[fit] / total if square[fit] > enough[fit] else 0.0
        for word in range(len(gradient)):
            for j in range(low, columns):
                found[word, j] += length[j] * ahead[word, j]
                left[word, j] += length[j] * curved[word, j]
    return found


@inlined
def _precondition(factor: F64, inverse: F64, left: F64, low: int, near: F64) -> None:
    """Write the product of the preconditioner and `left` to `near`, for the columns from `low` on."""
    size, columns = len(factor), left.shape[1]
    for word in range(len(left)):
        scale = inverse[word] if word >= size else 1.0
        for j in range(low, columns):
            near[word, j] = scale * left[word, j]
    for i in range(size):
        row = near[i, low:]
        for j in range(len(row)):
            row[j] /= factor[i, i]
        for k in range(i + 1, size):
            below = near[k, low:]
            for j in range(len(row)):
                below[j] -= factor[i, k] * row[j]
    for i in range(size - 1, -1, -1):
        row = near[i, low:]
        for k in range(i + 1, size):
            below = near[k, low:]
            for j in range(len(row)):
                row[j] -= factor[i, k] * below[j]
        for j in range(len(row)):
            row[j] /= factor[i, i]


@inlined
def _curve(
    starts: U32,
    words: U32,
    begins: U32,
    shares: F64,
    ahead: F64,
    penalty: F64,
    classes: int,
    low: int,
    curved: F64,
    spread: F64,
) -> None:
    """Write the product of the Hessian and `ahead` to `curved`, for the columns from `low` on."""
    for word in range(len(ahead)):
        for j in range(low, ahead.shape[1]):
            curved[word, j] = penalty[word, j // classes] * ahead[word, j]
    for text in range(len(begins)):
        first = max(low, begins[text] * classes)
        row, share = spread[first:], shares[text, first:]
        row[:] = 0.0
        for at in range(starts[text], starts[text + 1]):
            one = ahead[words[at], first:]
            for j in range(len(row)):
                row[j] += one[j]
        for begin in range(0, len(row), classes):
            mean = 0.0
            for j in range(begin, begin + classes):
                mean += share[j] * row[j]
            for j in range(begin, begin + classes):
                row[j] = (row[j] - mean) * share[j]
        for at in range(starts[text], starts[text + 1]):
            one = curved[words[at], first:]
            for j in range(len(row)):
                one[j] += row[j]


def _warm_up() -> None:
    starts, words, begins = (np.array(one, dtype=np.uint32) for one in ([0, 1, 2], [0, 0], [0, 0]))
    factor = head_factor(starts, words, constant(2), np.ones(1), 0.5)
    shares = np.full((2, 2), 0.5)
    newton_direction(starts, words, begins, shares, np.ones((1, 2)), np.ones((1, 1)), factor, np.ones(1), constant(2))


register_warm_up("regressions of the bias gate", _warm_up)
