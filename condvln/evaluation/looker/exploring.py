"""Choose where the looker agent goes to see something new, and turn a target into its next action."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64, Bools
from condvln.evaluation.looker.floor_map import CELL, Ground, Ways, open_areas
from condvln.evaluation.looker.memory import Referents, Thing
from condvln.instructions.text_reading import Phrase
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, VLN_CE

__all__ = ["ARRIVED", "HALF_TURN", "Explorer", "Here", "Steering"]

Ints = NDArray[np.intp]

TURNS: Final = 3
"""How often it turns to the same target of exploration before it gives the target up."""
TURNING: Final = 0.25
"""Length in metres of a path that takes as many steps as a turn by one action."""
FAITHFUL: Final = 2.0
"""Length in metres by which another target must be nearer than the one before."""
SAME: Final = 1.0
"""Distance in metres between two targets that count as one."""
KNOWN_ROOM: Final = 8.0
"""Length in metres by which a frontier in a room that it has looked around in must be nearer than others when it looks
for another room: what is unseen there is mostly hidden by furniture.
"""
OUTLOOK: Final = 3.0
"""Distance in metres up to which it counts the unseen floor that it would see from a frontier."""
RAYS: Final = 32
"""Number of directions in which it counts that floor."""
MUCH: Final = 8.0
"""Area in square metres of unseen floor beyond which more makes no difference."""
MUCH_NEAR: Final = 3.0
"""The same in the rooms that it searches."""
LEAST_GAIN: Final = 0.1
"""Least area in square metres of unseen floor for which it goes anywhere."""
WIDE_VIEW: Final = 1.5
"""Area in square metres of unseen floor by way of which it looks for another room first: less is mostly behind
furniture.
"""
WORTH: Final = 1.0
"""Length in metres of the detour that a square metre of unseen floor is worth when it looks for another room."""
SECLUDED: Final = frozenset(("bathroom", "bedroom", "child's room", "closet", "laundry room", "pantry", "storage room",
                             "toilet room", "utility room"))  # fmt: skip
"""Rooms through which other kinds of rooms are seldom reached."""
DETOUR: Final = 6.0
"""Length in metres of the detour by which it looks elsewhere before it looks for a way on through such a room."""
ELSEWHERE: Final = 4.0
"""Length in metres of the detour by which it looks first in rooms of the right kind."""
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

    def sought(self, phrase: Phrase, here: Here) -> F64 | None:
        """Return a position from which the agent may find the object of a stop, or a definite one of a condition. The
        object is known to exist, so rooms that are already seen completely are searched a second time, from half the
        distance. Return None if the second search is complete too.
        """
        target = self.unseen(phrase, here)
        return self.unseen(phrase, here, self._close / 2) if target is None else target

    def unseen(
        self, phrase: Phrase, here: Here, close: float | None = None, around: tuple[F64, float] | None = None
    ) -> F64 | None:
        """Return a position from which the agent may see something new in the rooms that `phrase` may mean; None if
        everything in these rooms has been seen from at most `close` metres away.

        around : a position (2,) and a radius, metres; only floor within that radius must have been seen
        """
        ground = here.ground
        rooms = self._referents.rooms(phrase)
        open_to = self._open_to(ground)
        close = self._close if close is None else close
        targets = open_to & ground.passable & (ground.frontier | (ground.near > close))
        if around is not None:
            rows, columns = np.nonzero(targets)
            far = np.hypot(*(ground.places(rows, columns) - around[0]).T) > around[1]
            targets[rows[far], columns[far]] = False
        if rooms is None:
            return self._nearest(here, targets)
        inside = np.isin(ground.region, list(rooms))
        sure = self._referents.room_is_sure(phrase)
        if sure or around is not None:
            found = self._nearest(here, targets & inside)
            if found is not None or around is not None or rooms & self.been:
                return found
        rows, columns = np.nonzero(inside & ground.passable & open_to & np.isfinite(here.ways.distance))
        if len(rows) and not rooms & self.been:
            return self._least_effort(here, rows, columns)
        beyond = [thing.middle[[0, 2]] for thing in self._referents.memory if thing.room in rooms]
        # The room was seen, and no way into it.
        towards = np.mean(beyond, axis=0) if beyond and not rooms & self.been else None
        found = self._another_room(here, targets & (inside | ground.frontier), phrase, rooms, towards)
        if found is None:  # the only way on may be a narrow gap
            found = self._another_room(here, open_to & ground.edge, phrase, rooms, towards)
        return found

    def inwards(self, phrase: Phrase, here: Here) -> F64 | None:
        """Return a position on the way to the middle of the room of `phrase`; None if the agent is there, or knows no
        way to such a room.
        """
        rooms, ground = self._referents.rooms(phrase), here.ground
        inside = ground.passable & self._open_to(ground) & np.isfinite(here.ways.distance)
        inside &= np.isin(ground.region, list(rooms or ()))
        if not inside.any():
            return self.unseen(phrase, here)
        nearest = np.unravel_index(np.where(inside, here.ways.distance, np.inf).argmin(), inside.shape)
        places = ground.places(*np.nonzero(inside & (ground.region == ground.region[nearest])))
        middle = places[np.hypot(*(places - places.mean(axis=0)).T).argmin()]
        return None if np.hypot(*(here.place - middle)) <= SAME else np.asarray(middle, np.float64)

    def nearer(self, thing: Thing, move: Phrase, here: Here) -> F64 | None:
        """Return the position that can be reached and is the nearest to an object, no floor beside which is known; on
        the floor of the object's room, if any of it can be reached. If there is none, or the agent is as near already,
        return a position from which a way to the object may be found; None if nothing is left to explore.
        """
        ground, middle = here.ground, thing.middle[[0, 2]]
        floor = ground.passable & np.isfinite(here.ways.distance)
        entered = thing.room < 0 or bool(ground.region[ground.cell(*here.place.tolist())] == thing.room)
        rows, columns = np.nonzero(floor & ((ground.region == thing.room) | (thing.room < 0)))
        if len(rows):
            places = ground.places(rows, columns)
            away = np.hypot(*(places - middle).T)
            best = int(np.argmin(away))
            nearer = not entered or away[best] < np.hypot(*(here.place - middle)) - SAME / 2
            if nearer and self._open_to(ground)[rows[best], columns[best]]:
                return np.asarray(places[best], np.float64)
        return self.sought(move, here)

    def _open_to(self, ground: Ground) -> Bools:
        """Return the cells that are not near a position that was given up."""
        found = np.ones_like(ground.passable)
        for place in self._given_up:
            a, b = ground.cell(float(place[0]), float(place[1]))
            found[max(a - AROUND, 0) : a + AROUND + 1, max(b - AROUND, 0) : b + AROUND + 1] = False
        return found

    def _another_room(
        self, here: Here, targets: Bools, phrase: Phrase, rooms: set[int], towards: F64 | None
    ) -> F64 | None:
        """Return the target from which the room of `phrase`, which is not found for certain yet, is found at the least
        expected effort; None if no target can be reached.

        rooms : rooms that may be meant; towards (2,) : where such a room was seen, if it can't be entered
        """
        ground = here.ground
        rows, columns = np.nonzero(targets & np.isfinite(here.ways.distance))
        if not len(rows):
            return None
        gain = self._gain(ground, targets | ground.unseen, rows, columns)
        for least in (WIDE_VIEW, LEAST_GAIN):
            worth = gain >= least
            if worth.any():
                rows, columns, gain = rows[worth], columns[worth], gain[worth]
                break
        region = ground.region[rows, columns]
        extra = WORTH * np.maximum(MUCH - gain, 0.0) + KNOWN_ROOM * np.isin(region, list(self.been))
        if phrase.room is not None and phrase.room.label not in SECLUDED:
            secluded = [number for number, label in self._referents.memory.rooms.items() if label in SECLUDED]
            extra += DETOUR * np.isin(region, secluded)
        if rooms:
            extra += ELSEWHERE * ~np.isin(region, list(rooms))
        if towards is not None:
            extra += np.hypot(*(ground.places(rows, columns) - towards).T)
        return self._least_effort(here, rows, columns, extra)

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
        """Return the target that takes the least effort to reach, less for one from which more of the targets and of
        unseen floor is seen; None if no target can be reached.
        """
        ground = here.ground
        rows, columns = np.nonzero(targets & np.isfinite(here.ways.distance))
        gain = self._gain(ground, targets | ground.unseen, rows, columns)
        worth = gain >= LEAST_GAIN
        if not worth.any():
            return None
        extra = WORTH * np.maximum(MUCH_NEAR - gain[worth], 0.0)
        return self._least_effort(here, rows[worth], columns[worth], extra)

    @staticmethod
    def _gain(ground: Ground, wanted: Bools, rows: Ints, columns: Ints) -> F64:
        """Return the area in square metres of the cells in `wanted` that are seen from each of k cells."""
        return CELL * CELL * open_areas(wanted, ground.shut, rows, columns, round(OUTLOOK / CELL), RAYS)

    def _least_effort(self, here: Here, rows: Ints, columns: Ints, extra: F64 | float = 0.0) -> F64:
        """Return the place among k cells that takes the least effort: way, turn, and `extra` (k,) metres. Cells
        near the place that was returned before are preferred.
        """
        places = here.ground.places(rows, columns)
        away = places - here.place
        off = (np.arctan2(-away[:, 0], -away[:, 1]) - here.heading + math.pi) % (2 * math.pi) - math.pi
        cost = CELL * here.ways.distance[rows, columns] + TURNING * np.abs(off) / (2 * HALF_TURN) + extra
        if self._target is not None:
            cost -= FAITHFUL * (np.hypot(*(places - self._target).T) <= SAME)
        self._target = np.asarray(places[int(np.argmin(cost))], np.float64)
        return self._target


ARRIVED: Final = 0.2
"""Distance in metres at which a position counts as reached."""
AHEAD: Final = 2.0
"""Largest length in metres of a shortcut along its path, if the straight line is free."""
HALF_TURN: Final = math.radians(VLN_CE.turn) / 2
FREE: Final = 0.6
"""Length in metres of the free floor straight ahead for which it goes on although its target is a little aside."""
LENIENT: Final = 2.0
"""Half turns by which the target may then be aside."""
EASY: Final = 1.5
"""Cost of a cell above which floor does not count as free."""
PATIENT: Final = 24
"""Number of steps without progress after which it chooses another target."""
LONGER: Final = 5.0
"""Cost in cells by which the path must be longer than ever before for it to count as a detour."""


class Steering:
    """Steers the agent to one target after another, and keeps track of its progress towards the current target."""

    def __init__(self) -> None:
        self._goal: object = None
        self._best, self._most, self._since = math.inf, 0.0, 0

    def begin(self, step: int, goal: object = None) -> None:
        """Begin with a new target; `step` is the number of the agent's current step.

        Targets in a row with an equal `goal` other than None count as one whose place was corrected: what the agent
        gained towards the former ones is kept.
        """
        if goal is None or goal != self._goal:
            self._goal = goal
            self._best, self._most, self._since = math.inf, 0.0, step

    def action(self, aim: F64, here: F64, heading: float, ground: Ground, ways: Ways, step: int) -> int | None:
        """Return the action that leads from `here` (2,) towards the position `aim` (2,); None if `aim` is unreachable,
        or if the agent makes no progress.
        """
        cell = ground.cell(float(aim[0]), float(aim[1]))
        path, length = ways.to(cell), float(ways.distance[cell])
        if not np.isfinite(length) or len(path) < 2:
            return None
        if length < self._best - 1 or length > self._most + LONGER:
            self._best, self._since = length, step
        elif step - self._since > PATIENT:
            return None
        self._most = max(self._most, length)
        towards = path[1]
        for point in path[2:]:
            if np.hypot(*(point - here)) > AHEAD or not ground.open_between(here, point):
                break
            towards = point
        away = towards - here
        if np.hypot(*away) < CELL and len(path) > 2:
            away = path[2] - here
        wanted = math.atan2(-away[0], -away[1])
        off = (wanted - heading + math.pi) % (2 * math.pi) - math.pi
        if abs(off) <= HALF_TURN + 1e-9:
            return FORWARD
        if abs(off) <= LENIENT * HALF_TURN and np.hypot(*away) > FREE and length * CELL > 2 * FREE:
            ahead = here - FREE * np.array([math.sin(heading), math.cos(heading)])
            if ground.open_between(here, ahead, among=ground.cost > EASY):
                return FORWARD
        return LEFT if off > 0 else RIGHT
