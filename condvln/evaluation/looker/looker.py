"""The looker agent: reads the text, looks around, decides each condition from what it has seen, and walks to the
leaf.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.evaluation.looker.approach import Approach, approach
from condvln.evaluation.looker.eyes import Look
from condvln.evaluation.looker.floor_map import CELL, FloorMap, Ground, Ways
from condvln.evaluation.looker.judging import Compared, gap, holds, ranked
from condvln.evaluation.looker.memory import Memory, Thing
from condvln.instructions import parse
from condvln.instructions.language import LANGUAGES
from condvln.instructions.text_reading import Phrase, Place, Reading
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, VLN_CE
from condvln.seeding import generator
from schemas.config import LookerConfig, Thresholds
from schemas.errors import FormatError
from schemas.program import BEARINGS, SHAPES

__all__ = ["Looker", "read_text"]

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

HEADINGS: Final = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
LOOK_EVERY: Final = 0.5
"""Metres that it walks between two views."""
ARRIVED: Final = 0.2
"""Distance in metres at which a position counts as reached."""
LOOKS: Final = 8
"""Largest number of views near an object by which it looks for a place to stop beside the object."""
BESIDE: Final = 4.0
"""Distance in metres at which views count as near an object."""
TRIES: Final = 4
"""Largest number of places to stop at that it can't reach before it stops where it is."""
AHEAD: Final = 2.0
"""Largest length in metres of a shortcut along its path, if the straight line is free."""
BY_SURFACES: Final = frozenset(("near", "on", "in", "above", "below", "between"))
"""Relations that may become true when more is seen of the same things."""
TURNS: Final = 3
"""How often it turns to the same target of exploration before it gives the target up."""
APART: Final = 1.5
"""Distance in metres between what is seen of two things at which neither touches or is near the other."""
TURNING: Final = 0.25
"""Length in metres of a path that takes as many steps as a turn by one action."""
FAITHFUL: Final = 1.0
"""Length in metres by which another target must be nearer than the one before."""
HALF_TURN: Final = math.radians(VLN_CE.turn) / 2
PATIENT: Final = 12
"""Number of steps without progress after which it chooses another target."""


def read_text(text: str) -> Reading:
    """Parse an instruction in any of the shipped languages.

    Raises
    ------
    FormatError : no language's grammar parses the text
    """
    fault: FormatError | None = None
    for code in LANGUAGES:
        try:
            return parse(text, code)
        except FormatError as error:
            fault = fault or error
    assert fault is not None
    raise fault


class Looker:
    """One episode of the agent. Its inputs are the text, its own steps, and what it sees.

    Poses are its own estimates in the frame of the start: metres, x to the right and z backwards, and headings in
    radians counter-clockwise from the start's.

    Attributes
    ----------
    verdicts : its answers so far, by the condition's index in the text; leaf : the chosen leaf, None before the choice
    forced : conditions that it answered without sufficient evidence
    """

    def __init__(self, text: str, max_steps: int, config: LookerConfig, seed: int = 0, episode: str = "") -> None:
        self.config = config
        self.reading = read_text(text)
        self.verdicts: dict[int, bool] = {}
        self.forced: set[int] = set()
        self.leaf: int | None = None
        self.map = FloorMap()
        self.memory = Memory(config.memory)
        self._north = None if self.reading.heading is None else 45.0 * HEADINGS.index(self.reading.heading)
        self._limit = max_steps
        self._flipped = generator(seed, "logic", episode).uniform(size=len(self.reading.conditions)) < config.logic
        self._t = Thresholds()
        self._step = 0
        self._looked: F64 | None = None
        self._place, self._heading = np.zeros(3), 0.0
        self._ground: Ground | None = None
        self._ways: Ways | None = None
        self._aim: F64 | None = None
        self._last: F64 = np.zeros(2)  # the previous stop, at first the start
        self._moves_done = 0
        self._start_room = -1
        self._been: set[int] = set()  # rooms that it has looked around in
        self._given_up: list[F64] = []
        self._explored: F64 | None = None  # the last target of exploration
        self._stop: F64 | None = None  # where it wants to stop
        self._approaching = False  # the target is a place from which to see the floor around an object
        self._approached: Thing | None = None
        self._looks_beside = 0
        self._looked_from: list[F64] = []
        self._not_reached: list[F64] = []
        self._stopping = False
        self._blocked_at: list[F64] = []
        self._towards_key: tuple[int, int] | None = None
        self._turned_to: dict[tuple[int, int], int] = {}
        self._best, self._since = math.inf, 0

    def act(self, place: F64, heading: float, look: Callable[[], Look], bumped: bool) -> int:
        """Return the next action.

        Parameters
        ----------
        place (3,), heading : its estimated pose
        look : returns the view from there
        bumped : the last forward step collided
        """
        self._place, self._heading = place, heading
        if bumped:
            self._bump()
        flat = place[[0, 2]]
        if self._looked is None or np.hypot(*(flat - self._looked)) >= LOOK_EVERY:
            self._take_in(look())
        action = None
        for _ in range(40):
            if self._aim is None:
                self._decide()
            if self._aim is None:
                action = STOP
                break
            action = self._towards(self._aim)
            if action is not None:
                break
            self._come_there(look)
        self._step += 1
        return LEFT if action is None else action

    @property
    def picked(self) -> int:
        """Return the leaf that the answers so far lead to; what was seen so far answers the undecided conditions."""
        if self.leaf is not None:
            return self.leaf
        shape = SHAPES[self.reading.category]
        at = 0
        while at >= 0:
            branch = shape.branches[at]
            number = branch.condition
            answer = self.verdicts.get(number)
            if answer is None:
                answer = self._judge(self.reading.conditions[number])[1] != bool(self._flipped[number])
            at = branch.then if answer else branch.otherwise
        return -1 - at

    # Perception

    def _bump(self) -> None:
        """Mark the place just ahead as blocked on the map. The more often the agent was blocked around here, the wider
        the marked area.
        """
        here = self._place[[0, 2]]
        self._blocked_at.append(here)
        blocked = sum(float(np.hypot(*(here - place))) <= ARRIVED for place in self._blocked_at)
        wide = min(blocked - 1, 4)
        for k in range(-wide, wide + 1):
            angle = self._heading + math.radians(25.0 * k)
            for away in (0.2,) if blocked < 3 else (0.12, 0.2):
                self.map.bump(
                    float(self._place[0]) - away * math.sin(angle), float(self._place[2]) - away * math.cos(angle)
                )
        self._aim = self._ground = None

    def _take_in(self, look: Look) -> None:
        place = self._place
        self._looked = place[[0, 2]].copy()
        self.map.add(look, float(place[0]), float(place[2]), self._heading, self.config.reach)
        self.memory.add(look, place, self._heading, self._step)
        if self._step == 0:
            self._start_room = look.here
        self._been.add(look.here)
        if self._approaching and self._approached is not None and self._distance(self._approached) <= BESIDE:
            self._looks_beside += 1
        self._ground = self._aim = None

    def _now(self) -> tuple[Ground, Ways]:
        x, z = float(self._place[0]), float(self._place[2])
        if self._ground is None:
            self._ground = self.map.ground(x, z)
            self._ways = None
        if self._ways is None:
            self._ways = self._ground.ways_from(x, z)
        return self._ground, self._ways

    # Decisions

    def _decide(self) -> None:
        """Choose the next target; at the end of the instruction, choose none."""
        shape = SHAPES[self.reading.category]
        at = 0
        while at >= 0:
            branch = shape.branches[at]
            verdict = self._verdict(branch.condition)
            if verdict is None:
                return
            at = branch.then if verdict else branch.otherwise
        self.leaf = -1 - at
        moves = self.reading.leaves[self.leaf]
        while self._moves_done < len(moves):
            move = moves[self._moves_done]
            thing, target = (self._approached, None) if self._approached is not None else self._found(move)
            if thing is None:
                if target is not None:
                    self._set_aim(target)
                    return
                self._next_move()  # not found anywhere: continue with what can be found
                continue
            found = self._way_to(thing)
            if found is None:
                self._next_move()
                continue
            self._set_aim(found.place, stop=found.final, beside=not found.final)
            return
        self._aim = None

    def _verdict(self, number: int) -> bool | None:
        """Return the answer to a condition. If more must be seen first, set a target and return None."""
        if number in self.verdicts:
            return self.verdicts[number]
        phrase = self.reading.conditions[number]
        answer, guess = self._judge(phrase)
        if answer is None:
            target = (
                self._unseen(phrase, self.config.close) if self._step < self.config.patience * self._limit else None
            )
            if target is not None:
                self._set_aim(target)
                return None
            if self._step >= self.config.patience * self._limit:
                self.forced.add(number)
            answer = guess
        if self._flipped[number]:
            answer = not answer
        self.verdicts[number] = answer
        return answer

    def _judge(self, phrase: Phrase) -> tuple[bool | None, bool]:
        """Return two answers to the condition in `phrase`: the certain one (None if what was seen so far is not
        enough), and the one to give if nothing more can be seen.
        """
        rooms = self._rooms(phrase)
        things = self._known(phrase.label, rooms)
        if phrase.qualifier is None:
            return (True, True) if things and rooms is not None and self._room_is_sure(phrase) else (None, bool(things))
        predicate, labels = phrase.qualifier
        if predicate in BEARINGS:
            if not things:
                return None, False
            best = max(holds(predicate, thing, (), self._north, self._t) for thing in things)
            return (best > 0 if self._close(things[0]) else None), best > 0
        anchors = self._anchors(labels, rooms)
        if anchors is None or not things:
            return None, False
        scores = [holds(predicate, thing, anchors, self._north, self._t) for thing in things if thing not in anchors]
        if not scores:
            return None, False
        sure = all(self._close(thing) for thing in (*anchors, *things)) and self._room_is_sure(phrase)
        if max(scores) > 0:
            return (True if sure else None), True
        # More of the same things may be seen, but not so much more.
        settled = predicate not in BY_SURFACES or min(gap(thing, anchors[0]) for thing in things) > APART
        return (False if sure and settled and phrase.definite else None), False

    def _found(self, move: Phrase) -> tuple[Thing | None, F64 | None]:
        """Return the object of a stop, or else a position from which to look for it."""
        rooms = self._rooms(move)
        things = self._known(move.label, rooms)
        target = None
        if move.qualifier is None:
            if things and self._room_is_sure(move):
                return min(things, key=self._distance), None
            target = self._sought(move)
            return (things[0] if things and target is None else self._fallback(move, target)), target
        predicate, labels = move.qualifier
        anchors = () if predicate in (*BEARINGS, "bigger", "smaller") else self._anchors(labels, rooms)
        if predicate in Compared:
            wanted = 2 if predicate != "closest to" else len(things) + 1
            if len(things) < wanted or anchors is None or not all(self._close(thing) for thing in things):
                target = self._sought(move)
            if target is None and things:
                return ranked(predicate, things, anchors)[0] if anchors is not None else things[0], None
            return self._fallback(move, target), target
        best = None
        if things and anchors is not None:
            scored = [
                (holds(predicate, thing, anchors, self._north, self._t), thing)
                for thing in things
                if thing not in anchors
            ]
            if scored:
                score, best = max(scored, key=lambda pair: pair[0])
                if score > 0 and self._close(best) and self._room_is_sure(move):
                    return best, None
        target = self._sought(move)
        if target is not None:
            return None, target
        return best or (things[0] if things else self._fallback(move, None)), None

    def _fallback(self, move: Phrase, target: F64 | None) -> Thing | None:
        """Return a known object with the label of `move` in any room, if nothing is left to explore (`target` is None);
        else None.
        """
        if target is not None:
            return None
        things = self._known(move.label, None)
        return things[0] if things else None

    # Rooms and objects as named in the text

    def _rooms(self, phrase: Phrase) -> set[int] | None:
        """Return the numbers of the known rooms that a phrase may mean; None for any room."""
        if phrase.room is None:
            at_start = phrase.qualifier is not None and phrase.qualifier[0] in BEARINGS
            return {self._start_room} if at_start and self._start_room >= 0 else None
        return self._rooms_of(phrase.room)

    def _rooms_of(self, place: Place) -> set[int]:
        rooms = {number for number, label in self.memory.rooms.items() if label == place.label}
        if place.anchor is not None:
            held = {thing.room for thing in self.memory if thing.label == place.anchor}
            rooms = rooms & held or rooms
        return rooms

    def _room_is_sure(self, phrase: Phrase) -> bool:
        """Return whether it is certain which room a phrase means. A phrase may tell the room by an object in it; then
        that object must have been seen in a room of the type that the phrase names.
        """
        place = phrase.room
        if place is None or place.anchor is None:
            return True
        return any(thing.label == place.anchor and self.memory.rooms.get(thing.room) == place.label
                   for thing in self.memory)  # fmt: skip

    def _known(self, label: str, rooms: set[int] | None) -> list[Thing]:
        return [thing for thing in self.memory if thing.label == label and (rooms is None or thing.room in rooms)]

    def _anchors(self, labels: Sequence[str], rooms: set[int] | None) -> tuple[Thing, ...] | None:
        found: list[Thing] = []
        for label in labels:
            known = [thing for thing in self._known(label, rooms) if thing not in found]
            if not known:
                return None
            found.append(max(known, key=lambda thing: len(thing.cubes)))
        return tuple(found)

    def _close(self, thing: Thing) -> bool:
        return thing.nearest <= self.config.close

    def _distance(self, thing: Thing) -> float:
        return float(np.hypot(*(thing.middle - self._place)[[0, 2]]))

    # Where to go

    def _sought(self, move: Phrase) -> F64 | None:
        """Return a position from which the agent may find the object of a stop. The object is known to exist, so rooms
        that are already seen completely are searched again from half the distance. None if this second search is
        complete too.
        """
        target = self._unseen(move, self.config.close)
        return self._unseen(move, self.config.close / 2) if target is None else target

    def _unseen(self, phrase: Phrase, close: float) -> F64 | None:
        """Return a position from which the agent may see something new in the rooms that `phrase` may mean; None if
        everything in these rooms has been seen from at most `close` metres away.
        """
        ground, ways = self._now()
        rooms = self._rooms(phrase)
        targets = ground.passable & (ground.frontier | (ground.near > close))
        open_to = np.ones_like(targets)
        for place in self._given_up:
            a, b = ground.cell(float(place[0]), float(place[1]))
            targets[max(a - 4, 0) : a + 5, max(b - 4, 0) : b + 5] = False
            open_to[max(a - 4, 0) : a + 5, max(b - 4, 0) : b + 5] = False
        reached = np.isfinite(ways.distance)
        if rooms is None:
            return self._nearest(ways, targets)
        inside = np.isin(ground.region, list(rooms))
        found = self._nearest(ways, targets & inside)
        if found is not None or (rooms & self._been and self._room_is_sure(phrase)):
            return found
        entrance = self._nearest(ways, inside & ground.passable & open_to)
        if entrance is not None and not rooms & self._been:
            return entrance
        rows, columns = np.nonzero(ground.frontier & targets & reached)
        if not len(rows):
            return None
        places, cost = ground.places(rows, columns), CELL * ways.distance[rows, columns]
        beyond = [thing.middle[[0, 2]] for thing in self.memory if thing.room in rooms]
        if beyond and not rooms & self._been:
            # The room was seen, and no way into it.
            cost = cost + np.hypot(*(places - np.mean(beyond, axis=0)).T)
        return np.asarray(places[int(np.argmin(cost))], np.float64)

    def _nearest(self, ways: Ways, targets: Bools) -> F64 | None:
        """Return the target that takes the least effort to reach, the turn towards it included. Targets near the
        previously returned one are preferred. None if no target can be reached.
        """
        rows, columns = np.nonzero(targets & np.isfinite(ways.distance))
        if not len(rows):
            return None
        places = ways.ground.places(rows, columns)
        away = places - self._place[[0, 2]]
        off = (np.arctan2(-away[:, 0], -away[:, 1]) - self._heading + math.pi) % (2 * math.pi) - math.pi
        cost = CELL * ways.distance[rows, columns] + TURNING * np.abs(off) / (2 * HALF_TURN)
        if self._explored is not None:
            cost -= FAITHFUL * (np.hypot(*(places - self._explored).T) <= FAITHFUL)
        self._explored = np.asarray(places[int(np.argmin(cost))], np.float64)
        return self._explored

    def _way_to(self, thing: Thing) -> Approach | None:
        """Return where to go to reach an object; None if nothing near it can be reached."""
        ground, ways = self._now()
        looked = self._looked_from if self._looks_beside < LOOKS else None
        found = approach(thing, ground, ways, self._last, kept=self._stop, given_up=self._not_reached, looked=looked)
        self._stop = found.place if found is not None and found.final else None
        self._approached = thing
        return found

    def _next_move(self) -> None:
        self._moves_done += 1
        self._stop, self._approached, self._looks_beside = None, None, 0
        self._looked_from, self._not_reached = [], []

    def _set_aim(self, place: F64, *, stop: bool = False, beside: bool = False) -> None:
        if not (stop or beside):
            self._turn_to(place)
        self._aim, self._stopping, self._approaching = place, stop, beside
        self._best, self._since = math.inf, self._step

    def _turn_to(self, place: F64) -> None:
        """Count how often the agent has turned to `place`, a target of its exploration. Give the target up when the
        count exceeds `TURNS`.
        """
        key = round(float(place[0])), round(float(place[1]))
        if key != self._towards_key:
            self._towards_key = key
            self._turned_to[key] = self._turned_to.get(key, 0) + 1
            if self._turned_to[key] > TURNS:
                self._given_up.append(place)

    def _come_there(self, look: Callable[[], Look]) -> None:
        """Handle the agent's arrival at its target, or a target that can't be reached."""
        assert self._aim is not None
        aim, self._aim = self._aim, None
        if self._stopping:
            arrived = float(np.hypot(*(aim - self._place[[0, 2]]))) <= ARRIVED
            if not arrived and len(self._not_reached) < TRIES:
                self._not_reached.append(aim)
                return
            self._last = self._place[[0, 2]].copy()
            self._next_move()
            return
        if self._approaching:
            self._looked_from.append(aim)
        else:
            self._given_up.append(aim)
        self._take_in(look())

    # Movement

    def _towards(self, aim: F64) -> int | None:
        """Return the action that leads towards a position; None if the position is reached or unreachable."""
        here = self._place[[0, 2]]
        left = float(np.hypot(*(aim - here)))
        if left <= ARRIVED:
            return None
        ground, ways = self._now()
        self._ways = None  # the next step starts from another position
        path = ways.to(ground.cell(float(aim[0]), float(aim[1])))
        length = float(ways.distance[ground.cell(float(aim[0]), float(aim[1]))])
        if not np.isfinite(length) or len(path) < 2:
            return None
        if length < self._best - 1:
            self._best, self._since = length, self._step
        elif self._step - self._since > PATIENT * 2:
            return None
        towards = path[1]
        for point in path[2:]:
            if np.hypot(*(point - here)) > AHEAD or not ground.open_between(here, point):
                break
            towards = point
        away = towards - here
        if np.hypot(*away) < CELL and len(path) > 2:
            away = path[2] - here
        wanted = math.atan2(-away[0], -away[1])
        off = (wanted - self._heading + math.pi) % (2 * math.pi) - math.pi
        if abs(off) <= HALF_TURN + 1e-9:
            return FORWARD
        return LEFT if off > 0 else RIGHT
