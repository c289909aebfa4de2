"""The statements about the rooms of one scene as arrays of numbers, from which compiled kernels draw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.conditions import ConditionPool, Form, PresencePool, RelationPool
from condvln.instructions.degeneracy import Claim
from condvln.instructions.expected_draws import FULL_MASS
from condvln.instructions.kernels.conditions import NOTHING, Given, StatementTables
from condvln.instructions.referents import Referents
from condvln.labels import Vocabulary
from schemas.program import BEARINGS, ObjectRef

__all__ = ["AskedRoom", "Groups", "NumberedStatements", "Statements"]

I64 = NDArray[np.int64]
Statements = PresencePool | RelationPool
Groups = tuple[tuple[tuple[Form, ...], float], ...]
"""Forms of statements by the group of their predicate, and the group's weight."""


class AskedRoom:
    """The statements about one room, and the weights with which they are drawn.

    bearings : some statements are egocentric
    groups : the groups of forms; one whose statements together have little weight, since their truths hardly vary, is
        used less
    share : how often a condition about the room is one of presence
    """

    def __init__(self, referents: Referents, pool: ConditionPool, groups: Groups, label_only: float) -> None:
        self.referents, self.pool = referents, pool
        self.bearings = any(form[0] in BEARINGS for form in pool.relations)
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
        if start or not self.bearings:
            return self.groups
        rest = [(forms, weight) for forms, weight in self.groups if forms[0][0] not in BEARINGS]
        return tuple(rest if any(weight for _, weight in rest) else [(forms, 1.0) for forms, _ in rest])


class NumberedStatements:
    """All statements of a scene by numbers of rooms, pools and places, as the kernels take them. Labels have numbers
    too.

    Attributes
    ----------
    tables : the statements
    pools : by number
    """

    def __init__(self, rooms: Mapping[str, AskedRoom], vocabulary: Vocabulary) -> None:
        self._vocabulary = vocabulary
        self._rooms: dict[str, int] = {name: k for k, name in enumerate(rooms)}
        self._labels: dict[str, int] = {}
        self.pools: list[Statements] = []
        self._pools_of: list[tuple[int, int]] = []
        self._said: dict[int, tuple[ObjectRef, list[int], list[int], list[int]]] = {}
        self._spans: list[tuple[tuple[int, int], tuple[int, int]]] = []
        places: list[tuple[NDArray[np.float64], I64, I64]] = []
        count = 0
        numbers: dict[int, int] = {}
        for room in rooms.values():
            own = self._numbers(room.referents.arrays.labels)
            begin = len(self.pools)
            own_pools: list[Statements] = [] if room.pool.presence is None else [room.pool.presence]
            for pool in (*own_pools, *room.pool.relations.values()):
                numbers[id(pool)] = len(self.pools)
                self.pools.append(pool)
                ends = [count]
                for truth in (False, True):
                    places.append(self._places(pool, truth, own))
                    count += len(places[-1][0])
                    ends.append(count)
                self._spans.append(((ends[0], ends[1]), (ends[1], ends[2])))
            self._pools_of.append((begin, len(self.pools)))
        sums, labels, anchors = zip(*places, strict=True) if places else ((), (), ())
        self.tables = StatementTables(
            overlap=self._overlap(),
            sums=np.concatenate([np.empty(0), *sums]),
            labels=np.concatenate([np.empty(0, np.int64), *labels]),
            anchors=np.concatenate([np.empty((0, 2), np.int64), *anchors]),
            spans=np.array(self._spans, np.int64).reshape(-1, 2, 2),
            presence=np.array([isinstance(pool, PresencePool) for pool in self.pools], bool),
            bearing=np.array([_is_egocentric(pool) for pool in self.pools], bool),
            pool_of_presence=np.array([numbers.get(id(r.pool.presence), NOTHING) for r in rooms.values()], np.int64),
            share=np.array([room.share for room in rooms.values()], np.float64),
            **_grouped(list(rooms.values()), numbers)._asdict(),
        )

    def first(self, pool: int, truth: bool) -> int:
        """Return the place of the first statement of a pool with this `truth`."""
        return self._spans[pool][truth][0]

    def room(self, room_id: str) -> int:
        """Return the number of a room; rooms without statements have numbers too."""
        return self._rooms.setdefault(room_id, len(self._rooms))

    def pools_of(self, room: int) -> tuple[int, int]:
        """Return the first pool of a room with statements, and the end of its pools."""
        return self._pools_of[room]

    def label(self, label: str | None) -> int:
        """Return the number of a label; NOTHING for None."""
        if label is None:
            return NOTHING
        if label not in self._labels:
            self.add_labels([label])
        return self._labels[label]

    def add_labels(self, labels: Iterable[str]) -> None:
        """Give numbers to labels that have none."""
        known = len(self._labels)
        self._numbers(labels)
        if len(self._labels) > known:
            self.tables = self.tables._replace(overlap=self._overlap())

    def given(self, stops: Iterable[ObjectRef]) -> Given:
        """Return what the phrases of all `stops` together presuppose (see ``degeneracy.Presupposed``)."""
        named: list[int] = []
        besides: list[int] = []
        pairs: list[int] = []
        for stop in stops:
            _, own, near, related = self._said.get(id(stop)) or self._phrase(stop)
            named += own
            besides += near
            pairs += related
        return self.presupposed(named, besides, pairs)

    def _phrase(self, stop: ObjectRef) -> tuple[ObjectRef, list[int], list[int], list[int]]:
        """Return the numbers of what the phrase of a stop presupposes: room and label of the stop; of other things;
        room and both labels of each relation. The stop itself comes first, and is kept, so that no other stop gets its
        identity.
        """
        room, label = self.room(stop.room.room_id), self.label(stop.label)
        besides, pairs = [], []
        if stop.room.anchor_label is not None:
            besides += [room, self.label(stop.room.anchor_label)]
        for anchor in () if stop.qualifier is None else stop.qualifier.anchors:
            number = self.label(anchor.label)
            besides += [room, number]
            pairs += [room, label, number]
        found = self._said[id(stop)] = (stop, [room, label], besides, pairs)
        return found

    @staticmethod
    def presupposed(stops: Sequence[int], besides: Sequence[int], pairs: Sequence[int]) -> Given:
        """Return what is presupposed, from numbers in one row: room and label of the stops, and of other things; room
        and both labels of relations.
        """
        numbers = np.array([*stops, *besides, *pairs], np.int64)
        one, other = len(stops), len(stops) + len(besides)
        return Given(numbers[:one].reshape(-1, 2), numbers[:other].reshape(-1, 2), numbers[other:].reshape(-1, 3))

    def claims(self, claims: Sequence[Claim]) -> I64:
        """Return claims as the kernels take them, (n, 6)."""
        found = []
        for claim in claims:
            one, other, *_ = (*map(self.label, claim.anchors), NOTHING, NOTHING)
            own = (self.room(claim.room_id), self.label(claim.room_anchor), self.label(claim.label))
            found.append((*own, one, other, int(claim.presence)))
        return np.array(found, np.int64).reshape(-1, 6)

    def _places(self, pool: Statements, truth: bool, own: I64) -> tuple[NDArray[np.float64], I64, I64]:
        """Return running weights, labels and anchors of a pool's statements. `own` has the labels of the room's
        objects.
        """
        sums = np.asarray(pool.sums[truth], np.float64)
        anchors = np.full((len(sums), 2), NOTHING)
        if isinstance(pool, PresencePool):
            return sums, self._numbers([question.label for question in pool.questions[truth]]), anchors
        cells, truths = pool.cells[truth], pool.truths
        anchors[:, : truths.anchors.shape[1]] = own[truths.anchors][cells[:, 1]]
        return sums, self._numbers(truths.labels)[cells[:, 0]], anchors

    def _numbers(self, labels: Iterable[str]) -> I64:
        known = self._labels
        return np.array([known.setdefault(label, len(known)) for label in labels], np.int64)

    def _overlap(self) -> NDArray[np.bool_]:
        """Return a mask (l, l) of the labels that one word might name."""
        overlap = np.zeros((len(self._labels), len(self._labels)), dtype=bool)
        for label, k in self._labels.items():
            overlap[k, [self._labels[word] for word in self._vocabulary.overlapping(label) if word in self._labels]] = (
                True
            )
        return overlap


def _is_egocentric(pool: Statements) -> bool:
    return isinstance(pool, RelationPool) and pool.truths.predicate in BEARINGS


class _Forms(NamedTuple):
    """The fields of `StatementTables` that say how a form is drawn."""

    groups: I64
    group_sums: NDArray[np.float64]
    forms: I64
    form_sums: NDArray[np.float64]
    pool_of_form: I64


def _grouped(rooms: Sequence[AskedRoom], numbers: Mapping[int, int]) -> _Forms:
    """Return the groups of forms of all rooms. `numbers` has the number of each pool, by its identity."""
    groups: list[tuple[int, int]] = []
    group_sums: list[float] = []
    forms: list[tuple[int, int]] = []
    masses: list[float] = []
    pools: list[int] = []
    for room in rooms:
        for start in (False, True):
            here = room.here(start)
            groups.append((len(group_sums), len(group_sums) + len(here)))
            group_sums += accumulate(weight for _, weight in here)
            for own, _ in here:
                members = [room.pool.relations[form] for form in own]
                forms.append((len(masses), len(masses) + len(members)))
                masses += accumulate(pool.mass for pool in members)
                pools += [numbers[id(pool)] for pool in members]
    return _Forms(
        groups=np.array(groups, np.int64).reshape(-1, 2, 2),
        group_sums=np.array(group_sums, np.float64),
        forms=np.array(forms, np.int64).reshape(-1, 2),
        form_sums=np.array(masses, np.float64),
        pool_of_form=np.array(pools, np.int64),
    )
