"""Draws the candidates of one cell by compiled loops, as arrays of numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.condition_sampler import ConditionSampler
from condvln.instructions.kernels.candidates import (
    FAILED,
    FAILED_BEFORE,
    FOUND,
    GOLDS,
    LEFT,
    LEFT_BEFORE,
    SEEN,
    SHAPES_LEFT,
    WantedCell,
    cell_state,
    draw_candidates,
    found_candidates,
)
from condvln.instructions.kernels.conditions import RULES
from condvln.instructions.kernels.programs import REASONS
from condvln.instructions.kernels.stops import MOST_MOVES
from condvln.instructions.name_tables import NumberedNames
from condvln.instructions.stop_sampler import StopSampler
from condvln.seeding import Draws

__all__ = ["CellDrawing", "DrawnCandidate", "Seen"]

I64 = NDArray[np.int64]


class DrawnCandidate(NamedTuple):
    """A program by numbers.

    rooms, room_names : the rooms, and which of its names each has
    stops : names of the stops of each leaf
    gold : the leaf to which the truths of the conditions lead
    truths : row of the truths that lead there
    conditions : of each condition, which of the rooms that can be asked about, the pool, and the statement's place
    """

    rooms: list[int]
    room_names: list[int]
    stops: list[list[int]]
    gold: int
    truths: int
    conditions: list[list[int]]


class Seen:
    """The candidates of a category so far.

    keys (s, k) : the first `count` of them tell the candidates apart; without rows, candidates may be equal
    used (l,) : how often each label of targets is a goal
    """

    def __init__(self, most: int, leaves: int, conditions: int, labels: int) -> None:
        self.keys = np.zeros((most, 3 * conditions + MOST_MOVES * leaves), np.int64)
        self.used = np.zeros(labels, np.int64)
        self.count = 0


class CellDrawing:
    """Draws candidates of one cell, one after the other.

    Parameters
    ----------
    wanted : what is wanted of them
    most : most candidates, shapes : most shapes that are tried
    """

    def __init__(
        self,
        wanted: WantedCell,
        most: int,
        shapes: int,
        draws: Draws,
        seen: Seen,
        stops: StopSampler,
        names: NumberedNames,
        conditions: ConditionSampler,
    ) -> None:
        self._wanted, self._most, self._draws, self._seen = wanted, most, draws, seen
        self._stops, self._names, self._conditions = stops, names, conditions
        leaves = wanted.below.shape[2]
        self._state = cell_state(shapes, leaves, seen.used, seen.keys, seen.count)
        self._found = found_candidates(most, leaves, len(wanted.asked))

    def draw(self, most: int, rejected: Counter[str]) -> list[DrawnCandidate]:
        """Return the next candidates, at most `most` and fewer if the cell is exhausted. Draws that fail, and
        conditions that violate a rule, are added to `rejected`.
        """
        found, numbers = self._found, self._state.numbers
        begin = int(numbers[FOUND])
        numbers[SEEN] = self._seen.count  # other cells of the category may have drawn meanwhile
        statements = self._conditions.numbered.tables

        def kernel(stream: NDArray[np.float64], left: I64) -> None:
            draw_candidates(
                min(begin + most, self._most), self._wanted, self._state, self._stops.room_of, self._stops.tables,
                self._names.tables, statements, stream, left, found,
            )  # fmt: skip

        self._draws.compiled(kernel)
        self._seen.count = int(numbers[SEEN])
        for reasons, counts in ((REASONS, found.failures), (RULES, found.clashes)):
            for reason, count in zip(reasons, counts.tolist(), strict=True):
                if count:
                    rejected[reason] += count
            counts[:] = 0
        return self._candidates(begin, int(numbers[FOUND]))

    @property
    def moves(self) -> tuple[int, ...]:
        """Number of moves of each leaf in the shape that was drawn last."""
        return tuple(self._state.moves.tolist())

    def _candidates(self, begin: int, end: int) -> list[DrawnCandidate]:
        found = self._found
        columns = (found.moves, found.golds, found.rooms, found.room_names, found.names, found.truths, found.conditions)
        return [
            DrawnCandidate(
                rooms[1 : 1 + rooms[0]],
                names[: rooms[0]],
                [own[:count] for own, count in zip(stops, moves, strict=True)],
                gold,
                truths[0],
                conditions,
            )
            for moves, gold, rooms, names, stops, truths, conditions in zip(
                *(column[begin:end].tolist() for column in columns), strict=True
            )
        ]

    def aim(self, golds: Sequence[int], move_shares: Sequence[float]) -> None:
        """Let the next candidates have the gold leaves `golds`, dealt in a random order, and leaves with 1, 2, …
        moves in the shares `move_shares`.
        """
        dealt, sums = np.array(golds, np.int64), np.array(tuple(accumulate(move_shares)), np.float64)
        self._wanted = self._wanted._replace(golds=dealt, move_sums=sums)
        if len(dealt) > len(self._state.golds):
            self._state = self._state._replace(golds=np.zeros(len(dealt), np.int64))
        self._state.numbers[GOLDS] = 0

    def refuse(self) -> None:
        """Take the last candidate back: its shape is tried again as long as it has draws left."""
        numbers, found = self._state.numbers, self._found
        numbers[FOUND] -= 1
        numbers[FAILED], numbers[LEFT] = numbers[FAILED_BEFORE], numbers[LEFT_BEFORE]
        if len(self._seen.keys):
            numbers[SEEN] -= 1
            self._seen.count -= 1
        last = numbers[FOUND]
        for leaf, count in enumerate(found.moves[last].tolist()):
            self._seen.used[self._stops.tables.questions.label[found.stops[last, leaf, count - 1]]] -= 1

    def begin(self, gold: int) -> None:
        """Let one shape be drawn for a candidate whose gold leaf is `gold`; forget the candidates before it."""
        numbers = self._state.numbers
        numbers[[SHAPES_LEFT, FAILED, LEFT, FOUND, GOLDS]] = 1, 0, 0, 0, 1
        self._state.golds[0] = gold
        self._seen.used[:] = 0
