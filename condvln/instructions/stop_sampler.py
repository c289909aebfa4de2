"""The rooms and the stops from which programs are drawn: which objects leaves lead to, and by which other objects."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache, partial
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.kernels.stops import MOST_MOVES, ByLabel, Questions, TargetTables, targets_fit
from condvln.instructions.stops import Targets
from schemas.config.constants import MOST_ROOMS, PLAIN_ROOM_WEIGHT

__all__ = ["ROOM_SPANS", "StopSampler"]

I64 = NDArray[np.int64]

ROOM_SPANS: Final = np.array([[1, 1], [2, 2], [3, MOST_ROOMS]])
"""Least and most rooms of a program, by the number of its composition."""

ANSWERS_KEPT: Final = 2**15
"""Number of answers kept to the question whether targets fit; a power of two. A scene asks some thousands."""


class StopSampler:
    """The rooms and stops of programs of one scene, as `draw_candidates` draws them.

    The rooms of a program have different types: a listener would confuse "the bedroom with the desk" and "the bedroom
    with the plant", and a text with only one bedroom needs no distinguishing object. Rooms that are named by their
    label alone are preferred. Goals have different labels and are pairwise apart, and so are the stops of a leaf;
    rarely used labels are preferred as goals. No word names stops in two rooms.

    Parameters
    ----------
    types : type of each room that has a name, by room id
    plain : ids of the rooms that are named by their label alone
    asked : ids of the rooms about which conditions can be asked
    is_left_by : whether a room can still be asked about, by its id, if a text has a stop, by its room id and label

    Attributes
    ----------
    tables, room_of : the targets as arrays, and the room of each
    rooms : ids of the rooms, targets : the targets, by their numbers there
    labels : labels of the targets
    kinds : number of types of rooms
    """

    def __init__(
        self,
        found: Targets,
        types: Mapping[str, str],
        plain: Collection[str],
        asked: Sequence[str],
        is_left_by: Callable[[str, tuple[str, str]], bool],
    ) -> None:
        self.targets, self.rooms = found.targets, tuple(types)
        numbers = {room: k for k, room in enumerate(types)}
        kinds = {kind: k for k, kind in enumerate(dict.fromkeys(types.values()))}
        weights = {target.label: target.weight for target in found.targets}
        self.labels, self.kinds = tuple(weights), len(kinds)
        label_numbers = {label: k for k, label in enumerate(weights)}
        label = np.array([label_numbers[target.label] for target in found.targets], np.int64)
        self.room_of = np.array([numbers[target.room_id] for target in found.targets], np.int64)
        self._plain = np.array([room in plain for room in types], bool)
        ends = np.cumsum(np.bincount(label, minlength=len(weights)), dtype=np.int64)
        type_of = np.array([kinds[kind] for kind in types.values()], np.int64)
        asked_numbers = np.array([numbers[room] for room in asked], np.int64)
        self.tables = TargetTables(
            questions=Questions(
                apart=np.ascontiguousarray(found.apart),
                label=label,
                marks=np.random.default_rng(0).integers(-(2**63), 2**63 - 1, (len(label), 4)),
                digests=np.zeros((ANSWERS_KEPT, 2), np.int64),
                answers=np.zeros(ANSWERS_KEPT, bool),
            ),
            by_label=ByLabel(
                clear=np.array([target.clear for target in found.targets], bool),
                members=np.argsort(label, kind="stable").astype(np.int64),
                spans=np.stack([np.concatenate([[0], ends[:-1]])[: len(ends)], ends], axis=1).astype(np.int64),
            ),
            alike=np.ascontiguousarray(found.alike),
            order=np.arange(len(weights), dtype=np.int64),
            weights=np.array(tuple(weights.values()), np.float64),
            held=self.room_of[None] == np.arange(len(types))[:, None],
            spoiling=self._spoiling(types, asked, is_left_by),
            asked=asked_numbers,
            asked_sums=self._preferences(asked_numbers),
            by_type=np.argsort(type_of, kind="stable").astype(np.int64),
            type_of=type_of,
            plain=self._plain,
        )
        self._known_roomy: dict[tuple[int, int], tuple[I64, NDArray[np.float64]]] = {}

    def _spoiling(
        self, types: Iterable[str], asked: Sequence[str], is_left_by: Callable[[str, tuple[str, str]], bool]
    ) -> NDArray[np.bool_]:
        """Return a mask (r, t) of the targets that leave nothing to ask about a room, by room: all targets, if nothing
        is asked about the room in any case.
        """
        rows = []
        for room_id in types:
            leaves = cache(partial(is_left_by, room_id))
            rows.append([room_id not in asked or not leaves((target.room_id, target.label)) for target in self.targets])
        return np.array(rows, bool).reshape(len(rows), len(self.targets))

    def fits(self, leaves: int) -> bool:
        """Return whether the scene has targets for so many leaves."""
        everything = np.ones(len(self.targets), bool)
        return targets_fit(everything, everything, leaves, 0, self.tables.questions)

    def roomy(self, leaves: int) -> bool:
        """Return whether a room about which conditions can be asked has targets for so many leaves."""
        return len(self._roomy(leaves, 0)[0]) > 0

    def roomy_tables(self, leaves: int) -> tuple[I64, NDArray[np.float64], I64]:
        """Return the rooms that can be asked about and have targets for `leaves` goals and up to 0, 1, … more stops of
        a leaf, a row each, their running weights, and how many rooms each row has.
        """
        rows = [self._roomy(leaves, waypoints) for waypoints in range(MOST_MOVES)]
        rooms = np.zeros((MOST_MOVES, len(self.rooms)), np.int64)
        sums = np.zeros((MOST_MOVES, len(self.rooms)), np.float64)
        for k, (numbers, weights) in enumerate(rows):
            rooms[k, : len(numbers)], sums[k, : len(numbers)] = numbers, weights
        return rooms, sums, np.array([len(numbers) for numbers, _ in rows], np.int64)

    def _roomy(self, leaves: int, waypoints: int) -> tuple[I64, NDArray[np.float64]]:
        """Return the numbers of the rooms that can be asked about and have targets for `leaves` goals, and then for
        `waypoints` more, with running weights.
        """
        key, tables, questions = (leaves, waypoints), self.tables, self.tables.questions
        if key not in self._known_roomy:
            chosen = [
                room
                for room, held in ((room, tables.held[room]) for room in tables.asked.tolist())
                if targets_fit(held, held, leaves, 0, questions)
                and targets_fit(held, held, leaves, waypoints, questions)
            ]
            rooms = np.array(chosen, np.int64)
            self._known_roomy[key] = rooms, self._preferences(rooms)
        return self._known_roomy[key]

    def _preferences(self, rooms: I64) -> NDArray[np.float64]:
        """Return running weights with which rooms are drawn."""
        weights = np.where(self._plain[rooms], PLAIN_ROOM_WEIGHT, 1.0).tolist()
        return np.array(tuple(accumulate(weights)), np.float64)
