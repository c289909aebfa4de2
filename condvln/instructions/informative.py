"""Weights for drawing statements, computed from counts over rooms, so that the truth of a drawn statement is not
predictable.

A statement that is usually true is asked rarely where it is true, and as often where it is false. Statements seen in a
few rooms can't be balanced one by one; their labels can: the weights of a label's statements are lowered for the truth
that would be asked more often.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.instructions.statement_rows import STATEMENT
from schemas.config.constants import EVIDENCE

__all__ = ["LabelForm", "informative_weights", "label_weights", "statement_weights"]

PSEUDOCOUNT: Final = 0.5
"""Added to both counts of a statement, so that few rooms don't count as certainty (Jeffreys' prior)."""

EXACT: Final = 2.0**30
"""Weights are added as whole multiples of 1 / EXACT, so that the sum does not depend on the order of rows."""

F64 = NDArray[np.float64]

LabelForm = tuple[str, str, str, bool]
"""Room type, label, predicate, whether statements about the label are definite."""


def informative_weights(n_true: int, n_false: int, evidence: int = EVIDENCE) -> dict[bool, float]:
    """Return the sampling weights of a statement, by truth, from the number of rooms in which it is true and the number
    in which it is false.

    True occurrences are weighted by the share of false ones and vice versa, so that over all rooms a statement is
    sampled as often true as false, and rarely if its truth hardly varies. Both weights are 0 if it did not vary in at
    least `evidence` rooms.
    """
    weights = statement_weights(np.array([[float(n_true), float(n_false)]]), evidence)
    return {truth: float(weights[truth][0]) for truth in (True, False)}


def statement_weights(counts: F64, evidence: int = EVIDENCE) -> dict[bool, F64]:
    """Return what `informative_weights` returns, of n statements, (n,). `counts` (n, 2) has the numbers of rooms in
    which each statement is true and in which it is false.
    """
    true, false = _weights(counts[:, 0], counts[:, 1], evidence)
    return {True: true, False: false}


def _weights(n_true: F64, n_false: F64, evidence: int) -> tuple[F64, F64]:
    total = n_true + n_false
    rate = (n_true + PSEUDOCOUNT) / (total + 2.0 * PSEUDOCOUNT)
    varies = (total < evidence) | (np.minimum(n_true, n_false) > 0)
    return np.where(varies, 1.0 - rate, 0.0), np.where(varies, rate, 0.0)


def label_weights(counts: pa.Table) -> dict[LabelForm, tuple[float, float]]:
    """Return, for each form of the statements about a label in a type of room, the factors by which the weights of its
    false and of its true statements are multiplied. With them, statements of this form are sampled as often true as
    false over all rooms; no factor is above 1.

    Parameters
    ----------
    counts : relational statements, with the columns ``n_true`` and ``n_false``; a statement may have several rows
    """
    sums = counts.group_by(list(STATEMENT)).aggregate([("n_true", "sum"), ("n_false", "sum")])
    n_true, n_false = (sums[name].to_numpy().astype(np.float64) for name in ("n_true_sum", "n_false_sum"))
    true, false = _weights(n_true, n_false, EVIDENCE)
    forms = {name: sums[name] for name in STATEMENT if name != "anchor"}
    exact = {
        name: np.rint(weight * EXACT).astype(np.int64)
        for name, weight in (("false", n_false * false), ("true", n_true * true))
    }
    drawn = pa.table({**forms, **exact}).group_by(list(forms))
    columns = drawn.aggregate([("false", "sum"), ("true", "sum")]).select([*forms, "false_sum", "true_sum"])
    return {
        (room_type, label, predicate, definite): _lowered(of_false, of_true)
        for room_type, label, predicate, definite, of_false, of_true in zip(*columns.to_pydict().values(), strict=True)
    }


def _lowered(of_false: int, of_true: int) -> tuple[float, float]:
    """Return a factor for each of the sums `of_false` and `of_true`, neither above 1, so that the scaled sums are
    equal. Both factors are 0 if either sum is 0.
    """
    less = min(of_false, of_true)
    return (less / of_false, less / of_true) if less > 0 else (0.0, 0.0)
