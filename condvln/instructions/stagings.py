"""Factors with which the truths of each statement about the stagings of a layout are drawn like those of a fair coin.

Counts of rooms are not enough. A condition is drawn among the statements of one room that have the same form and truth,
so a statement has more of the draws in a room with few of these. The stagings of a layout share their statements and
differ in few truths, and with weights from counts alone a guesser learns which truth is usually asked. Here the
expected number of draws of each statement is computed over all stagings, and its weights are changed until the excess
of one truth is a set part of what a fair coin would make it.

Let d_k be the expected draws of a statement in staging k, counted negative if it is false there. Equal draws,
Σ d_k = 0, are not fair: all stagings but one then tell the truth in the last, the opposite of their own excess. A
guesser that bets on the truths of other stagings, or against them, gains or loses by
Σ_{j≠k} d_j d_k = (Σ d_k)² − Σ d_k², which is 0 if |Σ d_k| = √Σ d_k². Part of that is aimed at, since draws are not
quite those that are computed here: some are rejected. In programs of several conditions the part is smaller: conditions
must fit those before them, and so add an excess of their own. The excess goes to the truth that the statement has in
more stagings, since the other sign would leave most draws to a few stagings.

Method: iterative proportional fitting (Deming & Stephan 1940) with one factor a statement, by which the weights of its
true occurrences are multiplied and those of its false ones divided.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.instructions.informative import statement_weights
from condvln.instructions.predicates import GROUP_OF
from schemas.config.constants import STAGINGS

__all__ = ["UNCHANGED", "ByConditions", "Statement", "even_factors"]

Statement = tuple[str, str, str, str, bool]
"""Room type, label, predicate, anchor label, whether the statement is definite. For presence, the predicate and the
anchor label are empty, and the last value is False.
"""

EVENING_ROUNDS: Final = 30
"""Iterations of proportional fitting."""


class ByConditions(NamedTuple):
    """A value for programs of one condition, and one for programs of several."""

    one: float
    several: float


COIN_PART: Final = 0.35
"""Part of a fair coin's excess that is aimed at. In exports of ReplicaCAD, betting on the truths of other stagings was
right 6 points below chance with part 0, and 7 points above it with part 1; betting against them, the other way round.
"""

COIN_PART_ALONE: Final = 0.7
"""The same in programs of one condition. With 0.35, betting against the truths of other stagings was right 3 points
above chance; with 1, betting on them 5 points.
"""

UNCHANGED: Final = ByConditions(1.0, 1.0)
"""The factors of a statement that is about no staging."""

MOST_A_ROUND: Final = 5.0
"""Largest change of a factor in one round."""

FACTOR_STEPS: Final = 16
"""Steps per octave to which factors are rounded, so that rows do not depend on the last bits of a sum."""

MOST_OCTAVES: Final = 10
"""Largest factor, in octaves: a statement that can't be balanced is practically never drawn."""

LEAST_SHARE: Final = 1e-9
"""Smallest share of a statement's draws that counts as more than none; below it, sums are only rounding errors."""

_STATEMENT: Final = ("room_type", "label", "predicate", "anchor", "definite")

F64 = NDArray[np.float64]


def even_factors(counts: pa.Table, group_weights: Mapping[str, float]) -> dict[Statement, ByConditions]:
    """Return, by statement, the factors by which the weights of its true occurrences are multiplied, and those of its
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
    octaves = np.log2(np.stack([draws.factors(part) for part in (COIN_PART_ALONE, COIN_PART)], axis=1))
    steps = np.clip(np.rint(FACTOR_STEPS * octaves), -FACTOR_STEPS * MOST_OCTAVES, FACTOR_STEPS * MOST_OCTAVES)
    factors = np.exp2(steps / FACTOR_STEPS).tolist()
    return {statement: ByConditions(*own) for statement, own in zip(draws.statements, factors, strict=True)}


class _Draws:
    """The expected draws of statements about the stagings of a layout.

    Each array has one value for each occurrence of a statement with one truth in one room. ``own``, ``staging``,
    ``form`` and ``group`` number the statements, the stagings, the forms of each room with their truths apart, and the
    groups of forms of each room. ``usual`` has 1 for each statement that is true in more stagings than it is false in,
    and -1 for the others; where the numbers are equal, the hash of the statement decides.
    """

    def __init__(self, counts: pa.Table, group_weights: Mapping[str, float]) -> None:
        texts = {name: _texts(counts[name]) for name in ("staging", *_STATEMENT[:-1])}
        definite = counts["definite"].to_numpy()
        statement, first = _numbered(*(texts[name][1] for name in _STATEMENT[:-1]), definite)
        columns = [[texts[name][0][k] for k in texts[name][1][first].tolist()] for name in _STATEMENT[:-1]]
        self.statements: list[Statement] = list(zip(*columns, definite[first].tolist(), strict=True))
        named, predicate = texts["predicate"]
        groups = [GROUP_OF[name] for name in named]
        room, _ = _numbered(texts["staging"][1], texts["room_type"][1])
        form, _ = _numbered(room, predicate, definite)
        group, _ = _numbered(room, np.array([groups.index(name) for name in groups], np.int64)[predicate])
        seen = np.stack([counts[name].to_numpy().astype(np.float64) for name in ("n_false", "n_true")])
        n = len(self.statements)
        counted = np.stack([np.bincount(statement, side, n) for side in seen[::-1]], axis=1, dtype=np.float64)
        base = statement_weights(counted, STAGINGS)
        there = [np.flatnonzero(side) for side in seen]
        at = np.concatenate(there)
        self.truth = np.repeat([0, 1], [len(rows) for rows in there])
        self.own = statement[at]
        self.weights = seen[self.truth, at] * np.stack([base[False], base[True]])[self.truth, self.own]
        self.form, self.group = form[at], group[at]
        self.staging = texts["staging"][1][at]
        more = np.bincount(self.own, 2.0 * self.truth - 1.0, n)
        self.usual = np.sign(np.where(more != 0, more, [_coin(one) for one in self.statements]))
        self._group_of_form = _of_each(form, group)
        self._room_of_group = _of_each(group, room)
        weights = np.array([group_weights[name] for name in groups], np.float64)
        self._group_weights = _of_each(group, weights[predicate])

    def factors(self, part: float) -> F64:
        """Return one factor for each statement, with which `part` of a fair coin's excess is left."""
        factors = np.ones(len(self.statements))
        share = part * self.usual * self._coin_share()
        for _ in range(EVENING_ROUNDS):
            false, true = self._sums(
                self._expected(self.weights * np.where(self.truth == 1, factors[self.own], 1.0 / factors[self.own]))
            )
            total = false + true
            least = LEAST_SHARE * total + np.finfo(np.float64).tiny
            wanted_true, wanted_false = (np.maximum(total * (1.0 + sign * share) / 2.0, least) for sign in (1, -1))
            change = np.sqrt(wanted_true / np.maximum(true, least) * np.maximum(false, least) / wanted_false)
            factors = factors * np.clip(change, 1.0 / MOST_A_ROUND, MOST_A_ROUND)
        return factors

    def _coin_share(self) -> F64:
        """Return √Σ d_k² / Σ |d_k| of each statement, where d_k are its draws in staging k without factors.

        With draws that have factors, statements would aim at what the factors make of them, and most draws would move
        to a few stagings.
        """
        n, k = len(self.statements), int(self.staging.max()) + 1
        drawn = self._expected(self.weights)
        excess = np.bincount(self.own * k + self.staging, np.where(self.truth == 1, drawn, -drawn), n * k)
        total = sum(self._sums(drawn))
        spread = np.sqrt((excess.reshape(n, k) ** 2).sum(axis=1))
        found: F64 = np.divide(spread, total, out=np.ones(n), where=total > 0)
        return np.minimum(found, 1.0)

    def _sums(self, drawn: F64) -> tuple[F64, F64]:
        """Return the sums of `drawn`, the draws of each occurrence, by statement: of false ones and of true ones."""
        sums = np.zeros((2, len(self.statements)))
        np.add.at(sums, (self.truth, self.own), drawn)
        return sums[0], sums[1]

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


def _coin(statement: Statement) -> int:
    """Return 1 or -1, by the hash of `statement`."""
    return 1 if hashlib.blake2b(repr(statement).encode(), digest_size=1).digest()[0] & 1 else -1


def _texts(column: pa.ChunkedArray) -> tuple[list[Any], NDArray[np.int64]]:
    """Return the distinct texts of a column, in the order in which they first occur, and the number of each row's."""
    coded = pa.concat_arrays(column.chunks).dictionary_encode()
    return coded.dictionary.to_pylist(), coded.indices.to_numpy().astype(np.int64)


def _numbered(*columns: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Return numbers from 0 of the rows of `columns` (n,), in the order in which they first occur; and the row in which
    each first occurs.
    """
    keys = np.zeros(len(columns[0]), np.int64)
    for column in columns:
        keys = keys * (int(column.max(initial=0)) + 1) + column
    _, first, numbers = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    return place[numbers], first[order]


def _of_each(number: NDArray[np.int64], values: NDArray[Any]) -> NDArray[Any]:
    """Return the value of each number, where all rows with the same number have the same value."""
    found = np.zeros(number.max(initial=-1) + 1, values.dtype)
    found[number] = values
    return found
