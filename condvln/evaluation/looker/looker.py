"""The looker agent: reads the text, looks around, decides each condition from what it has seen, and walks to the
leaf.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from condvln.arrays import F64
from condvln.evaluation.looker.approach import Approach, approach
from condvln.evaluation.looker.exploring import ARRIVED, Explorer, Here, Steering
from condvln.evaluation.looker.eyes import Look
from condvln.evaluation.looker.floor_map import FloorMap, Ground, Ways
from condvln.evaluation.looker.memory import Compared, Memory, Referents, Thing, gap, ranked
from condvln.instructions import parse
from condvln.instructions.language import LANGUAGES
from condvln.instructions.text_reading import Phrase, Reading
from condvln.navigation.follower import LEFT, STOP
from condvln.seeding import generator
from schemas.config import LookerConfig
from schemas.errors import FormatError
from schemas.program import BEARINGS, SHAPES

__all__ = ["Looker", "read_text"]

HEADINGS: Final = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
LOOK_EVERY: Final = 0.5
"""Metres that it walks between two views."""
LOOKS: Final = 8
"""Largest number of views near an object by which it looks for a place to stop beside the object."""
BESIDE: Final = 4.0
"""Distance in metres at which views count as near an object."""
TRIES: Final = 4
"""Largest number of places to stop at that it can't reach before it stops where it is."""
NEAR: Final = 1.0
"""Distance in metres to its last stop within which it stops with the last step of its budget."""

STOPPING: Final = 20.0
"""Steps that it keeps for each stop."""
SEARCHING: Final = 40.0
"""Steps that it keeps besides to look for a thing that it has not seen yet."""
ASKING: Final = 40.0
"""Steps that it keeps for each further condition that may be asked."""
STEPS_A_METRE: Final = 5.0
"""Steps that a metre takes, turns included, counted along the axes of its map."""

MARGIN: Final = 0.5
"""Length in metres by which it looks farther for a closer object than the closest known one is from the anchor."""


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
        north = None if self.reading.heading is None else 45.0 * HEADINGS.index(self.reading.heading)
        self._referents = Referents(self.memory, north, config.close)
        self._explorer = Explorer(self._referents, config.close)
        self._steering = Steering()
        self._limit = max_steps
        self._flipped = generator(seed, "logic", episode).uniform(size=len(self.reading.conditions)) < config.logic
        self._followed: set[int] = set()  # conditions whose leads it has followed
        self._step = 0
        self._looked: F64 | None = None
        self._place, self._heading = np.zeros(3), 0.0
        self._ground: Ground | None = None
        self._ways: Ways | None = None
        self._aim: F64 | None = None
        self._last: F64 = np.zeros(2)  # the previous stop, at first the start
        self._moves_done = 0
        self._stop: F64 | None = None  # where it wants to stop
        self._approaching = False  # the target is a place from which to see the floor around an object
        self._approached: Thing | None = None
        self._looks_beside = 0
        self._looked_from: list[F64] = []
        self._not_reached: list[F64] = []
        self._stopping = False
        self._blocked_at: list[F64] = []

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
        if self._step == self._limit - 1 and self._almost_there:
            action = STOP
        self._step += 1
        return LEFT if action is None else action

    @property
    def picked(self) -> int:
        """Return the leaf to which the answers so far lead; undecided conditions are answered from what was seen so
        far.
        """
        if self.leaf is not None:
            return self.leaf
        shape = SHAPES[self.reading.category]
        at = 0
        while at >= 0:
            branch = shape.branches[at]
            number = branch.condition
            answer = self.verdicts.get(number)
            if answer is None:
                answer = self._referents.judge(self.reading.conditions[number])[1] != bool(self._flipped[number])
            at = branch.then if answer else branch.otherwise
        return -1 - at

    @property
    def _almost_there(self) -> bool:
        """Whether the agent is on its way to its last stop, and near."""
        if self._aim is None or not self._stopping or self.leaf is None:
            return False
        last = self._moves_done == len(self.reading.leaves[self.leaf]) - 1
        return last and float(np.hypot(*(self._aim - self._place[[0, 2]]))) <= NEAR

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
            self._referents.start_room = look.here
        self._explorer.been.add(look.here)
        if self._approaching and self._approached is not None and self._distance(self._approached) <= BESIDE:
            self._looks_beside += 1
        self._ground = self._aim = None

    def _here(self) -> Here:
        x, z = float(self._place[0]), float(self._place[2])
        if self._ground is None:
            self._ground = self.map.ground(x, z)
            self._ways = None
        if self._ways is None or not self._ways.start_at(x, z):
            self._ways = self._ground.ways_from(x, z)
        return Here(self._place[[0, 2]], self._heading, self._ground, self._ways)

    # Decisions

    def _decide(self) -> None:
        """Choose the next target; at the end of the instruction, choose none."""
        shape = SHAPES[self.reading.category]
        at = 0
        while at >= 0:
            branch = shape.branches[at]
            if not self._has_followed(branch.condition):
                return
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
                nearer = self._explorer.nearer(thing, move, self._here())
                if nearer is None:
                    self._next_move()
                    continue
                self._set_aim(nearer)
                return
            self._set_aim(found.place, stop=found.final, beside=not found.final)
            return
        self._aim = None

    def _has_followed(self, number: int) -> bool:
        """Return whether the agent was in the room of the lead to a condition, or there is none. If it must still go
        there, set a target.
        """
        if self.reading.leads[number] is None or number in self._followed:
            return True
        late = self._step + self._reserve(number) >= self._limit
        target = None if late else self._explorer.inwards(self.reading.conditions[number], self._here())
        if target is not None:
            self._set_aim(target)
            return False
        self._followed.add(number)
        return True

    def _verdict(self, number: int) -> bool | None:
        """Return the answer to a condition. If more must be seen first, set a target and return None."""
        if number in self.verdicts:
            return self.verdicts[number]
        phrase = self.reading.conditions[number]
        answer, guess = self._referents.judge(phrase)
        if answer is None:
            late = self._step + self._reserve(number) >= self._limit
            look = self._explorer.sought if self._referents.lacks(phrase) else self._explorer.unseen
            target = None if late else look(phrase, self._here())
            if target is not None:
                self._set_aim(target)
                return None
            if late:
                self.forced.add(number)
            answer = guess
        if self._flipped[number]:
            answer = not answer
        self.verdicts[number] = answer
        return answer

    def _reserve(self, number: int) -> float:
        """Return the number of steps that it keeps for the walk after the condition `number`: for the longest of the
        leaves that its answers leave open.
        """
        most = (1 - self.config.patience) * self._limit
        shape = SHAPES[self.reading.category]
        waiting, longest = [(0, 0)], 0.0
        while waiting:
            at, asked = waiting.pop()
            if at < 0:
                longest = max(longest, ASKING * asked + self._walk_to(self.reading.leaves[-1 - at]))
                continue
            branch = shape.branches[at]
            answer = self.verdicts.get(branch.condition)
            more = asked + (answer is None and branch.condition != number)
            waiting += [(branch.then, more)] * (answer is not False) + [(branch.otherwise, more)] * (answer is not True)
        return min(most, longest)

    def _walk_to(self, moves: Sequence[Phrase]) -> float:
        """Return about how many steps the stops of a leaf take, from where the agent is."""
        here, steps = self._place[[0, 2]], 0.0
        for move in moves:
            known = [thing.middle[[0, 2]] for thing in self._referents.known(move.label, self._referents.rooms(move))]
            away = [float(np.abs(place - here).sum()) for place in known]
            steps += STOPPING + (STEPS_A_METRE * min(away) if away else SEARCHING)
            if away:
                here = known[int(np.argmin(away))]
        return steps

    def _found(self, move: Phrase) -> tuple[Thing | None, F64 | None]:
        """Return the object of a stop, or else a position from which to look for it."""
        rooms = self._referents.rooms(move)
        things = self._referents.known(move.label, rooms)
        target = None
        if move.qualifier is None:
            if things and self._referents.room_is_sure(move):
                return min(things, key=self._distance), None
            target = self._explorer.sought(move, self._here())
            return (things[0] if things and target is None else self._fallback(move, target)), target
        predicate, labels = move.qualifier
        anchors = () if predicate in (*BEARINGS, "bigger", "smaller") else self._referents.anchors(labels, rooms)
        if predicate in Compared:
            if predicate == "closest to" and things and anchors:
                target = self._closer(move, things, anchors)
            elif len(things) < 2 or anchors is None or not all(self._referents.is_close(thing) for thing in things):
                target = self._explorer.sought(move, self._here())
            if target is None and things:
                return ranked(predicate, things, anchors)[0] if anchors is not None else things[0], None
            return self._fallback(move, target), target
        best = None
        if things and anchors is not None:
            scored = self._referents.scores(move, things, anchors)
            if scored:
                score, best = max(scored, key=lambda pair: pair[0])
                if score > 0 and self._referents.is_close(best) and self._referents.room_is_sure(move):
                    return best, None
        target = self._explorer.sought(move, self._here())
        if target is not None:
            return None, target
        return best or (things[0] if things else self._fallback(move, None)), None

    def _closer(self, move: Phrase, things: Sequence[Thing], anchors: Sequence[Thing]) -> F64 | None:
        """Return a position from which the agent may see an object that is closer to the anchor than all known objects;
        None if the agent has seen all floor that is as near to the anchor as the closest known object.
        """
        least = gap(ranked("closest to", things, anchors)[0], anchors[0])
        flat = np.concatenate([anchor.points[:, [0, 2]] for anchor in anchors])
        low, high = flat.min(axis=0), flat.max(axis=0)
        radius = least + float(np.hypot(*(high - low))) / 2 + MARGIN
        return self._explorer.unseen(move, self._here(), around=((low + high) / 2, radius))

    def _fallback(self, move: Phrase, target: F64 | None) -> Thing | None:
        """Return a known object with the label of `move` in any room, if nothing is left to explore (`target` is None);
        else None.
        """
        if target is not None:
            return None
        things = self._referents.known(move.label, None)
        return things[0] if things else None

    def _distance(self, thing: Thing) -> float:
        return float(np.hypot(*(thing.middle - self._place)[[0, 2]]))

    # Where to go

    def _way_to(self, thing: Thing) -> Approach | None:
        """Return where to go to reach an object; None if nothing near it can be reached."""
        here = self._here()
        looked = self._looked_from if self._looks_beside < LOOKS else None
        found = approach(
            thing, here.ground, here.ways, self._last, kept=self._stop, given_up=self._not_reached, looked=looked
        )
        self._stop = found.place if found is not None and found.final else None
        self._approached = thing
        return found

    def _next_move(self) -> None:
        self._moves_done += 1
        self._stop, self._approached, self._looks_beside = None, None, 0
        self._looked_from, self._not_reached = [], []

    def _set_aim(self, place: F64, *, stop: bool = False, beside: bool = False) -> None:
        if not (stop or beside):
            self._explorer.turn_to(place)
        self._aim, self._stopping, self._approaching = place, stop, beside
        at_object = (self._moves_done, len(self._not_reached), len(self._looked_from))
        self._steering.begin(self._step, at_object if stop or beside else None)

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
            self._explorer.give_up(aim)
        self._take_in(look())

    def _towards(self, aim: F64) -> int | None:
        """Return the action that leads towards a position; None if the position is reached or unreachable."""
        if float(np.hypot(*(aim - self._place[[0, 2]]))) <= ARRIVED:
            return None
        here = self._here()
        return self._steering.action(aim, here.place, here.heading, here.ground, here.ways, self._step)
