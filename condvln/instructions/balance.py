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

BALANCING_ROUNDS: Final = 100
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
        cells = (true, false)
        while all(c.any() for c in cells):
            tables = _balanced(cells, kept)
            tables = [np.where(t < LEAST_WEIGHT * t.max(), 0.0, t) for t in tables]
            left = _with_both_truths(tables, kept)
            if all(c.any() for c in left) and all(np.array_equal(t > 0, c) for t, c in zip(tables, left, strict=True)):
                return {True: tables[0], False: tables[1]}
            cells = left  # a value that kept one truth would reveal it: the rest is fitted without it
    return None


def _balanced(cells: Sequence[Bools], kept: Sequence[int]) -> list[F64]:
    """Return weights of the true and of the false cells after proportional fitting along the `kept` axes."""
    tables = [c.astype(np.float64) for c in cells]
    for _ in range(BALANCING_ROUNDS):
        before = tables
        for axis in kept:
            others = tuple(k for k in range(tables[0].ndim) if k != axis)
            sums = [t.sum(axis=others, keepdims=True) for t in tables]
            target = np.sqrt(sums[0] * sums[1])
            tables = [
                t * np.divide(target, s, out=np.zeros_like(s), where=s > 0) for t, s in zip(tables, sums, strict=True)
            ]
        if all(map(np.array_equal, before, tables)):
            break  # further rounds would change nothing
    return tables


def _with_both_truths(tables: Sequence[F64], kept: Sequence[int]) -> tuple[Bools, Bools]:
    """Return masks of the cells with a weight whose value on each of the `kept` axes has weights of both truths."""
    true, false = (t > 0 for t in tables)
    for axis in kept:
        others = tuple(k for k in range(true.ndim) if k != axis)
        both = true.any(axis=others, keepdims=True) & false.any(axis=others, keepdims=True)
        true, false = true & both, false & both
    return true, false
