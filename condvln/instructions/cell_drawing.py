"""Draw the candidates of one cell: the shape of each, then programs of that shape until one is new."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import accumulate
from typing import Final

from condvln.instructions.condition_sampler import AskedStatement, ConditionSampler
from condvln.instructions.degeneracy import GivenUp, outcomes
from condvln.instructions.programs import composition, with_leads
from condvln.instructions.stop_sampler import StopSampler
from condvln.instructions.stops import Said, StopName, StopNames
from condvln.labels import Vocabulary
from condvln.seeding import Draws
from schemas.episode import Composition
from schemas.program import SHAPES, Category, Leaf, Program, RoomRef

__all__ = ["CellDrawing", "Seen", "WantedCell"]

VAIN_TRIES: Final = 100
"""Number of consecutive shapes, each tried many times, after which a cell counts as exhausted."""


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


@dataclass(slots=True)
class Seen:
    """The candidates of a category so far.

    keys : what tells them apart; None if candidates may be equal
    used : how often each label is a goal
    """

    keys: set[tuple[object, ...]] | None = field(default_factory=set)
    used: Counter[str] = field(default_factory=Counter)


@dataclass(slots=True)
class _Found:
    """The last candidate, and how far the drawing was before it."""

    labels: list[str]
    key: tuple[object, ...]
    failed: int
    left: int


class CellDrawing:
    """Draws candidates of one cell, one after the other.

    Parameters
    ----------
    wanted : what is wanted of them
    most : most candidates; shapes : most shapes that are tried
    """

    def __init__(
        self,
        wanted: WantedCell,
        most: int,
        shapes: int,
        draws: Draws,
        seen: Seen,
        stops: StopSampler,
        names: StopNames,
        conditions: ConditionSampler,
        vocabulary: Vocabulary,
    ) -> None:
        self._wanted, self._most, self._shapes, self._draws, self._seen = wanted, most, shapes, draws, seen
        self._stops, self._names, self._conditions, self._vocabulary = stops, names, conditions, vocabulary
        self._leaves = SHAPES[wanted.category].leaves
        self._golds: Sequence[int] = range(self._leaves)
        self._dealt: list[int] = []
        self._move_sums = [*accumulate(wanted.move_shares)]
        self.leads = wanted.leads
        self._gold = self._compass = 0
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

    def refuse(self) -> None:
        """Take the last candidate back: its shape is tried again as long as it has draws left."""
        last = self._last
        assert last is not None, "no candidate was drawn"
        self._failed, self._left, self._last = last.failed, last.left, None
        self._most += 1
        if self._seen.keys is not None:
            self._seen.keys.discard(last.key)
        self._seen.used.subtract(last.labels)

    def _draw_shape(self, rejected: Counter[str]) -> None:
        """Draw the gold leaf, the composition and the moves of the next candidate."""
        draws, wanted = self._draws, self._wanted
        self._shapes -= 1
        self._failed += 1
        # By default, each leaf is gold as often as the others: placing takes no more of one than of another.
        if not self._dealt:
            self._dealt = draws.sample(self._golds, len(self._golds))
        self._gold = self._dealt.pop()
        self._composition = None
        if any(wanted.compositions.values()):
            self._composition = draws.weighted([*wanted.compositions], [*wanted.compositions.values()])
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
        stops, statements, program = self._draw_program(rejected)
        if composition(program) != self._composition:
            raise GivenUp("composition_missed")
        key = (*((one.number, one.room.anchor_id) for one in statements), *map(tuple, stops))
        if self._seen.keys is not None:
            if key in self._seen.keys:
                raise GivenUp("duplicate")
            self._seen.keys.add(key)
        labels = [leaf[-1].ref.label for leaf in stops]
        self._last = _Found(labels, key, self._failed, self._left)
        self._seen.used.update(labels)
        self._failed = self._left = 0
        self._most -= 1
        return program

    def _draw_program(self, rejected: Counter[str]) -> tuple[list[list[StopName]], list[AskedStatement], Program]:
        """Draw rooms and stops, then names for them, then conditions whose truths lead to the gold leaf."""
        wanted, draws = self._wanted, self._draws
        assert self._composition is not None
        stops, targets, luck = self._stops, self._stops.targets, draws.uniform()
        room_ids, held = stops.draw_rooms(self._composition, self.moves, draws)
        if not self._compass:
            held &= stops.plain
        goals = stops.draw_goals(self._leaves, max(self.moves) - 1, held, self._goal_weights, draws)
        things = {(targets[k].room_id, targets[k].label) for k in goals}
        if self._conditions.fails(luck, room_ids, things):
            raise GivenUp("no_condition")
        leaves = stops.draw_leaves(self.moves, goals, held, draws)
        things.update([(targets[k].room_id, targets[k].label) for leaf in leaves for k in leaf])
        if self._conditions.fails(luck, room_ids, things):
            raise GivenUp("no_condition")
        truths = draws.choice(leading_to(wanted.category, self._gold))
        said = Said(things, self._vocabulary)
        rooms = self._names.draw_rooms(room_ids, said, draws)
        starts = [room_id for room_id in sorted(room_ids) if room_id in self._conditions.start_rooms]
        start_room = draws.choice(starts) if starts and wanted.egocentric else None
        named, bearings, compass = self._name_stops(leaves, rooms, start_room, said)
        excluded = self._conditions.excluded_by((name.ref for leaf in named for name in leaf), rooms.values())
        statements = self._conditions.draw(
            truths,
            [*rooms.values()],
            excluded,
            draws,
            luck=luck,
            start_room=start_room,
            bearings=bearings,
            compass=compass,
        )
        if statements is None:
            rejected.update(rule for rule, statements in excluded.by_rule.items() if statements)
            raise GivenUp("no_condition")
        # What is drawn needs no check of its types.
        program = Program.model_construct(
            category=wanted.category,
            conditions=tuple([self._conditions.condition(one) for one in statements]),
            branches=SHAPES[wanted.category].branches,
            leaves=tuple([Leaf.model_construct(moves=tuple([name.ref for name in leaf])) for leaf in named]),
        )
        return named, statements, with_leads(program) if self.leads else program

    def _name_stops(
        self, leaves: Sequence[Sequence[int]], rooms: Mapping[str, RoomRef], start_room: str | None, said: Said
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
                        self._draws,
                        egocentric=here,
                        compass=compass > 0,
                        alone=len(rooms) == 1,
                    )
                    compass -= known[k].compass
                stops[-1].append(known[k])
                bearings -= known[k].egocentric
        return stops, bearings, compass


@cache
def leading_to(category: Category, gold: int) -> tuple[tuple[bool, ...], ...]:
    """Return the truths of conditions that lead to a leaf. Truths that don't matter on the way there are fair coins."""
    return tuple(truths for truths, leaf in outcomes(category).items() if leaf == gold)
