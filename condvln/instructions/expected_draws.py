"""How often each statement is expected to be drawn in the rooms of many scenes, and the factors that make it about as
often true as false.

A condition is drawn among the statements of one room that have the same form and truth, so a statement has more of the
draws where few others have its truth. What a statement's weights should be therefore depends on all other statements.

Let d_k be the expected draws of a statement in scene k, counted negative if it is false there. Equal draws,
Σ d_k = 0, are not fair: all scenes but one then tell the truth in the last, the opposite of their own excess. A
guesser that bets on the truths of other scenes, or against them, gains or loses by
Σ_{j≠k} d_j d_k = (Σ d_k)² − Σ d_k², which is 0 if |Σ d_k| = √Σ d_k²: the excess that a fair coin gives on average.

Method: iterative proportional fitting (Deming & Stephan 1940) with one factor a statement, by which the weights of its
true occurrences are multiplied and those of its false ones divided.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["FULL_MASS", "ExpectedDraws", "coins", "rounded_octaves"]

FULL_MASS: Final = 0.3
"""Total weight of the statements of a group, of the truth that has less, from which on the group is used as often as
its weight says. With less it is used in proportion less: a room that could ask of nearness only what is nearly always
true would ask that, however small its weight. In 1,000 made houses, with factors, 1 serves as well.
"""

EVENING_ROUNDS: Final = 30
"""Iterations of proportional fitting."""

MOST_A_ROUND: Final = 5.0
"""Largest change of a factor in one round."""

FACTOR_STEPS: Final = 16
"""Steps per octave to which factors are rounded, so that rows do not depend on the last bits of a sum."""

MOST_OCTAVES: Final = 10
"""Largest factor, in octaves: a statement that can't be balanced is practically never drawn."""

LEAST_SHARE: Final = 1e-9
"""Smallest share of a statement's draws that counts as more than none; below it, sums are only rounding errors."""

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Ints = NDArray[np.integer[Any]]


class ExpectedDraws:
    """The expected draws of statements in the rooms of many scenes.

    Parameters
    ----------
    own, truth, scene, weights, form (n,) : of each occurrence of a statement with one truth in one room: the number of
        the statement, its truth (0 or 1), its scene, its weight without factors, and the form that it has in this room
        (a predicate, definite or not)
    group_of_form (f,) : group of predicates in the room to which a form belongs. Statements of presence are a group and
        a form of their own
    room_of_group (g,) : room of a group
    group_weights (g,), room_weights (r,) : how often a group is used in its room, and a room in its scene
    presence (g,) : how often conditions about the room are of presence, if the group is that; else 0
    """

    def __init__(
        self,
        own: Ints,
        truth: Ints,
        scene: Ints,
        weights: F64,
        *,
        form: I64,
        group_of_form: I64,
        room_of_group: I64,
        group_weights: F64,
        presence: F64,
        room_weights: F64,
    ) -> None:
        # Half the memory: there are thousands of occurrences a scene.
        self.own, self.truth, self.weights = own.astype(np.int32), truth.astype(np.int32), weights
        self._form, self._group_of_form, self._room_of_group = form.astype(np.int32), group_of_form, room_of_group
        self._group_weights, self._presence, self._room_weights = group_weights, presence, room_weights
        self.count = int(own.max(initial=-1)) + 1
        scenes = int(scene.max(initial=0)) + 1
        places, place = np.unique(own.astype(np.int64) * scenes + scene, return_inverse=True)
        self._place, self._own_of_place = place.astype(np.int32), places // scenes

    @property
    def scenes(self) -> I64:
        """Number of scenes in which each statement occurs."""
        return np.bincount(self._own_of_place, minlength=self.count)

    def octaves(self, excess: F64, added: float = 0.0) -> F64:
        """Return the binary logarithm of one factor for each statement.

        Parameters
        ----------
        excess (s,) : wanted excess of true draws over false ones, as a share of both, in parts of what a fair coin
            would make it
        added : number of scenes, with as many draws each as a statement has on average, that are added to its draws of
            either truth, so that statements of few scenes are changed less
        """
        octaves = np.zeros(self.count)
        share = excess * self._coin_share()
        for _ in range(EVENING_ROUNDS):
            tilt = octaves[self.own]
            false, true = self._sums(self.expected(self.weights * np.exp2(np.where(self.truth == 1, tilt, -tilt))))
            total = false + true
            least = LEAST_SHARE * total + np.finfo(np.float64).tiny
            more = added * total / np.maximum(self.scenes, 1)
            wanted_true, wanted_false = (
                np.maximum(total * (1.0 + sign * share) / 2.0, least) + more for sign in (1, -1)
            )
            change = np.sqrt(
                wanted_true / (np.maximum(true, least) + more) * (np.maximum(false, least) + more) / wanted_false
            )
            octaves += np.log2(np.clip(change, 1.0 / MOST_A_ROUND, MOST_A_ROUND))
        return octaves

    def _coin_share(self) -> F64:
        """Return √Σ d_k² / Σ |d_k| of each statement, where d_k are its draws in scene k without factors.

        With draws that have factors, statements would aim at what the factors make of them, and most draws would move
        to a few scenes.
        """
        drawn = self.expected(self.weights)
        excess = np.bincount(self._place, np.where(self.truth == 1, drawn, -drawn), len(self._own_of_place))
        total = sum(self._sums(drawn))
        spread = np.sqrt(np.bincount(self._own_of_place, excess**2, self.count))
        found: F64 = np.divide(spread, total, out=np.ones(self.count), where=total > 0)
        return np.minimum(found, 1.0)

    def _sums(self, drawn: F64) -> tuple[F64, F64]:
        """Return the sums of `drawn`, the draws of each occurrence, by statement: of false ones and of true ones."""
        sums = np.bincount(2 * self.own + self.truth, drawn, 2 * self.count).astype(np.float64).reshape(-1, 2)
        return sums[:, 0], sums[:, 1]

    def expected(self, weights: F64) -> F64:
        """Return the expected draws of each occurrence if the occurrences have `weights`, per condition of its scene,
        if true and false conditions are drawn equally often.
        """
        key = 2 * self._form + self.truth
        sums = np.bincount(key, weights, 2 * len(self._group_of_form)).reshape(-1, 2)
        mass = sums.min(axis=1)  # a form with one truth is not used
        masses = np.bincount(self._group_of_form, mass, len(self._room_of_group))
        rooms, there = self._room_of_group, masses > 0
        of_room = np.bincount(rooms, self._group_weights * there, len(self._room_weights))[rooms]
        used = self._group_weights * np.minimum(1.0, masses / FULL_MASS) * there
        used = np.divide(used, of_room, out=np.zeros_like(used), where=of_room > 0)
        asked = self._presence * np.minimum(1.0, masses)
        share = np.bincount(rooms, asked, len(self._room_weights))[rooms]
        chance = np.where(self._presence > 0, asked, (1.0 - share) * used)
        whole = np.bincount(rooms, chance, len(self._room_weights))[rooms]
        rate = np.divide(
            self._room_weights[rooms] * chance, masses * whole, out=np.zeros_like(chance), where=masses * whole > 0
        )
        own = sums.ravel()[key]
        found: F64 = np.divide(
            weights * (mass * rate[self._group_of_form])[self._form], own, out=np.zeros_like(own), where=own > 0
        )
        return found


def rounded_octaves(octaves: F64) -> I64:
    """Return octaves in whole steps, none beyond the largest factor."""
    most = FACTOR_STEPS * MOST_OCTAVES
    return np.clip(np.rint(FACTOR_STEPS * octaves), -most, most).astype(np.int64)


def coins(statements: Sequence[tuple[object, ...]]) -> F64:
    """Return 1 or -1 for each statement, by its hash."""
    tossed = (hashlib.blake2b(repr(one).encode(), digest_size=1).digest()[0] & 1 for one in statements)
    return np.fromiter((1.0 if one else -1.0 for one in tossed), np.float64, len(statements))
