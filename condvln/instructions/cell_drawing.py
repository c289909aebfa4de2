"""Draw the candidates of one cell: the shape of each, then programs of that shape until one is new."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Final

from condvln.instructions.condition_sampler import AskedStatement, ConditionSampler
from condvln.instructions.degeneracy import GivenUp, leading_to
from condvln.instructions.programs import composition, oddness, with_leads
from condvln.instructions.stop_sampler import StopSampler
from condvln.instructions.stops import Said, StopName, StopNames
from condvln.labels import Vocabulary
from condvln.labels.lists import belongs_by, goes_with, labels_with_role
from condvln.seeding import Draws
from schemas.episode import Composition
from schemas.program import SHAPES, Category, Leaf, Program, RoomRef

__all__ = ["CellDrawing", "Seen", "WantedCell"]

VAIN_TRIES: Final = 100
"""Number of consecutive shapes, each tried many times, after which a cell counts as exhausted."""

PURPOSE_TRIES: Final = 12
"""Number of draws of stops that go with the statements of a program: a third with places in the room that is asked
about, a third with such places anywhere, and a third with all that goes with what is asked.
"""


@dataclass(frozen=True, slots=True)
class WantedCell:
    """What is wanted of the candidates of a cell.

    compositions : weights of the compositions that are possible
    move_shares : shares of leaves with 1, 2, … moves
    moves : number of moves of all leaves instead
    label_cap : a label is a goal at most so often
    draws : most draws of a candidate of one shape
    bearings : most egocentric statements of a program
    egocentric : whether conditions may be egocentric
    leads : whether programs have leads
    compass : share of the programs that may use compass words, in at most `compass_phrases` phrases
    purpose : share of the programs whose goals go with what is asked
    search : share of the programs that look for one thing in several places, where that is possible
    most_odd : most oddness of a program; None for any
    """

    category: Category
    compositions: Mapping[Composition, float]
    move_shares: Sequence[float]
    moves: int | None
    label_cap: float
    draws: int
    bearings: int
    egocentric: bool
    leads: bool
    compass: float
    compass_phrases: int
    purpose: float
    search: float
    most_odd: int | None


@dataclass(slots=True)
class Seen:
    """The candidates of a category so far.

    keys : what tells them apart as they are drawn first; None if candidates may be equal
    sent_keys : and as they are
    used : how often each label is a goal as it is drawn first; sent : and in the candidates
    """

    keys: set[tuple[object, ...]] | None = field(default_factory=set)
    sent_keys: set[tuple[object, ...]] = field(default_factory=set)
    used: Counter[str] = field(default_factory=Counter)
    sent: Counter[str] = field(default_factory=Counter)


@dataclass(slots=True)
class _Drawn:
    """What was drawn for a program.

    held : the targets that may be stops; named : the names of the stops of each leaf
    left : numbers of egocentric phrases and of compass words that the names leave
    """

    rooms: Mapping[str, RoomRef]
    start_room: str | None
    held: int
    named: list[list[StopName]]
    left: tuple[int, int]
    statements: list[AskedStatement]

    @property
    def key(self) -> tuple[object, ...]:
        """What tells the program apart."""
        return (*((one.number, one.room.anchor_id) for one in self.statements), *map(tuple, self.named))

    @property
    def labels(self) -> list[str]:
        """The labels of the goals."""
        return [leaf[-1].ref.label for leaf in self.named]


@dataclass(slots=True)
class _Found:
    """The last candidate, as it was drawn and as it is, and how far the drawing was before it."""

    drawn: _Drawn
    sent: _Drawn
    failed: int
    left: int


class CellDrawing:
    """Draws candidates of one cell, one after the other.

    Parameters
    ----------
    wanted : what is wanted of them
    most : most candidates; shapes : most shapes that are tried
    goal_draws : decides which goals replace those that were drawn first, so that all else is drawn as without
    """

    def __init__(
        self,
        wanted: WantedCell,
        most: int,
        shapes: int,
        draws: Draws,
        goal_draws: Draws,
        seen: Seen,
        stops: StopSampler,
        names: StopNames,
        conditions: ConditionSampler,
        vocabulary: Vocabulary,
    ) -> None:
        self._wanted, self._most, self._shapes, self._draws, self._seen = wanted, most, shapes, draws, seen
        self._goal_draws = goal_draws
        self._stops, self._names, self._conditions, self._vocabulary = stops, names, conditions, vocabulary
        self._leaves = SHAPES[wanted.category].leaves
        self._golds: Sequence[int] = range(self._leaves)
        self._dealt: list[int] = []
        self._move_sums = [*accumulate(wanted.move_shares)]
        self.leads = wanted.leads
        self._gold = self._compass = 0
        self._search = False
        self._composition: Composition | None = None
        self.moves: tuple[int, ...] = ()
        """Number of moves of each leaf in the shape that was drawn last."""
        self._failed = self._left = 0
        self._last: _Found | None = None
        self._goal_weights = stops.goal_weights(seen.used, wanted.label_cap)

    def draw(self, count: int, rejected: Counter[str]) -> list[Program]:
        """Return the next candidates, at most `count` and fewer if the cell is exhausted. Draws that fail, and
        conditions that violate a rule, are added to `rejected`.
        """
        found: list[Program] = []
        while len(found) < count and self._most:
            if not self._left:
                if not self._shapes or self._failed >= VAIN_TRIES:
                    break
                self._draw_shape(rejected)
                continue
            self._left -= 1
            try:
                found.append(self._new_program(rejected))
            except GivenUp as given_up:
                rejected[given_up.reason] += 1
        return found

    def aim(self, golds: Sequence[int], move_shares: Sequence[float]) -> None:
        """Let the next candidates have the gold leaves `golds`, dealt in a random order, and leaves with 1, 2, …
        moves in the shares `move_shares`.
        """
        self._golds, self._dealt, self._move_sums = golds, [], [*accumulate(move_shares)]

    def begin(self, gold: int) -> None:
        """Let one shape be drawn for a candidate whose gold leaf is `gold`; forget the candidates before it."""
        self._most, self._shapes, self._failed, self._left, self._dealt = 1, 1, 0, 0, [gold]
        self._seen.used.clear()
        self._seen.sent.clear()

    def refuse(self) -> None:
        """Take the last candidate back: its shape is tried again as long as it has draws left."""
        last = self._last
        assert last is not None, "no candidate was drawn"
        self._failed, self._left, self._last = last.failed, last.left, None
        self._most += 1
        if self._seen.keys is not None:
            self._seen.keys.discard(last.drawn.key)
            self._seen.sent_keys.discard(last.sent.key)
        self._seen.used.subtract(last.drawn.labels)
        self._seen.sent.subtract(last.sent.labels)

    def _draw_shape(self, rejected: Counter[str]) -> None:
        """Draw the gold leaf, the composition and the moves of the next candidate."""
        draws, wanted = self._draws, self._wanted
        self._shapes -= 1
        self._failed += 1
        # By default, each leaf is gold as often as the others: placing takes no more of one than of another.
        if not self._dealt:
            self._dealt = draws.sample(self._golds, len(self._golds))
        self._gold = self._dealt.pop()
        # Whether a thing can be looked for depends on no truth, so that each leaf is gold as often.
        self._search = bool(self._conditions.searched) and draws.uniform() < wanted.search
        weights = wanted.compositions
        if self._search:  # goals are where the thing may be
            weights = {name: weight for name, weight in weights.items() if name != "C2"} or weights
        self._composition = draws.weighted([*weights], [*weights.values()]) if any(weights.values()) else None
        self.moves = tuple([wanted.moves or 1 + draws.cumulative(self._move_sums) for _ in range(self._leaves)])
        self._compass = wanted.compass_phrases if draws.uniform() < wanted.compass else 0
        self._goal_weights = self._stops.goal_weights(self._seen.used, wanted.label_cap)
        reason = self._stops.impossible(self._composition, self.moves)
        if reason is None:
            self._left = wanted.draws
        else:
            rejected[reason] += wanted.draws

    def _new_program(self, rejected: Counter[str]) -> Program:
        """Draw one program of the present shape, and keep what distinguishes it.

        Raises
        ------
        GivenUp : the draw can't be completed, or has another composition, or was drawn before
        """
        drawn, seen = self._draw(rejected), self._seen
        program = self._program(drawn)
        if composition(program) != self._composition:
            raise GivenUp("composition_missed")
        if seen.keys is not None and drawn.key in seen.keys:
            raise GivenUp("duplicate")
        # Goals that go with what is asked replace those that were drawn at the end, where nothing depends on them, so
        # that each statement is asked as often as without.
        sent, better = drawn, program
        if self._goal_draws.uniform() < self._wanted.purpose:
            sent, better = self._purposeful(drawn, program)
        if self._wanted.most_odd is not None and oddness(better) > self._wanted.most_odd:
            raise GivenUp("too_odd")
        if seen.keys is not None:
            if sent.key in seen.sent_keys:
                raise GivenUp("duplicate")
            seen.keys.add(drawn.key)
            seen.sent_keys.add(sent.key)
        self._last = _Found(drawn, sent, self._failed, self._left)
        seen.used.update(drawn.labels)
        seen.sent.update(sent.labels)
        self._failed = self._left = 0
        self._most -= 1
        return better

    def _program(self, drawn: _Drawn) -> Program:
        """Return the program of what was drawn, whose types need no check."""
        program = Program.model_construct(
            category=self._wanted.category,
            conditions=tuple([self._conditions.condition(one) for one in drawn.statements]),
            branches=SHAPES[self._wanted.category].branches,
            leaves=tuple([Leaf.model_construct(moves=tuple([name.ref for name in leaf])) for leaf in drawn.named]),
        )
        return with_leads(program) if self.leads else program

    def _draw(self, rejected: Counter[str]) -> _Drawn:
        """Draw rooms and stops, then names for them, then conditions whose truths lead to the gold leaf."""
        wanted, draws = self._wanted, self._draws
        assert self._composition is not None
        stops, luck = self._stops, draws.uniform()
        asked = self._conditions.searched if self._search else None
        room_ids, held = stops.draw_rooms(self._composition, self.moves, draws, asked)
        if not self._compass:
            held &= stops.plain
        goals = stops.draw_goals(self._leaves, max(self.moves) - 1, held, self._goal_weights, draws)
        things = stops.named([goals])
        if not self._search and self._conditions.fails(luck, room_ids, things):
            raise GivenUp("no_condition")
        leaves = stops.draw_leaves(self.moves, goals, held, draws)
        things |= stops.named(leaves)
        if not self._search and self._conditions.fails(luck, room_ids, things):
            raise GivenUp("no_condition")
        truths = draws.choice(leading_to(wanted.category, self._gold))
        said = Said(things, self._vocabulary)
        rooms = self._names.draw_rooms(room_ids, said, draws)
        starts = [room_id for room_id in sorted(room_ids) if room_id in self._conditions.start_rooms]
        start_room = draws.choice(starts) if starts and wanted.egocentric else None
        named, bearings, compass = self._name_stops(leaves, rooms, start_room, said, draws)
        excluded = self._conditions.excluded_by(
            (name.ref for leaf in named for name in leaf), rooms.values(), search=self._search
        )
        named_rooms, places = [*rooms.values()], list[AskedStatement]()
        if self._search:
            places = self._conditions.look_for_one(len(truths), self._gold, named_rooms, excluded, draws)
        others = self._conditions.draw(
            truths[len(places) :],
            named_rooms,
            excluded,
            draws,
            luck=luck,
            start_room=start_room,
            bearings=bearings,
            compass=compass,
        )
        if others is None or (self._search and not places):
            rejected.update(rule for rule, statements in excluded.by_rule.items() if statements)
            raise GivenUp("no_condition")
        return _Drawn(rooms, start_room, held, named, (bearings, compass), [*places, *others])

    def _purposeful(self, drawn: _Drawn, program: Program) -> tuple[_Drawn, Program]:
        """Return the same statements with other stops, if there are any of which more goals go with what decides about
        them. The choice depends on what is said alone, so that it does not tell the truth.
        """
        stops, draws, best, sent_keys = self._stops, self._goal_draws, (drawn, program), self._seen.sent_keys
        least = math.inf if drawn.key in sent_keys else oddness(program)
        weights = stops.goal_weights(self._seen.sent, self._wanted.label_cap)
        wishes = self._wishes(program)
        for attempt in range(PURPOSE_TRIES):
            if not least:
                break
            wished = wishes[len(wishes) * attempt // PURPOSE_TRIES]
            try:
                goals = stops.draw_goals(self._leaves, max(self.moves) - 1, drawn.held, weights, draws, wished)
                leaves = stops.draw_leaves(self.moves, goals, drawn.held, draws)
                said = Said(stops.named(leaves), self._vocabulary)
                self._names.keep_rooms(drawn.rooms, said)
                named, *left = self._name_stops(leaves, drawn.rooms, drawn.start_room, said, draws)
            except GivenUp:
                continue
            if any(now < before for now, before in zip(left, drawn.left, strict=True)):
                continue  # the statements use what was left
            excluded = self._conditions.excluded_by((name.ref for leaf in named for name in leaf), drawn.rooms.values())
            if any(excluded.union >> one.number & 1 for one in drawn.statements):
                continue
            sent = replace(drawn, named=named)
            other = self._program(sent)
            new = sent.key not in sent_keys and composition(other) == self._composition
            if new and oddness(other) < least:
                best, least = (sent, other), oddness(other)
        return best

    def _wishes(self, program: Program) -> tuple[list[int], ...]:
        """Return the targets that are wished as the goal of each leaf: where the condition holds, the anchor of its
        relation; else places for the thing, first in the room that is asked about, then anywhere, and then all that
        goes with what is asked.
        """
        here, anywhere, all_alike = ([0] * self._leaves for _ in range(3))
        for branch in program.branches:
            condition = program.conditions[branch.condition]
            anchors = () if condition.qualifier is None else condition.qualifier.anchors
            labels = goes_with().get(condition.label, frozenset()) - {anchor.label for anchor in anchors}
            alike, in_room = self._stops.of_labels(labels), self._stops.in_room(condition.room.room_id)
            where = labels & belongs_by().get(condition.label, frozenset())
            on = self._stops.of_labels(where & labels_with_role("surface"))
            places = on or self._stops.of_labels(where) or alike
            for end, holds in ((branch.then, True), (branch.otherwise, False)):
                if end < 0:
                    at = self._stops.of_object(anchors[0].object_id) if holds and len(anchors) == 1 else 0
                    here[-1 - end] = at or places & in_room or places
                    anywhere[-1 - end] = at or places
                    all_alike[-1 - end] = at | alike
        return here, anywhere, all_alike

    def _name_stops(
        self,
        leaves: Sequence[Sequence[int]],
        rooms: Mapping[str, RoomRef],
        start_room: str | None,
        said: Said,
        draws: Draws,
    ) -> tuple[list[list[StopName]], int, int]:
        """Return the names of the stops of all leaves, and the numbers of egocentric statements and of compass words
        left for conditions. An object has the same name in all leaves.
        """
        # Each additional egocentric statement leaves fewer starts. At least one is left for a condition.
        bearings, compass = self._wanted.bearings, self._compass
        known, stops = dict[int, StopName](), list[list[StopName]]()
        for leaf in leaves:
            stops.append([])
            for k in leaf:
                if k not in known or (known[k].egocentric and bearings < 2):
                    target = self._stops.targets[k]
                    here = target.room_id == start_room and bearings > 1
                    known[k] = self._names.draw_stop(
                        target,
                        rooms[target.room_id],
                        said,
                        draws,
                        egocentric=here,
                        compass=compass > 0,
                        alone=len(rooms) == 1,
                    )
                    compass -= known[k].compass
                stops[-1].append(known[k])
                bearings -= known[k].egocentric
        return stops, bearings, compass
