"""Factors with which each statement about the stagings of a layout is drawn as often true as false.

Counts of rooms are not enough. A condition is drawn among the statements of one room that have the same form and truth,
so a statement has more of the draws in a room with few of these. The stagings of a layout share their statements and
differ in few truths, and with weights from counts alone a guesser learns which truth is usually asked. Here the
expected number of draws of each statement is computed over all stagings, and its weights are changed until true and
false draws are equal. Method: iterative proportional fitting (Deming & Stephan 1940) with one factor a statement, by
which the weights of its true occurrences are multiplied and those of its false ones divided.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.instructions.informative import statement_weights
from condvln.instructions.predicates import GROUP_OF
from schemas.config.constants import STAGINGS

__all__ = ["Statement", "even_factors"]

Statement = tuple[str, str, str, str, bool]
"""Room type, label, predicate, anchor label, whether the statement is definite. For presence, the predicate and the
anchor label are empty, and the last value is False.
"""

EVENING_ROUNDS: Final = 30
"""Iterations of proportional fitting; over ReplicaCAD's layouts, the draws that are uneven fall from 35 % to 2 %."""

MOST_A_ROUND: Final = 5.0
"""Largest change of a factor in one round."""

FACTOR_STEPS: Final = 16
"""Steps per octave to which factors are rounded, so that rows do not depend on the last bits of a sum."""

MOST_OCTAVES: Final = 10
"""Largest factor, in octaves: a statement that can't be balanced is practically never drawn."""

_STATEMENT: Final = ("room_type", "label", "predicate", "anchor", "definite")

F64 = NDArray[np.float64]


def even_factors(counts: pa.Table, group_weights: Mapping[str, float]) -> dict[Statement, float]:
    """Return, by statement, the factor by which the weights of its true occurrences are multiplied, and those of its
    false ones divided.

    Parameters
    ----------
    counts : relational statements about the rooms of the stagings of one layout, with the columns of ``PRIORS``; the
        rooms of one type in one staging count as one room
    group_weights : weights of the groups of predicates; the statements of a group with weight 0 get the factor 1
    """
    if not counts.num_rows:
        return {}
    draws = _Draws(counts, group_weights)
    factors = draws.factors()
    steps = np.clip(np.rint(FACTOR_STEPS * np.log2(factors)), -FACTOR_STEPS * MOST_OCTAVES, FACTOR_STEPS * MOST_OCTAVES)
    return dict(zip(draws.statements, np.exp2(steps / FACTOR_STEPS).tolist(), strict=True))


class _Draws:
    """The expected draws of statements about the stagings of a layout.

    Each array has one value for each occurrence of a statement with one truth in one room. ``own``, ``form`` and
    ``group`` number the statements, the forms of each room with their truths apart, and the groups of forms of each
    room.
    """

    def __init__(self, counts: pa.Table, group_weights: Mapping[str, float]) -> None:
        columns: dict[str, list[Any]] = counts.to_pydict()
        named = list(zip(*(columns[name] for name in _STATEMENT), strict=True))
        self.statements: list[Statement] = list(dict.fromkeys(named))
        numbers = {statement: k for k, statement in enumerate(self.statements)}
        statement = np.array([numbers[name] for name in named], np.int64)
        rooms = list(zip(columns["staging"], columns["room_type"], strict=True))
        predicates = columns["predicate"]
        form = _numbered(list(zip(rooms, predicates, columns["definite"], strict=True)))
        group = _numbered([(room, GROUP_OF[p]) for room, p in zip(rooms, predicates, strict=True)])
        room = _numbered(rooms)
        seen = np.stack([np.array(columns[name], np.float64) for name in ("n_false", "n_true")])
        n = len(self.statements)
        counted = np.stack([np.bincount(statement, side, n) for side in seen[::-1]], axis=1, dtype=np.float64)
        base = statement_weights(counted, STAGINGS)
        there = [np.flatnonzero(side) for side in seen]
        at = np.concatenate(there)
        self.truth = np.repeat([0, 1], [len(rows) for rows in there])
        self.own = statement[at]
        self.weights = seen[self.truth, at] * np.stack([base[False], base[True]])[self.truth, self.own]
        self.form, self.group = form[at], group[at]
        self._group_of_form = _of_each(form, group)
        self._room_of_group = _of_each(group, room)
        weights = np.array([group_weights[GROUP_OF[p]] for p in predicates], np.float64)
        self._group_weights = _of_each(group, weights)

    def factors(self) -> F64:
        """Return one factor for each statement."""
        factors = np.ones(len(self.statements))
        for _ in range(EVENING_ROUNDS):
            drawn = self._expected(self.weights * np.where(self.truth == 1, factors[self.own], 1.0 / factors[self.own]))
            false, true = (
                np.bincount(self.own, np.where(self.truth == truth, drawn, 0.0), len(factors)) for truth in (0, 1)
            )
            least = np.finfo(np.float64).tiny
            change = np.sqrt(np.maximum(false, least) / np.maximum(true, least))
            factors = factors * np.clip(change, 1.0 / MOST_A_ROUND, MOST_A_ROUND)
        return factors

    def _expected(self, weights: F64) -> F64:
        """Return the expected draws of each occurrence, per condition of its room, if true and false conditions are
        drawn equally often.
        """
        key = 2 * self.form + self.truth
        sums = np.bincount(key, weights, 2 * len(self._group_of_form)).reshape(-1, 2)
        mass = sums.min(axis=1)  # a form with one truth is not used
        masses = np.bincount(self._group_of_form, mass, len(self._room_of_group))
        used = self._group_weights * (masses > 0)
        room_sums = np.bincount(self._room_of_group, used)[self._room_of_group]
        share = np.divide(used, masses * room_sums, out=np.zeros_like(used), where=masses * room_sums > 0)
        own = sums.ravel()[key]
        rate = mass[self.form] * share[self.group]
        found: F64 = np.divide(weights * rate, own, out=np.zeros_like(own), where=own > 0)
        return found


def _numbered(keys: list[Any]) -> NDArray[np.int64]:
    """Return numbers from 0 of `keys`, in the order in which they first occur."""
    known: dict[Any, int] = {}
    return np.array([known.setdefault(key, len(known)) for key in keys], np.int64)


def _of_each(number: NDArray[np.int64], values: NDArray[Any]) -> NDArray[Any]:
    """Return the value of each number, where all rows with the same number have the same value."""
    found = np.zeros(number.max(initial=-1) + 1, values.dtype)
    found[number] = values
    return found
