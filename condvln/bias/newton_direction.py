"""The direction of a Newton step for many logistic regressions side by side, as one compiled kernel.

The regressions are fitted to the same texts. Each learns from all texts that the one before learns from, and from more:
so the regressions that have a text are the last ones, and the kernel leaves out the others.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import compiled, constant, inlined, register_warm_up

__all__ = ["GRADIENT_STEPS", "TOLERANCE", "newton_direction"]

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


@compiled
def newton_direction(
    starts: U32, words: U32, begins: U32, shares: F64, gradient: F64, penalty: F64, classes: int
) -> F64:
    """Return the direction of Newton's step, found by conjugate gradients (Nocedal and Wright, algorithm 5.2).

    Columns are the classes of the first fit, then those of the second one, and so on; the last row of weights is the
    intercept.

    Parameters
    ----------
    starts, words : (texts + 1,) and (entries,), the words of text t are ``words[starts[t]:starts[t + 1]]``
    begins : (texts,) number of fits that do not learn from a text: it is in all fits after these
    shares : (texts, columns) probability of each class for each text, 0 where a fit does not learn from it
    gradient, penalty : (words + 1, columns)
    classes : number of classes of each fit

    Returns
    -------
    direction : (words + 1, columns)
    """
    last, columns = len(gradient) - 1, gradient.shape[1]
    left, ahead, found = gradient.copy(), -gradient, np.zeros_like(gradient)
    curved, spread = np.empty_like(gradient), np.empty(columns)
    sums, factor = np.zeros(columns), np.zeros(columns)
    square, enough = np.zeros(columns // classes), np.zeros(columns // classes)
    for word in range(last + 1):
        for j in range(columns):
            sums[j] += left[word, j] * left[word, j]
    for fit in range(len(square)):
        for j in range(fit * classes, (fit + 1) * classes):
            square[fit] += sums[j]
        enough[fit] = max(square[fit] * min(FORCING**2, square[fit]), FLOOR**2)
    for _ in range(GRADIENT_STEPS):
        low = columns
        for fit in range(len(square) - 1, -1, -1):
            if square[fit] > enough[fit]:
                low = fit * classes
        if low == columns:
            break
        _curve(starts, words, begins, shares, ahead, penalty, classes, low, curved, spread)
        sums[:] = 0.0
        for word in range(last + 1):
            for j in range(low, columns):
                sums[j] += ahead[word, j] * curved[word, j]
        for fit in range(len(square)):
            total = 0.0
            for j in range(fit * classes, (fit + 1) * classes):
                total += sums[j]
            length = square[fit] / total if square[fit] > enough[fit] else 0.0
            for j in range(fit * classes, (fit + 1) * classes):
                factor[j] = length
        sums[:] = 0.0
        for word in range(last + 1):
            for j in range(low, columns):
                found[word, j] += factor[j] * ahead[word, j]
                left[word, j] += factor[j] * curved[word, j]
                sums[j] += left[word, j] * left[word, j]
        for fit in range(len(square)):
            before = square[fit]
            if before > enough[fit]:
                square[fit] = 0.0
                for j in range(fit * classes, (fit + 1) * classes):
                    square[fit] += sums[j]
            for j in range(fit * classes, (fit + 1) * classes):
                factor[j] = square[fit] / before if before > enough[fit] else 0.0
        for word in range(last + 1):
            for j in range(low, columns):
                ahead[word, j] = factor[j] * ahead[word, j] - left[word, j]
    return found


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
    last, columns = len(ahead) - 1, ahead.shape[1]
    for word in range(last + 1):
        for j in range(low, columns):
            curved[word, j] = penalty[word, j] * ahead[word, j]
    for text in range(len(begins)):
        first = max(low, begins[text] * classes)
        row, share, common = spread[first:], shares[text, first:], ahead[last, first:]
        for j in range(len(row)):
            row[j] = common[j]
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
        all_texts = curved[last, first:]
        for j in range(len(row)):
            all_texts[j] += row[j]


def _warm_up() -> None:
    starts, words, begins = (np.array(one, dtype=np.uint32) for one in ([0, 1, 2], [0, 0], [0, 0]))
    shares = np.full((2, 2), 0.5)
    newton_direction(starts, words, begins, shares, np.ones((2, 2)), np.ones((2, 2)), constant(2))


register_warm_up("regressions of the bias gate", _warm_up)
