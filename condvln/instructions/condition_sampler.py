"""Sample conditions with given truths about the rooms of one scene.

Room, kind, predicate and definiteness of a condition are drawn independently of its truth, and a condition is used only
if one with the opposite truth would be possible in its place.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import combinations, pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.conditions import ConditionPool, Form, Statements
from condvln.instructions.conflicts import Conflicts, RuledOut, members
from condvln.instructions.degeneracy import Claim, searches
from condvln.instructions.expected_draws import FULL_MASS
from condvln.instructions.predicates import COMPASS, PREDICATE_GROUPS
from condvln.instructions.referents import Referents, qualifier_of
from condvln.instructions.stops import Targets
from condvln.kept import kept
from condvln.labels import Vocabulary
from condvln.seeding import Draws
from schemas.config import SamplingConfig
from schemas.config.constants import PLAIN_ROOM_WEIGHT
from schemas.program import BEARINGS, Condition, ObjectRef, Program, RoomRef

__all__ = ["AskedStatement", "ConditionSampler"]

Groups = tuple[tuple[tuple[Form, ...], float], ...]
"""Forms of statements by the group of their predicate, and the group's weight."""


class _Numbered:
    """The statements of one form about one room, with their numbers among all statements of the scene.

    Parameters
    ----------
    first : number of the first statement; those that are false come first, then those that are true
    """

    def __init__(self, statements: Statements, first: int) -> None:
        self.statements, self.egocentric = statements, statements.egocentric
        self.first, self.weights, self.members = {}, {}, {}
        for truth in (False, True):
            sums = [0.0, *map(float, statements.sums[truth])]
            self.first[truth] = first
            self.weights[truth] = [after - before for before, after in pairwise(sums)]
            self.members[truth] = ((1 << len(sums) - 1) - 1) << first
            first += len(sums) - 1

    def left(self, excluded: int) -> int:
        """Return the statements that are not `excluded`; none if those of one truth are."""
        true, false = self.members[True] & ~excluded, self.members[False] & ~excluded
        return true | false if true and false else 0

    def share(self, excluded: int) -> float:
        """Return the chance that one true and one false statement, drawn by their weights, are both not `excluded`."""
        if not self.left(excluded):
            return 0.0
        true, false = (sum(self.among(truth, excluded)[1]) / sum(self.weights[truth]) for truth in (True, False))
        return true * false

    def among(self, truth: bool, excluded: int) -> tuple[list[int], list[float]]:
        """Return the statements with this `truth` that are not `excluded`, and their weights."""
        left, first = [*members(self.members[truth] & ~excluded)], self.first[truth]
        return left, [self.weights[truth][k - first] for k in left]


class _Left(NamedTuple):
    """Forms of statements, the chance that a try draws and finds each, and the chance that all tries fail."""

    forms: list[_Numbered]
    chances: list[float]
    failing: float


class AskedStatement(NamedTuple):
    """A statement by its number, and the name of the room that it is about."""

    number: int
    room: RoomRef


class _Place(NamedTuple):
    """A place where a thing may be: the weight of the statement that it is there, and the place as a target."""

    weight: float
    target: int


class _Sought(NamedTuple):
    """A thing that can be looked for: the statements that it is at a place, by their numbers."""

    false: Mapping[int, _Place]
    true: Mapping[int, _Place]
    apart: NDArray[np.bool_]

    @property
    def numbers(self) -> int:
        """All statements, as a set."""
        return sum(1 << number for number in (*self.false, *self.true))

    @property
    def mass(self) -> float:
        """The weight of the thing."""
        false, true = (sum(place.weight for place in side.values()) for side in (self.false, self.true))
        return false * true

    @property
    def most(self) -> int:
        """At how many places that are apart it can be looked for, whether it is at one of them or at none."""
        return next((n for n in (3, 2) if all(self._choices(n, side) for side in (self.true, {}))), 0)

    def _choices(self, n: int, side: Mapping[int, _Place]) -> bool:
        """Return whether `n` places are apart, one of `side` and the others where the thing is not."""
        firsts = [[place] for place in side.values()] or [[]]
        return any(
            all(self.is_apart(place, chosen[:k]) for k, place in enumerate(chosen))
            for first in firsts
            for rest in combinations(self.false.values(), n - len(first))
            for chosen in [[*first, *rest]]
        )

    def is_apart(self, place: _Place, others: Iterable[_Place]) -> bool:
        """Return whether a place is apart from others."""
        return all(self.apart[place.target, other.target] for other in others)


class _AskedRoom:
    """The statements about one room, and the weights with which they are drawn.

    groups : the groups of forms; one whose statements together have little weight, since their truths hardly vary, is
        used less
    share : how often a condition about the room is one of presence
    """

    def __init__(self, referents: Referents, pool: ConditionPool, groups: Groups, label_only: float) -> None:
        self.referents, self.pool = referents, pool
        self.egocentric = any(form[0] in BEARINGS for form in pool.relations)
        masses = [sum(pool.relations[form].mass for form in forms) for forms, _ in groups]
        self.groups: Groups = tuple(
            (forms, weight * min(1.0, mass / FULL_MASS)) for (forms, weight), mass in zip(groups, masses, strict=True)
        )
        # If a room has few statements whose truth varies, it is rarely asked whether something is there.
        sums = () if pool.presence is None else pool.presence.sums.values()
        presence = label_only * min([1.0, *(side[-1] for side in sums)])
        full, used = (
            sum(weight for forms, weight in some if forms[0][0] not in BEARINGS) for some in (groups, self.groups)
        )
        rest = (1.0 - presence) * (used / full if full else 1.0)
        self.share = presence / (presence + rest) if presence else 0.0

    def here(self, start: bool) -> Groups:
        """Return the groups of forms that conditions may use, with weights; egocentric predicates only if `start`,
        which says that this is the room of the start.
        """
        if start or not self.egocentric:
            return self.groups
        rest = [(forms, weight) for forms, weight in self.groups if forms[0][0] not in BEARINGS]
        return tuple(rest if any(weight for _, weight in rest) else [(forms, 1.0) for forms, _ in rest])


class ConditionSampler:
    """Samples conditions about the rooms of one scene.

    Parameters
    ----------
    rooms : by room id, its referents and possible statements
    targets : where one can be sent
    plain : ids of the rooms that are named by their label alone

    Attributes
    ----------
    rooms : ids of the rooms that have true and false statements
    start_rooms : ids of the rooms where egocentric conditions are possible, if the start is there
    conflicts : what excludes each statement
    compass : the statements with compass words
    searched : ids of the rooms with a thing that can be looked for in several places
    """

    def __init__(
        self,
        rooms: Mapping[str, tuple[Referents, ConditionPool]],
        sampling: SamplingConfig,
        vocabulary: Vocabulary,
        targets: Targets,
        plain: Collection[str] = (),
        *,
        single_room: bool,
    ) -> None:
        self._sampling, self._plain = sampling, plain
        label_only = sampling.label_only(single_room)
        parts = {
            name: _AskedRoom(referents, pool, self._groups(pool), label_only)
            for name, (referents, pool) in sorted(rooms.items())
        }
        self._rooms = {name: part for name, part in parts.items() if part.groups or part.pool.presence}
        self.start_rooms = tuple(name for name, part in self._rooms.items() if part.egocentric)
        self.rooms = tuple(self._rooms)
        self._known: dict[tuple[tuple[str, ...], str | None, int], _Left] = {}
        claims: list[Claim] = []
        self._origin: list[tuple[Statements, bool, int]] = []
        self._forms: dict[str, dict[Form | None, _Numbered]] = {}
        for name, part in self._rooms.items():
            labels, pool = part.referents.arrays.labels, part.pool
            pools: list[tuple[Form | None, Statements | None]] = [(None, pool.presence), *pool.relations.items()]
            self._forms[name] = {
                form: self._number(own, name, labels, claims) for form, own in pools if own is not None
            }
        self.conflicts = Conflicts(claims, vocabulary)
        self.compass = 0
        for forms in self._forms.values():
            for form, own in forms.items():
                if form is not None and form[0] in COMPASS:
                    self.compass |= own.members[False] | own.members[True]
        self._things = {name: [*self._sought(name, targets)] for name in self._rooms}
        self.searched = tuple(name for name, things in self._things.items() if things)
        self._chances = {
            (name, start): self._chances_of(name, start) for name in self._rooms for start in (False, True)
        }

    def _groups(self, pool: ConditionPool) -> Groups:
        weights = self._sampling.predicates
        groups = [
            (tuple(form for form in product(predicates, (True, False)) if form in pool.relations), group)
            for group, predicates in PREDICATE_GROUPS.items()
        ]
        return tuple([(forms, weight) for forms, group in groups if forms and (weight := getattr(weights, group))])

    def _number(self, pool: Statements, room_id: str, labels: Sequence[str], claims: list[Claim]) -> _Numbered:
        """Give numbers to the statements of a pool, and add what they claim to `claims`."""
        found = _Numbered(pool, len(claims))
        for truth in (False, True):
            own = pool.claims(room_id, labels, truth)
            claims += own
            self._origin += [(pool, truth, k) for k in range(len(own))]
        return found

    def _chances_of(self, room_id: str, start: bool) -> list[tuple[_Numbered, float]]:
        """Return the forms of statements about a room, and how often each is drawn."""
        part, forms = self._rooms[room_id], self._forms[room_id]
        here = part.here(start)
        share = 0.0 if None not in forms else part.share if here else 1.0
        found = [(forms[None], share)] if share else []
        total = sum(weight for _, weight in here)
        for own, weight in here:
            masses = [part.pool.relations[form].mass for form in own]
            found += [
                (forms[form], (1.0 - share) * weight / total * mass / sum(masses))
                for form, mass in zip(own, masses, strict=True)
            ]
        return found

    def left_to_ask(self, room_ids: Iterable[str], excluded: int) -> int:
        """Return the statements about some rooms that are not `excluded`, of forms with statements left of either
        truth.
        """
        found = 0
        for room_id in room_ids:
            for form in self._forms.get(room_id, {}).values():
                found |= form.left(excluded)
        return found

    def is_left_by(self, room_id: str, stop: tuple[str, str]) -> bool:
        """Return whether any condition can be asked about a room in a text with a certain stop: the statements of some
        form or kind are not all about the stop.

        stop : (room id, label) of the stop
        """
        return self.left_to_ask([room_id], self.excluded_by_stop(*stop)) > 0

    @kept
    def excluded_by_stop(self, room_id: str, label: str) -> int:
        """Return the statements that can't be asked in a text with a stop, whatever else is said of it."""
        excluded = self.conflicts.self_contradictory
        for statements in self.conflicts.by_stop((room_id, None, label, ())).values():
            excluded |= statements
        return excluded

    def draw(
        self,
        truths: Sequence[bool],
        rooms: Sequence[RoomRef],
        excluded: RuledOut,
        draws: Draws,
        *,
        luck: float,
        start_room: str | None,
        bearings: int,
        compass: int,
    ) -> list[AskedStatement] | None:
        """Return one statement for each of `truths`, such that one of the other truth could be in its place; None if
        none is found for some truth.

        A statement is found by tries, at most ``sampling.attempts``: each draws a room, a form of statements about it,
        and a true and a false statement of this form, and it fails if either is excluded. (If only what is left were
        drawn, statements with little weight would be asked where the others are used up.) The chance of each outcome is
        computed, so that all tries take one draw.

        Parameters
        ----------
        rooms : the rooms of the text
        excluded : what the stops of the text exclude; what the drawn statements exclude is added
        luck : a uniform that decides whether the first statement is found; see `fails`
        bearings : most egocentric statements; they are about `start_room`
        compass : most statements with compass words
        """
        asked = {room.room_id: room for room in rooms}
        found: list[AskedStatement] = []
        for truth in truths:
            gone = excluded.union | (0 if compass > 0 else self.compass)
            left = self._left(asked, start_room if bearings > 0 else None, gone)
            if (draws.uniform() if found else luck) < left.failing:
                return None
            form = draws.weighted(left.forms, left.chances)
            number = draws.weighted(*form.among(truth, gone))
            claim = self.conflicts.statements[number]
            excluded.add(claim)
            found.append(AskedStatement(number, asked[claim.room_id]))
            bearings -= form.egocentric
            compass -= self.compass >> number & 1
        return found

    def _sought(self, room_id: str, targets: Targets) -> Iterator[_Sought]:
        """Yield the things that can be looked for in a room, at places where one can be sent."""
        place_of = {target.object_id: target.position for target in targets.targets}
        things: dict[str, tuple[dict[int, _Place], dict[int, _Place]]] = {}
        for form in self._forms[room_id].values():
            for truth in (False, True):
                for number, weight in zip(*form.among(truth, 0), strict=True):
                    claim, (pool, _, k) = self.conflicts.statements[number], self._origin[number]
                    if claim.placed:
                        (anchor,) = pool.question(truth, k).anchors
                        place = place_of.get(self._rooms[room_id].referents.arrays.object_ids[anchor])
                        if place is not None:
                            things.setdefault(claim.label, ({}, {}))[truth][number] = _Place(weight, place)
        for sides in things.values():
            thing = _Sought(*sides, targets.apart)
            if thing.most > 1:
                yield thing

    def look_for_one(
        self, most: int, gold: int, rooms: Sequence[RoomRef], excluded: RuledOut, draws: Draws
    ) -> list[AskedStatement]:
        """Return statements about one thing of `rooms` at different places, two at least and `most` at most, of which
        the one with number `gold` alone is true; none of them, if there is no such number. Empty if the draw fails.

        excluded : what the text excludes; what the statements exclude is added
        """
        asked, gone = {room.room_id: room for room in rooms}, excluded.union
        things = [thing for room_id in asked for thing in self._things.get(room_id, ()) if not thing.numbers & gone]
        if not things:
            return []
        thing = draws.weighted(things, [thing.mass for thing in things])
        found, chosen = list[AskedStatement](), list[_Place]()
        for k in range(min(most, thing.most)):
            left = {
                number: place
                for number, place in (thing.true if k == gold else thing.false).items()
                if not excluded.union >> number & 1 and thing.is_apart(place, chosen)
            }
            if not left:
                return []
            number = draws.weighted([*left], [place.weight for place in left.values()])
            claim = self.conflicts.statements[number]
            excluded.add(claim)
            chosen.append(left[number])
            found.append(AskedStatement(number, asked[claim.room_id]))
        return found

    def fails(self, luck: float, room_ids: Sequence[str], stops: Iterable[tuple[str, str]]) -> bool:
        """Return True if no first statement will be found, however the rooms and stops of a text are named: their names
        only exclude further statements. `stops` are (room id, label) of each.

        Most draws in rooms with few things to ask about end here, before anything is named.
        """
        if self.start_rooms:
            return False  # how many egocentric statements are left depends on the names
        excluded = 0
        for stop in stops:
            excluded |= self.excluded_by_stop(*stop)
        return luck < self._left(room_ids, None, excluded).failing

    def _left(self, room_ids: Iterable[str], start_room: str | None, excluded: int) -> _Left:
        """Return the forms of statements about some rooms that have both truths among those that are not `excluded`,
        and how likely they are found. Answers are kept, since draws ask again and again.
        """
        asked = tuple([room_id for room_id in room_ids if room_id in self._rooms])
        relevant = 0
        for room_id in asked:
            relevant |= self.conflicts.in_room(room_id)
        key = (asked, start_room, excluded & relevant)
        if key not in self._known:
            # "If, in the bedroom that has the desk, the lamp …" is hard to follow: plain names are preferred.
            preferences = [PLAIN_ROOM_WEIGHT if room_id in self._plain else 1.0 for room_id in asked]
            forms, chances = list[_Numbered](), list[float]()
            for room_id, preference in zip(asked, preferences, strict=True):
                for form, chance in self._chances[room_id, room_id == start_room]:
                    share = form.share(excluded)
                    if share:
                        forms.append(form)
                        chances.append(preference / sum(preferences) * chance * share)
            self._known[key] = _Left(forms, chances, (1.0 - min(1.0, sum(chances))) ** self._sampling.attempts)
        return self._known[key]

    def excluded_by(self, stops: Iterable[ObjectRef], rooms: Iterable[RoomRef], *, search: bool = False) -> RuledOut:
        """Return what the phrases of stops exclude, in a text that names some rooms. `search`: its conditions may look
        for one thing in several places.
        """
        phrases = [(stop.room.room_id, stop.room.anchor_label, stop.label, _anchors(stop)) for stop in stops]
        return RuledOut(self.conflicts, phrases, {room.room_id: room.anchor_label for room in rooms}, search=search)

    def twin(self, program: Program, index: int, draws: Draws) -> Condition | None:
        """Return a condition of the opposite truth that can replace condition `index` of `program`; None if there is
        none.

        The replacement is about the same room, and has the same kind, predicate, definiteness and, if possible, label.
        """
        old = program.conditions[index]
        key = None if old.qualifier is None else (old.qualifier.predicate, old.definite)
        form = self._forms.get(old.room.room_id, {}).get(key)
        if form is None:
            return None
        others = [condition for k, condition in enumerate(program.conditions) if k != index]
        excluded = self.excluded_by(
            (move for leaf in program.leaves for move in leaf.moves),
            [named.room for named in program.named],
            search=searches(program.category),
        )
        for other in others:
            excluded.add(Claim.of(other))
        left, weights = form.among(not old.truth, excluded.union)
        labels = [self.conflicts.statements[k].label for k in left]
        # From one start pose an object can't both be in a direction and not. Otherwise the same label is preferred.
        alike = not old.is_bearing and old.label in labels
        places = [k for k, label in enumerate(labels) if (label == old.label) == alike]
        if not places:
            return None
        # The same weights as for drawn conditions, so that a twin's words predict its truth no better than theirs.
        number = draws.weighted([left[k] for k in places], [weights[k] for k in places])
        return self.condition(AskedStatement(number, old.room))

    @kept
    def condition(self, asked: AskedStatement) -> Condition:
        """Return the condition that asks a statement."""
        pool, truth, k = self._origin[asked.number]
        question = pool.question(truth, k)
        qualifier = None
        if question.predicate is not None:
            arrays = self._rooms[asked.room.room_id].referents.arrays
            qualifier = qualifier_of(arrays, question.predicate, question.anchors)
        return Condition(
            label=question.label,
            room=asked.room,
            qualifier=qualifier,
            definite=question.definite,
            truth=question.truth,
            witnesses=question.witnesses,
        )


def _anchors(stop: ObjectRef) -> tuple[str, ...]:
    return () if stop.qualifier is None else stop.qualifier.anchor_labels
