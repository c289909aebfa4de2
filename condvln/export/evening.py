"""Leave out episodes until each statement is asked as often where it is true as where it is false.

Conditions are drawn so that truth and falsehood of a statement have equal weights over all rooms. But each scene shares
its episodes out among the statements that can be asked there, so that what is almost always true is still asked where
little else is true. In some hundred scenes this is below what a guesser can learn; in thousands it is not.
"""

from __future__ import annotations

from collections import Counter
from typing import Final

import numpy as np
import numpy.typing as npt

from condvln.bias import usual_truths
from condvln.export.pool import Codes, ExportPool
from condvln.export.splits import fractions
from condvln.scene.layouts import layout_of
from schemas.config.constants import STAGINGS

__all__ = ["evened"]

SCENES: Final = 10
"""Number of scenes, with as many conditions each as a statement has where it occurs, that are added to both counts of
the statement. So statements of a few scenes are evened less: if they were evened as much, a scene would say the
opposite of the others.
"""
ROUNDS: Final = 20
"""How often the chances are adapted to each other: after so many, those of a million episodes change by less than 1 %.
"""


def evened(pool: ExportPool, rows: Codes, seed: int) -> npt.NDArray[np.bool_]:
    """Return for each of the episodes `rows` of a pool with statements whether it stays.

    An episode stays with the product of the chances of its conditions, each of which depends on the statement and its
    truth; the rarer truth of a statement has chance 1. Chances are adapted to each other in turns, as in iterative
    proportional fitting (Deming and Stephan 1940). What counts as even depends on the conditions' places in their
    programs, since an even distribution of gold leaves makes some of them true more often than false. Members of
    counterfactual groups all stay, and so do episodes of stagings of a layout: their conditions were drawn as evenly as
    so few scenes allow (``condvln.instructions.stagings``).

    Raises
    ------
    ValueError : the pool was built without statements
    """
    if pool.statements is None:
        raise ValueError("the pool was built without statements")
    stay = np.ones(len(rows), dtype=bool)
    asked = np.flatnonzero(~_staged(pool)[pool.scene[rows]])
    stay[asked] = _evened(pool, pool.statements, rows[asked], seed)
    return stay


def _staged(pool: ExportPool) -> npt.NDArray[np.bool_]:
    """Return for each scene of a pool whether it is one of several stagings of a layout."""
    layouts = [(family, layout_of(scene)) for family, scene in pool.scenes]
    count = Counter(layouts)
    return np.array([bool(one[1]) and count[one] >= STAGINGS for one in layouts], dtype=bool)


def _evened(pool: ExportPool, statements: Codes, rows: Codes, seed: int) -> npt.NDArray[np.bool_]:
    sizes = np.diff(pool.offsets)[rows]
    episode = np.repeat(np.arange(len(rows)), sizes)
    place = np.arange(len(episode)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    at = pool.offsets[rows][episode] + place
    truth = pool.truths[at]
    _, statement = np.unique(statements[at], return_inverse=True)
    count = int(statement.max(initial=-1)) + 1
    usual = usual_truths()[pool.category[rows][episode], place]
    single = ~pool.grouped[rows]
    scenes = len(pool.scenes)
    pairs = np.unique(statement.astype(np.int64) * scenes + pool.scene[rows][episode])
    added = SCENES * np.bincount(statement, minlength=count) / np.bincount(pairs // scenes, minlength=count)

    def lowered() -> npt.NDArray[np.float64]:
        """Return the negative logarithm of each condition's chance."""
        return np.where(truth, np.maximum(tilt, 0)[statement], np.maximum(-tilt, 0)[statement])

    def chances() -> npt.NDArray[np.float64]:
        """Return the chance of each episode."""
        return np.where(single, np.exp(-np.bincount(episode, lowered(), len(rows))), 1.0)

    tilt = np.zeros(count)
    for _ in range(ROUNDS):
        # Of the episodes that the other conditions let stay
        weight = chances()[episode] * np.where(single[episode], np.exp(lowered()), 1.0)
        true, all_true, false, all_false = (
            np.bincount(statement, weight * share, count) + added for share in (truth, usual, ~truth, 1.0 - usual)
        )
        tilt = 0.5 * (tilt + np.log(true * all_false / (false * all_true)))
    return fractions(pool.episode[rows], seed, "statements") < chances()
