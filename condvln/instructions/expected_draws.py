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
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["FULL_MASS", "ExpectedDraws", "fitted_log_factors", "hashed_signs", "rounded_log_factors"]

FULL_MASS: Final = 0.3
"""Total weight of the statements of a group, of the truth that has less, from which on the group is used as often as
its weight says. With less it is used in proportion less: a room that could ask of nearness only what is nearly always
true would ask that, however small its weight. In 1,000 made houses, with factors, 1 serves as well.
"""

FITTING_ROUNDS: Final = 30
"""Iterations of proportional fitting."""

MOST_A_ROUND: Final = 5.0
"""Largest change of a factor in one round."""

FACTOR_STEPS: Final = 16
"""Steps per doubling to which factors are rounded, so that rows do not depend on the last bits of a sum."""

MOST_LOG_FACTOR: Final = 10
"""Largest factor, as a binary logarithm: a statement that can't be balanced is practically never drawn."""

LEAST_SHARE: Final = 1e-9
"""Smallest share of a statement's draws that counts as more than none; below it, sums are only rounding errors."""

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Ints = NDArray[np.integer[Any]]


class ExpectedDraws:
    """The expected draws of statements in the rooms of some scenes.

    Parameters
    ----------
    code, weights, form (n,) : of each occurrence of a statement with one truth in one room: 2 × the number of the
        statement + its truth (0 or 1), its weight without factors, and the form that it has in this room (a predicate,
        definite or not)
    group_of_form (f,) : group of predicates in the room to which a form belongs. Statements of presence are a group and
        a form of their own
    room_of_group (g,), scene_of_room (r,) : room of a group, and scene of a room
    group_weights (g,), room_weights (r,) : how often a group is used in its room, and a room in its scene, relative to
        the others there of which something can be asked
    presence (g,) : how often conditions about the room are of presence, if the group is that; else 0
    """

    def __init__(
        self,
        code: Ints,
        weights: F64,
        *,
        form: Ints,
        group_of_form: Ints,
        room_of_group: Ints,
        scene_of_room: Ints,
        group_weights: F64,
        presence: F64,
        room_weights: F64,
    ) -> None:
        self.code, self.weights = code, weights
        self._form, self._group_of_form, self._room_of_group = form, group_of_form, room_of_group
        self._scene_of_room = scene_of_room
        self._group_weights, self._presence, self._room_weights = group_weights, presence, room_weights

    def of_scenes(self, drawn: F64) -> tuple[I64, F64, F64]:
        """Return, for each scene in which a statement occurs, the number of the statement, the excess of its true draws
        there, and the weight of the room that it is about (of several the largest), as a part of the largest weight in
        the scene. `drawn` (n,) are the draws of each occurrence.
        """
        room = self._room_of_group[self._group_of_form][self._form]
        scene, scenes = self._scene_of_room[room], int(self._scene_of_room.max(initial=0)) + 1
        weights = np.where(np.bincount(room, drawn, len(self._room_weights)) > 0, self._room_weights, 0.0)
        most = np.zeros(scenes)
        np.maximum.at(most, self._scene_of_room, weights)
        places, place = np.unique((self.code >> 1).astype(np.int64) * scenes + scene, return_inverse=True)
        excess: F64 = np.bincount(place, np.where(self.code & 1, drawn, -drawn), len(places)).astype(np.float64)
        counted = np.zeros(len(places))
        np.maximum.at(counted, place, _ratios(weights[room], most[scene]))
        return places // scenes, excess, counted

    def expected(self, weights: F64) -> F64:
        """Return the expected draws of each occurrence if the occurrences have `weights`, per condition of its scene,
        if true and false conditions are drawn equally often.
        """
        key = 2 * self._form + (self.code & 1)
        sums = np.bincount(key, weights, 2 * len(self._group_of_form)).reshape(-1, 2)
        mass = sums.min(axis=1)  # a form with one truth is not used
        masses = np.bincount(self._group_of_form, mass, len(self._room_of_group))
        rooms, there = self._room_of_group, masses > 0
        of_room = np.bincount(rooms, self._group_weights * there, len(self._room_weights))[rooms]
        used = _ratios(self._group_weights * np.minimum(1.0, masses / FULL_MASS) * there, of_room)
        asked = self._presence * np.minimum(1.0, masses)
        share = np.bincount(rooms, asked, len(self._room_weights))[rooms]
        chance = np.where(self._presence > 0, asked, (1.0 - share) * used)
        whole = np.bincount(rooms, chance, len(self._room_weights))
        # A room of which nothing can be asked leaves its part to the others.
        asked_about = np.where(whole > 0, self._room_weights, 0.0)
        room_share = _ratios(asked_about, np.bincount(self._scene_of_room, asked_about)[self._scene_of_room])
        rate = _ratios(room_share[rooms] * chance, masses * whole[rooms])
        return _ratios(weights * (mass * rate[self._group_of_form])[self._form], sums.ravel()[key])


def _ratios(values: F64, wholes: NDArray[Any]) -> F64:
    """Return values divided by wholes (n,); 0 where the whole is 0."""
    found: F64 = np.divide(values, wholes, out=np.zeros_like(values), where=wholes > 0)
    return found


def fitted_log_factors(blocks: Iterable[ExpectedDraws], excess: F64, added: float = 0.0) -> F64:
    """Return the binary logarithm of one factor for each statement, (s,).

    Parameters
    ----------
    blocks : the draws in all scenes, some scenes in each block; they are iterated over many times, so no iterator
    excess (s,) : wanted imbalance, the excess of true draws over false ones as a share of both, as a share of what a
        fair coin would make it
    added : number of scenes, with as many draws each as a statement has on average, that are added to its draws of
        either truth, so that statements of few scenes are changed less. A scene counts less where little is asked about
        the room (`ExpectedDraws.of_scenes`)
    """
    if isinstance(blocks, Iterator):
        raise TypeError("blocks are iterated over many times, which an iterator can't be")
    log_factors = np.zeros(len(excess))
    fair_imbalance, scenes = _fair_imbalance(blocks, len(excess))
    share = excess * fair_imbalance
    for _ in range(FITTING_ROUNDS):
        factors = np.exp2(np.stack([-log_factors, log_factors], axis=1)).ravel()
        drawn = np.zeros(2 * len(log_factors))
        for block in blocks:
            np.add.at(drawn, block.code, block.expected(block.weights * factors[block.code]))
        false, true = drawn[0::2], drawn[1::2]
        total = false + true
        least = LEAST_SHARE * total + np.finfo(np.float64).tiny
        more = added * total / np.maximum(scenes, 1.0)
        wanted_true, wanted_false = (np.maximum(total * (1.0 + sign * share) / 2.0, least) + more for sign in (1, -1))
        change = np.sqrt(
            wanted_true / (np.maximum(true, least) + more) * (np.maximum(false, least) + more) / wanted_false
        )
        log_factors += np.log2(np.clip(change, 1.0 / MOST_A_ROUND, MOST_A_ROUND))
    return log_factors


def _fair_imbalance(blocks: Iterable[ExpectedDraws], count: int) -> tuple[F64, F64]:
    """Return √Σ d_k² / Σ |d_k| of each statement, where d_k are its draws in scene k without factors; and the number of
    scenes in which it occurs, each as much as it is asked about the room. Both (count,).

    With draws that have factors, statements would aim at what the factors make of them, and most draws would move to a
    few scenes.
    """
    drawn, squares, scenes = np.zeros(2 * count), np.zeros(count), np.zeros(count)
    for block in blocks:
        of_block = block.expected(block.weights)
        np.add.at(drawn, block.code, of_block)
        own, excess, counted = block.of_scenes(of_block)
        np.add.at(squares, own, excess**2)
        np.add.at(scenes, own, counted)
    total = drawn[0::2] + drawn[1::2]
    found: F64 = np.divide(np.sqrt(squares), total, out=np.ones(count), where=total > 0)
    return np.minimum(found, 1.0), scenes


def rounded_log_factors(log_factors: F64) -> I64:
    """Return binary logarithms in whole steps, none beyond the largest factor."""
    most = FACTOR_STEPS * MOST_LOG_FACTOR
    return np.clip(np.rint(FACTOR_STEPS * log_factors), -most, most).astype(np.int64)


def hashed_signs(statements: Sequence[tuple[object, ...]]) -> F64:
    """Return 1 or -1 for each statement, by its hash."""
    bits = (hashlib.blake2b(repr(one).encode(), digest_size=1).digest()[0] & 1 for one in statements)
    return np.fromiter((1.0 if one else -1.0 for one in bits), np.float64, len(statements))
