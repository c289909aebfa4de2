"""Sample conditions with given truths about the rooms of one scene.

Room, kind, predicate and definiteness of a condition are drawn independently of its truth, and a condition is used only
if one with the opposite truth would be possible in its place.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from condvln.instructions.conditions import ConditionPool
from condvln.instructions.degeneracy import Claim
from condvln.instructions.kernels.conditions import NOTHING, leave_a_question, rules_of_places
from condvln.instructions.predicates import PREDICATE_GROUPS
from condvln.instructions.referents import Referents, qualifier_of
from condvln.instructions.statement_tables import AskedRoom, Groups, NumberedStatements
from condvln.labels import Vocabulary
from condvln.seeding import Draws
from schemas.config import SamplingConfig
from schemas.program import Condition, Program, RoomRef

__all__ = ["ConditionSampler"]


class ConditionSampler:
    """Samples conditions about the rooms of one scene.

    Parameters
    ----------
    rooms : by room id, its referents and possible statements

    Attributes
    ----------
    rooms : ids of the rooms that have true and false statements
    start_rooms : ids of the rooms where egocentric conditions are possible, if the start is there
    """

    def __init__(
        self,
        rooms: Mapping[str, tuple[Referents, ConditionPool]],
        sampling: SamplingConfig,
        vocabulary: Vocabulary,
        *,
        single_room: bool,
    ) -> None:
        self._sampling, self._vocabulary = sampling, vocabulary
        label_only = sampling.label_only(single_room)
        parts = {
            name: AskedRoom(referents, pool, self._groups(pool), label_only)
            for name, (referents, pool) in sorted(rooms.items())
        }
        self._rooms = {name: part for name, part in parts.items() if part.groups or part.pool.presence}
        self.start_rooms = tuple(name for name, part in self._rooms.items() if part.bearings)
        self.rooms = tuple(self._rooms)
        self._made: dict[tuple[str | None, int], Condition] = {}

    @cached_property
    def numbered(self) -> NumberedStatements:
        """The statements about all rooms, by numbers."""
        return NumberedStatements(self._rooms, self._vocabulary)

    def _groups(self, pool: ConditionPool) -> Groups:
        weights = self._sampling.predicates
        groups = [
            (tuple(form for form in product(predicates, (True, False)) if form in pool.relations), group)
            for group, predicates in PREDICATE_GROUPS.items()
        ]
        there = [(forms, getattr(weights, group)) for forms, group in groups if forms]
        # A group of weight 0 is used only if no other group is possible.
        return tuple(there if any(weight for _, weight in there) else [(forms, 1.0) for forms, _ in there])

    def conditions(
        self, drawn: Iterable[Sequence[int]], truths: Iterable[bool], names: Sequence[RoomRef]
    ) -> tuple[Condition, ...]:
        """Return the conditions that `draw_candidates` drew.

        drawn : of each condition, which of the rooms that can be asked about, its pool and its place
        names : of the rooms of the program
        """
        asked = [name for name in names if name.room_id in self._rooms]
        return tuple(
            self._condition(asked[room], pool, truth, place)
            for truth, (room, pool, place) in zip(truths, drawn, strict=True)
        )

    def is_left_by(self, room_id: str, stop: tuple[str, str]) -> bool:
        """Return whether any condition can be asked about a room in a text with a certain stop: the statements of some
        form or kind are not all about the stop.

        stop : (room id, label) of the stop
        """
        numbered = self.numbered
        given = numbered.presupposed([numbered.room(stop[0]), numbered.label(stop[1])], (), ())
        room, nothing_said = numbered.room(room_id), numbered.claims(())
        return leave_a_question(nothing_said, room, NOTHING, *numbered.pools_of(room), given, numbered.tables)

    def twin(self, program: Program, index: int, draws: Draws) -> Condition | None:
        """Return a condition of the opposite truth that can replace condition `index` of `program`; None if there is
        none.

        The replacement is about the same room, and has the same kind, predicate, definiteness and, if possible, label.
        """
        old = program.conditions[index]
        if old.room.room_id not in self._rooms:
            return None
        part = self._rooms[old.room.room_id]
        claims = [Claim.of(condition) for k, condition in enumerate(program.conditions) if k != index]
        truth = not old.truth
        form = None if old.qualifier is None else (old.qualifier.predicate, old.definite)
        statements = part.pool.presence if form is None else part.pool.relations.get(form)
        if statements is None:
            return None
        numbered = self.numbered
        number = next(k for k, pool in enumerate(numbered.pools) if pool is statements)
        first, room = numbered.first(number, truth), numbered.room(old.room.room_id)
        others, room_anchor = numbered.claims(claims), numbered.label(old.room.anchor_label)
        said, label = numbered.given(move for leaf in program.leaves for move in leaf.moves), numbered.label(old.label)
        rules = rules_of_places(others, room, room_anchor, number, int(truth), said, numbered.tables)
        labels = numbered.tables.labels[first : first + len(rules)]
        sound = rules < 0
        if old.is_bearing:
            # From one start pose an object can't both be in a direction and not.
            sound &= labels != label
        alike = sound & (labels == label)
        places = np.flatnonzero(alike if alike.any() else sound).tolist()
        if not places:
            return None
        # The same weights as for drawn conditions, so that a twin's words predict its truth no better than theirs.
        sums = [float(value) for value in statements.sums[truth]]
        weights = [sums[0], *(after - before for before, after in pairwise(sums))]
        place = draws.weighted(places, [weights[k] for k in places])
        return self._condition(old.room, number, truth, first + place)

    def _condition(self, room: RoomRef, pool: int, truth: bool, place: int) -> Condition:
        """Return the condition that states what is at `place` of a pool (see `NumberedStatements`)."""
        key = (room.anchor_id, place)  # each place belongs to one room
        if key not in self._made:
            question = self.numbered.pools[pool].question(truth, place - self.numbered.first(pool, truth))
            qualifier = None
            if question.predicate is not None:
                arrays = self._rooms[room.room_id].referents.arrays
                qualifier = qualifier_of(arrays, question.predicate, question.anchors)
            self._made[key] = Condition(
                label=question.label,
                room=room,
                qualifier=qualifier,
                definite=question.definite,
                truth=question.truth,
                witnesses=question.witnesses,
            )
        return self._made[key]
