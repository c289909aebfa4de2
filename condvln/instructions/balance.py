"""Weights for the statements about one room that make neither label, anchor nor predicate predict the truth.

For room types that are too rare for priors. Method: iterative proportional fitting (Deming & Stephan 1940) of the table
of true statements and of the table of false ones towards the geometric mean of their marginals.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["balanced_weights", "jointly_balanced_weights"]

BALANCING_ROUNDS: Final = 30
"""Iterations of proportional fitting; the marginals of real rooms converge to 1e-3 within about ten."""

LEAST_WEIGHT: Final = 1e-6
"""A cell whose weight falls below this share of the largest counts as excluded by the fitting."""

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


def balanced_weights(true: Bools, false: Bools) -> dict[bool, F64] | None:
    """Return, by truth, the weights of the cells of a (labels, anchors) table: those of the true cells and those of the
    false cells, with equal marginals.

    With these weights neither the label nor the anchor predicts whether the statement is true. Labels and anchors with
    only one truth are dropped. If nothing is left, only the labels are balanced; None if no label has both truths.
    """
    return _fitted(true, false, ((1, 0), (0,)))


def jointly_balanced_weights(true: Bools, false: Bools) -> dict[bool, F64] | None:
    """Return, by truth, the weights of the cells of a (forms, labels, anchors) table, with equal marginals.

    For forms of statements none of which can be balanced by itself: "the bowl north of the sink" is true and "the bowl
    east of the sink" false. With these weights neither the form, nor the label, nor the anchor predicts the truth, and
    each form that is left has both truths. If nothing is left, anchors are not balanced; None if nothing is left then
    either.
    """
    return _fitted(true, false, ((2, 0, 1), (0, 1)))


def _fitted(true: Bools, false: Bools, ways: Sequence[Sequence[int]]) -> dict[bool, F64] | None:
    """Return the weights by truth that balance the marginals of the axes that one of the `ways` lists; the first way
    counts that leaves any cell.
    """
    for kept in ways:
        tables = [true.astype(np.float64), false.astype(np.float64)]
        for _ in range(BALANCING_ROUNDS):
            before = tables
            for axis in kept:
                others = tuple(k for k in range(true.ndim) if k != axis)
                sums = [t.sum(axis=others, keepdims=True) for t in tables]
                target = np.sqrt(sums[0] * sums[1])
                tables = [
                    t * np.divide(target, s, out=np.zeros_like(s), where=s > 0)
                    for t, s in zip(tables, sums, strict=True)
                ]
            if all(map(np.array_equal, before, tables)):
                break  # further rounds would change nothing
        if all(t.any() for t in tables):
            tables = [np.where(t < LEAST_WEIGHT * t.max(), 0.0, t) for t in tables]
            return {True: tables[0], False: tables[1]}
    return None
