"""Sample conditions with given truths about the rooms of one scene.

Room, kind, predicate and definiteness of a condition are drawn independently of its truth, and a condition is used only
if one with the opposite truth would be possible in its place.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

from condvln.instructions.conditions import ConditionPool, Form, PresencePool, Question, RelationPool
from condvln.instructions.degeneracy import Claim, Presupposed, clash
from condvln.instructions.predicates import PREDICATE_GROUPS
from condvln.instructions.referents import Referents, qualifier_of
from condvln.instructions.rejection import GivenUp
from condvln.labels import Vocabulary
from condvln.seeding import Draws
from schemas.config import SamplingConfig
from schemas.config.constants import PLAIN_ROOM_WEIGHT
from schemas.program import BEARINGS, Condition, ObjectRef, Program, RoomRef

__all__ = ["ConditionSampler"]

Statements = PresencePool | RelationPool
Groups = tuple[tuple[tuple[Form, ...], float], ...]
"""Forms of statements by the group of their predicate, and the group's weight."""


@dataclass(frozen=True, eq=False, slots=True)
class _Asked:
    """A condition, in which the room has one of its possible names, and the claim that the condition makes."""

    condition: Condition
    claim: Claim


@dataclass(frozen=True, eq=False)
class _Room:
    referents: Referents
    pool: ConditionPool
    groups: Groups
    bearings: bool = False

    def here(self, start: bool) -> Groups:
        """Return the groups of forms that conditions may use, with weights; egocentric predicates only if `start`,
        which says that this is the room of the start.
        """
        if start or not self.bearings:
            return self.groups
        rest = [(forms, weight) for forms, weight in self.groups if forms[0][0] not in BEARINGS]
        return tuple(rest if any(weight for _, weight in rest) else [(forms, 1.0) for forms, _ in rest])


class ConditionSampler:
    """Samples conditions about the rooms of one scene.

    Parameters
    ----------
    rooms : by room id, its referents and possible statements

    Attributes
    ----------
    rooms : ids of the rooms that have true and false statements
    start_rooms : ids of the rooms where egocentric conditions are possible, if the start is there
    clashes : number of conditions that were drawn again because of each rule of ``degeneracy``
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
        self._label_only = sampling.label_only(single_room)
        parts = {name: self._room(referents, pool) for name, (referents, pool) in sorted(rooms.items())}
        self._rooms = {name: part for name, part in parts.items() if part.groups or part.pool.presence}
        self.start_rooms = tuple(name for name, part in self._rooms.items() if part.bearings)
        self.rooms = tuple(self._rooms)
        self.clashes: Counter[str] = Counter()
        self._made: dict[tuple[RoomRef, Question], Condition] = {}
        self._asked: dict[tuple[RoomRef, int], dict[tuple[bool, int], _Asked]] = {}

    def _room(self, referents: Referents, pool: ConditionPool) -> _Room:
        return _Room(referents, pool, self._groups(pool), any(form[0] in BEARINGS for form in pool.relations))

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
        self,
        truths: Sequence[bool],
        stops: Iterable[ObjectRef],
        names: Mapping[str, RoomRef],
        draws: Draws,
        start_room: str | None = None,
        bearings: int = 0,
    ) -> tuple[Condition, ...]:
        """Draw conditions with the given `truths`, in that order. Together with the `stops` they violate no rule of
        ``degeneracy``.

        Parameters
        ----------
        names : the rooms that conditions may be about: their names in the text, by room id
        start_room : the room in which egocentric conditions are possible; bearings : their largest number

        Raises
        ------
        GivenUp
            For one condition no statement is left.
        """
        rooms = [room for room in names if room in self._rooms]
        # "If, in the bedroom that has the desk, the lamp …" is hard to follow: rooms with a plain name are preferred.
        weights = [PLAIN_ROOM_WEIGHT if names[room].anchor_label is None else 1.0 for room in rooms]
        given = Presupposed.by(stops)
        asked: list[Condition] = []
        for truth in truths:
            claims = [Claim.of(condition) for condition in asked]
            for _ in range(self._sampling.attempts if rooms else 0):
                room = draws.weighted(rooms, weights)
                free = bearings > sum(condition.is_bearing for condition in asked)
                statements = self._statements(room, draws, room == start_room and free)
                pair = statements and self._pair(names[room], statements, claims, given, draws)
                if pair:
                    asked.append(pair[truth])
                    break
            else:
                raise GivenUp("no_condition")
        return tuple(asked)

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
        given = Presupposed.by(move for leaf in program.leaves for move in leaf.moves)
        truth = not old.truth
        form = None if old.qualifier is None else (old.qualifier.predicate, old.definite)
        statements = part.pool.presence if form is None else part.pool.relations.get(form)
        if statements is None:
            return None
        # The same weights as for drawn conditions, so that a twin's words predict its truth no better than theirs.
        sums = statements.sums[truth]
        weights = [sums[0], *(after - before for before, after in pairwise(sums))]
        made = [self._condition(old.room, statements.question(truth, k)) for k in range(len(sums))]
        sound = [
            (condition, weight)
            for condition, weight in zip(made, weights, strict=True)
            if clash(Claim.of(condition), claims, given, self._vocabulary) is None
        ]
        if old.is_bearing:
            # From one start pose an object can't both be in a direction and not.
            sound = [(condition, weight) for condition, weight in sound if condition.label != old.label]
        alike = [(condition, weight) for condition, weight in sound if condition.label == old.label]
        return draws.weighted(*zip(*(alike or sound), strict=True)) if sound else None

    def _pair(
        self, room: RoomRef, statements: Statements, claims: Sequence[Claim], given: Presupposed, draws: Draws
    ) -> dict[bool, Condition] | None:
        """Return two usable conditions of one form, by truth: a true one and a false one. Return None if there is no
        such pair.
        """
        # Pools live as long as this sampler, so their ids are valid cache keys.
        asked = self._asked.setdefault((room, id(statements)), {})
        found: dict[bool, Condition] = {}
        for truth in (True, False):
            sums = statements.sums[truth]
            for _ in range(self._sampling.attempts):
                place = draws.cumulative(sums)
                one = asked.get((truth, place))
                if one is None:
                    condition = self._condition(room, statements.question(truth, place))
                    one = _Asked(condition, Claim.of(condition))
                    asked[truth, place] = one
                rule = clash(one.claim, claims, given, self._vocabulary)
                if rule is None:
                    found[truth] = one.condition
                    break
                self.clashes[rule] += 1
            else:
                return None
        return found

    def _statements(self, room: str, draws: Draws, start: bool) -> Statements | None:
        """Draw a kind of condition and a form for a room, and return their statements; None if there are none.

        start : the room is the start room; only then are egocentric statements possible
        """
        part = self._rooms[room]
        groups = part.here(start)
        presence = part.pool.presence
        if presence is not None:
            # If a room has few statements whose truth varies, it is rarely used.
            share = self._label_only * min(1.0, *(sums[-1] for sums in presence.sums.values()))
            if draws.uniform() < share or not groups:
                return presence
        if not groups:
            return None
        forms = draws.weighted(groups, [weight for _, weight in groups])[0]
        return part.pool.relations[draws.weighted(forms, [part.pool.relations[form].mass for form in forms])]

    def _condition(self, room: RoomRef, question: Question) -> Condition:
        key = (room, question)
        if key not in self._made:
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
