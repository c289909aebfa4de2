"""Choose where the looker agent goes to see something new."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from condvln.evaluation.looker.floor_map import CELL, F64, Bools, Ground, Ways
from condvln.evaluation.looker.referents import Referents
from condvln.evaluation.looker.steering import HALF_TURN
from condvln.instructions.text_reading import Phrase

__all__ = ["Explorer", "Here"]

TURNS: Final = 3
"""How often it turns to the same target of exploration before it gives the target up."""
TURNING: Final = 0.25
"""Length in metres of a path that takes as many steps as a turn by one action."""
FAITHFUL: Final = 1.0
"""Length in metres by which another target must be nearer than the one before."""
KNOWN_ROOM: Final = 8.0
"""Length in metres by which a frontier in a room that it has looked around in must be nearer than others when it looks
for another room: what is unseen there is mostly hidden by furniture.
"""
AROUND: Final = 4
"""Cells around a target that was given up which are no targets either."""


@dataclass(frozen=True, eq=False, slots=True)
class Here:
    """Where the agent is: position (2,) in metres, heading in radians, the map, and the paths from this position."""

    place: F64
    heading: float
    ground: Ground
    ways: Ways


class Explorer:
    """Chooses the positions to which the agent goes to explore.

    Attributes
    ----------
    been : numbers of the rooms that the agent has looked around in
    """

    def __init__(self, referents: Referents, close: float) -> None:
        self.been: set[int] = set()
        self._referents, self._close = referents, close
        self._given_up: list[F64] = []
        self._target: F64 | None = None  # the last one
        self._towards: tuple[int, int] | None = None
        self._turned_to: dict[tuple[int, int], int] = {}

    def sought(self, move: Phrase, here: Here) -> F64 | None:
        """Return a position from which the agent may find the object of a stop. The object is known to exist, so rooms
        that are already seen completely are searched a second time, from half the distance. Return None if the second
        search is complete too.
        """
        target = self.unseen(move, here)
        return self.unseen(move, here, self._close / 2) if target is None else target

    def unseen(
        self, phrase: Phrase, here: Here, close: float | None = None, around: tuple[F64, float] | None = None
    ) -> F64 | None:
        """Return a position from which the agent may see something new in the rooms that `phrase` may mean; None if
        everything in these rooms has been seen from at most `close` metres away.

        around : a position (2,) and a radius, metres; only floor within that radius must have been seen
        """
        ground, ways = here.ground, here.ways
        rooms = self._referents.rooms(phrase)
        targets = ground.passable & (ground.frontier | (ground.near > (self._close if close is None else close)))
        open_to = np.ones_like(targets)
        for place in self._given_up:
            a, b = ground.cell(float(place[0]), float(place[1]))
            beside = slice(max(a - AROUND, 0), a + AROUND + 1), slice(max(b - AROUND, 0), b + AROUND + 1)
            targets[beside] = open_to[beside] = False
        if around is not None:
            rows, columns = np.nonzero(targets)
            far = np.hypot(*(ground.places(rows, columns) - around[0]).T) > around[1]
            targets[rows[far], columns[far]] = False
        if rooms is None:
            return self._nearest(here, targets)
        inside = np.isin(ground.region, list(rooms))
        found = self._nearest(here, targets & inside)
        if found is not None or around is not None or (rooms & self.been and self._referents.room_is_sure(phrase)):
            return found
        entrance = self._nearest(here, inside & ground.passable & open_to)
        if entrance is not None and not rooms & self.been:
            return entrance
        rows, columns = np.nonzero(ground.frontier & targets & np.isfinite(ways.distance))
        if not len(rows):
            return None
        places, cost = ground.places(rows, columns), CELL * ways.distance[rows, columns]
        cost = cost + KNOWN_ROOM * np.isin(ground.region[rows, columns], list(self.been))
        beyond = [thing.middle[[0, 2]] for thing in self._referents.memory if thing.room in rooms]
        if beyond and not rooms & self.been:
            # The room was seen, and no way into it.
            cost = cost + np.hypot(*(places - np.mean(beyond, axis=0)).T)
        return np.asarray(places[int(np.argmin(cost))], np.float64)

    def turn_to(self, place: F64) -> None:
        """Count how often the agent has turned to `place`, a target of its exploration. Give the target up when the
        count exceeds `TURNS`.
        """
        key = round(float(place[0])), round(float(place[1]))
        if key != self._towards:
            self._towards = key
            self._turned_to[key] = self._turned_to.get(key, 0) + 1
            if self._turned_to[key] > TURNS:
                self.give_up(place)

    def give_up(self, place: F64) -> None:
        """Do not return positions near `place` any more."""
        self._given_up.append(place)

    def _nearest(self, here: Here, targets: Bools) -> F64 | None:
        """Return the target that takes the least effort to reach, the turn towards it included. Targets near the
        previously returned one are preferred. None if no target can be reached.
        """
        rows, columns = np.nonzero(targets & np.isfinite(here.ways.distance))
        if not len(rows):
            return None
        places = here.ground.places(rows, columns)
        away = places - here.place
        off = (np.arctan2(-away[:, 0], -away[:, 1]) - here.heading + math.pi) % (2 * math.pi) - math.pi
        cost = CELL * here.ways.distance[rows, columns] + TURNING * np.abs(off) / (2 * HALF_TURN)
        if self._target is not None:
            cost -= FAITHFUL * (np.hypot(*(places - self._target).T) <= FAITHFUL)
        self._target = np.asarray(places[int(np.argmin(cost))], np.float64)
        return self._target
