"""Factors with which the truths of each statement about the stagings of a layout are drawn like those of a fair coin.

Counts of rooms are not enough (see ``condvln.instructions.expected_draws``): the stagings of a layout share their
statements and differ in few truths, and with weights from counts alone a guesser learns which truth is usually asked.
So the weights are changed until the excess of one truth is a set part of what a fair coin would make it, since draws
are not quite those that are computed: some are rejected. In programs of several conditions the part is smaller:
conditions must fit those before them, and so add an excess of their own. In layouts of many stagings the excess goes to
the truth that the statement has in more of them, since the other sign would leave most draws to a few stagings.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from condvln.instructions.expected_draws import (
    FACTOR_STEPS,
    ExpectedDraws,
    coins,
    fitted_octaves,
    rounded_octaves,
)
from condvln.instructions.informative import statement_weights
from condvln.instructions.predicates import GROUP_OF
from condvln.instructions.statement_rows import (
    STATEMENT,
    CodedTexts,
    Statement,
    numbered,
    numbered_statements,
    of_each,
)
from schemas.config.constants import STAGINGS

__all__ = ["UNCHANGED", "ByConditions", "even_factors"]


class ByConditions(NamedTuple):
    """A value for programs of one condition, and one for programs of several."""

    one: float
    several: float


MANY_STAGINGS: Final = 10
"""Number of stagings from which a statement's excess goes to its usual truth; below it, a coin says of which truth it
is. In five stagings most statements are true in all but one, and a guesser that bets on the others is either always
right or always wrong: half of the statements must be of each kind."""

COIN_PART: Final = ByConditions(0.5, 0.4)
"""Part of a fair coin's excess that is aimed at in layouts of many stagings: chosen by drawing ReplicaCAD's 21 stagings
of two layouts. With 0.35 in programs of several conditions, betting against the truths of other stagings was right 2
points above chance; with 0.45, betting on them as much; with 0.7 in programs of one, betting on them 6 points."""

FEW_PART: Final = ByConditions(1.15, 1.15)
"""The same in layouts of few stagings: chosen by drawing five stagings of each of 15 made apartments of RoboTHOR. With
1, betting against the truths of other stagings was right 6 points above chance; with 1.3, betting on them 3 points, and
betting on those of other layouts 7 (with 1.15, 4)."""

UNCHANGED: Final = ByConditions(1.0, 1.0)
"""The factors of a statement that is about no staging."""

PRESENCE: Final = ""
"""In place of a group of predicates."""

F64 = NDArray[np.float64]


def even_factors(
    counts: pa.Table, group_weights: Mapping[str, float], presence: float = 0.0
) -> dict[Statement, ByConditions]:
    """Return, by statement, the factors by which the weights of its true occurrences are multiplied, and those of its
    false ones divided.

    Parameters
    ----------
    counts : statements about the rooms of the stagings of one layout, with the columns of ``PRIORS``; the
        rooms of one type in one staging count as one room
    group_weights : weights of the groups of predicates; the statements of a group with weight 0 get the factor 1
    presence : share of conditions that are of presence, if their truths vary enough
    """
    if not counts.num_rows:
        return {}
    draws, statements, usual = _draws(counts, group_weights, presence)
    many = len(pc.unique(counts["staging"])) >= MANY_STAGINGS
    layout = counts["layout"][0].as_py()
    sides = usual if many else coins([(layout, *statement) for statement in statements])
    parts = COIN_PART if many else FEW_PART
    octaves = np.stack([fitted_octaves((draws,), part * sides) for part in parts], axis=1)
    factors = np.exp2(rounded_octaves(octaves) / FACTOR_STEPS).tolist()
    return {statement: ByConditions(*own) for statement, own in zip(statements, factors, strict=True)}


def _draws(
    counts: pa.Table, group_weights: Mapping[str, float], presence: float
) -> tuple[ExpectedDraws, list[Statement], F64]:
    """Return the expected draws; the statements by number; and for each statement 1 if it is true in more stagings than
    it is false in, else -1. Where the numbers are equal, the hash of the statement decides.
    """
    staging, *texts = (CodedTexts.of(counts[name]) for name in ("staging", *STATEMENT[:-1]))
    definite = counts["definite"].to_numpy()
    statement, statements = numbered_statements(texts, definite, np.arange(len(definite)))
    room_type, _, (named, predicate), _ = texts
    group_of: dict[str, str] = {PRESENCE: PRESENCE} | {str(name): group for name, group in GROUP_OF.items()}
    groups = [group_of[name] for name in named]
    room, _ = numbered(staging.numbers, room_type.numbers)
    form, _ = numbered(room, predicate, definite)
    group, _ = numbered(room, np.array([groups.index(name) for name in groups], np.int64)[predicate])
    seen = np.stack([counts[name].to_numpy().astype(np.float64) for name in ("n_false", "n_true")])
    n = len(statements)
    counted = np.stack([np.bincount(statement, side, n) for side in seen[::-1]], axis=1, dtype=np.float64)
    base = statement_weights(counted, STAGINGS)
    there = [np.flatnonzero(side) for side in seen]
    at = np.concatenate(there)
    truth = np.repeat([0, 1], [len(rows) for rows in there])
    more = np.bincount(statement[at], 2.0 * truth - 1.0, n)
    weights = np.array([group_weights.get(name, 0.0) for name in groups], np.float64)
    asked = np.array([presence if name == PRESENCE else 0.0 for name in groups])
    room_of_group = of_each(group, room)
    draws = ExpectedDraws(
        2 * statement[at] + truth,
        seen[truth, at] * np.stack([base[False], base[True]])[truth, statement[at]],
        form=form[at],
        group_of_form=of_each(form, group),
        room_of_group=room_of_group,
        scene_of_room=of_each(room, staging.numbers),
        group_weights=of_each(group, weights[predicate]),
        presence=of_each(group, asked[predicate]),
        room_weights=np.ones(int(room.max()) + 1),
    )
    return draws, statements, np.sign(np.where(more != 0, more, coins(statements)))
