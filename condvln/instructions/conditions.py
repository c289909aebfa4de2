"""Statements about a room that a condition can ask: known true or known false, each with a margin.

Presence: "there is a lamp in the bedroom". Relation: "there is a lamp near the bed", its false twins asking for the
same lamps near something else, or for something else that is there but not near the bed. Presence claims absence when
false, and so does a relation of an indefinite thing ("a lamp near the bed"). A relation of a definite one ("the lamp is
near the bed") claims none: the lamp is seen, and is elsewhere. So a room whose annotation is not complete is asked of
definite things only, with either truth; a truth only ever claimed there would give itself away.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.predicates import ASKED
from condvln.instructions.priors import PriorBits
from condvln.instructions.referents import Referents
from condvln.instructions.statements import StatementTruths, statement_truths
from condvln.labels import Vocabulary
from schemas.config.constants import EVIDENCE
from schemas.program import BEARINGS, Predicate

__all__ = ["ConditionPool", "Question", "RelationPool", "balanced_weights", "informative_weights"]

BALANCING_ROUNDS: Final = 30
"""Rounds of proportional fitting; the marginals of real rooms settle to 1e-3 within about ten."""

LEAST_WEIGHT: Final = 1e-6
"""A cell whose weight has fallen below this share of the largest counts as ruled out by the fitting."""

PSEUDOCOUNT: Final = 0.5
"""Added to both truths of a statement, so that few rooms don't count as certainty (Jeffreys' prior)."""

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Question:
    """A statement about a room by labels and indices: ``exists(label [predicate anchors])``."""

    label: str
    truth: bool
    witnesses: tuple[str, ...]
    predicate: Predicate | None = None
    anchors: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class RelationPool:
    """Statements with one predicate about one room.

    cells[truth] : (row, column) of the statements' tables; sums[truth] : their weights, summed up for drawing;
    mass : geometric mean of the two truths' total weights, how much there is to ask
    """

    truths: StatementTruths
    object_ids: tuple[str, ...]
    cells: Mapping[bool, tuple[tuple[int, int], ...]]
    sums: Mapping[bool, tuple[float, ...]]
    mass: float

    def question(self, truth: bool, cell: int) -> Question:
        """The statement of one cell."""
        row, column = self.cells[truth][cell]
        witnesses = np.flatnonzero(self.truths.exact[row] & self.truths.held[:, column]) if truth else ()
        return Question(
            label=self.truths.labels[row],
            truth=truth,
            witnesses=tuple(self.object_ids[i] for i in witnesses),
            predicate=self.truths.predicate,
            anchors=tuple(self.truths.anchors[column].tolist()),
        )


@dataclass(frozen=True, eq=False)
class PresencePool:
    """Statements of presence about one room, and their weights, summed up for drawing."""

    questions: Mapping[bool, tuple[Question, ...]]
    sums: Mapping[bool, tuple[float, ...]]

    def question(self, truth: bool, place: int) -> Question:
        """One statement."""
        return self.questions[truth][place]


@dataclass(frozen=True, eq=False)
class ConditionPool:
    """All statements about one room; a kind or predicate is in it only if some of it is true and some is false."""

    presence: PresencePool | None
    relations: Mapping[Predicate, RelationPool]

    @classmethod
    def of(
        cls,
        referents: Referents,
        bits: PriorBits,
        elsewhere: Iterable[str],
        vocabulary: Vocabulary,
        asked: Container[str] = ASKED,
    ) -> ConditionPool:
        """The statements about one room.

        Parameters
        ----------
        bits : which labels are plausible in this type of room, and how often its statements are true
        elsewhere : labels that may be claimed absent: those of the scene's other rooms, or of other scenes
        asked : predicates that may be asked for
        """
        if not referents.room.asked:
            return cls(None, {})
        presence = _presence(referents, bits, elsewhere, vocabulary) if referents.room.complete else None
        return cls(presence, {**_relations(referents, bits, vocabulary, asked), **_bearings(referents, asked)})


def _presence(
    referents: Referents, bits: PriorBits, elsewhere: Iterable[str], vocabulary: Vocabulary
) -> PresencePool | None:
    room_type, labels = referents.room.label, referents.arrays.labels
    varies = bits.varies.get(room_type, frozenset())
    plausible = bits.plausible.get(room_type, frozenset())
    members: dict[str, list[str]] = {}
    for name, label, fit in zip(referents.arrays.object_ids, labels, referents.nameable, strict=True):
        if fit and label in varies:
            members.setdefault(label, []).append(name)
    true = [Question(label, True, tuple(members[label])) for label in sorted(members)]
    false = [
        Question(label, False, ())
        for label in sorted(set(elsewhere) & plausible)
        if vocabulary.fit_for_text(label) and referents.lacks(label, vocabulary)
    ]
    questions, sums, evidence = {}, {}, bits.evidence(room_type)
    for truth, found in ((True, true), (False, false)):
        seen = [bits.counts.get((room_type, q.label, "", ""), (0, 0)) for q in found]
        weighed = [(q, informative_weights(*counts, evidence)) for q, counts in zip(found, seen, strict=True)]
        questions[truth] = tuple(q for q, weights in weighed if weights[truth] > 0.0)
        sums[truth] = tuple(accumulate(weights[truth] for _, weights in weighed if weights[truth] > 0.0))
    return PresencePool(questions, sums) if all(questions.values()) else None


def _relations(
    referents: Referents, bits: PriorBits, vocabulary: Vocabulary, asked: Container[str]
) -> dict[Predicate, RelationPool]:
    pools: dict[Predicate, RelationPool] = {}
    for truths in statement_truths(referents, vocabulary):
        if truths.predicate not in asked:
            continue
        weights = _informative_tables(referents, truths, bits)
        if weights is None:
            weights = balanced_weights(truths.true, truths.false)
        if weights is None or not all(table.any() for table in weights.values()):
            continue
        cells = {truth: np.argwhere(table > 0.0) for truth, table in weights.items()}
        pools[truths.predicate] = RelationPool(
            truths=truths,
            object_ids=referents.arrays.object_ids,
            cells={truth: tuple((int(r), int(c)) for r, c in found) for truth, found in cells.items()},
            sums={truth: tuple(np.cumsum(table[table > 0.0]).tolist()) for truth, table in weights.items()},
            mass=float(min(weights[True].sum(), weights[False].sum())),
        )
    return pools


def _bearings(referents: Referents, asked: Container[str]) -> dict[Predicate, RelationPool]:
    """Bearings at the start, of objects that are unique in their label and not small.

    The start is chosen by the truths that are wanted, so that each thing can be asked with either.
    """
    own = referents.arrays.labels
    labels = tuple(sorted({own[i] for i in np.flatnonzero(referents.unique & referents.sized & ~referents.small)}))
    if not labels:
        return {}
    exact = np.array([[x == label for x in own] for label in labels], dtype=bool)
    any_of_them = np.ones((len(labels), 1), dtype=bool)
    cells = tuple((row, 0) for row in range(len(labels)))
    sums = tuple(float(k + 1) for k in range(len(labels)))
    return {
        bearing: RelationPool(
            truths=StatementTruths(
                predicate=bearing,
                labels=labels,
                anchors=np.empty((1, 0), dtype=np.intp),
                exact=exact,
                held=np.ones((len(own), 1), dtype=bool),
                true=any_of_them,
                false=any_of_them,
            ),
            object_ids=referents.arrays.object_ids,
            cells={True: cells, False: cells},
            sums={True: sums, False: sums},
            mass=float(len(labels)),
        )
        for bearing in BEARINGS
        if bearing in asked
    }


def informative_weights(n_true: int, n_false: int, evidence: int = EVIDENCE) -> dict[bool, float]:
    """Weights with which to ask a statement where it is true and where it is false, from how often it is either.

    Asked in its true rooms with the share of false ones and the other way round, a statement comes up as often true
    as false over all rooms, and one that hardly varies hardly comes up. Both are 0 where it never varied in as many
    rooms as are `evidence` enough.
    """
    if n_true + n_false >= evidence and min(n_true, n_false) == 0:
        return {True: 0.0, False: 0.0}
    rate = (n_true + PSEUDOCOUNT) / (n_true + n_false + 2.0 * PSEUDOCOUNT)
    return {True: 1.0 - rate, False: rate}


def _informative_tables(referents: Referents, truths: StatementTruths, bits: PriorBits) -> dict[bool, F64] | None:
    """Weights of all statements by how they divide the rooms of this type; None where too little is known to."""
    room_type, own = referents.room.label, referents.arrays.labels
    tables = {True: np.zeros(truths.true.shape), False: np.zeros(truths.true.shape)}
    known, evidence = False, bits.evidence(room_type)
    for truth, support in ((True, truths.true), (False, truths.false)):
        for row, column in np.argwhere(support):
            key = (room_type, truths.labels[row], truths.predicate, truths.anchor_key(column, own))
            seen = bits.counts.get(key, (0, 0))
            known |= sum(seen) >= evidence
            tables[truth][row, column] = informative_weights(*seen, evidence)[truth]
    return tables if known else None


def balanced_weights(true: Bools, false: Bools) -> dict[bool, F64] | None:
    """Weights over the true and over the false cells of a (labels, anchors) table, with like marginals.

    For rooms of a type too rare for priors. Drawn with these, neither the label nor the anchor tells whether the
    statement is true. Iterative proportional fitting (Deming & Stephan 1940) of both tables towards the geometric mean
    of their marginals; labels and anchors that have only one of the truths drop out. Where nothing is left so, the
    labels alone are balanced; None where not even one label has both truths.
    """
    for axes in ((0, 1), (1,)):
        tables = [true.astype(np.float64), false.astype(np.float64)]
        for _ in range(BALANCING_ROUNDS):
            for axis in axes:
                sums = [t.sum(axis=axis, keepdims=True) for t in tables]
                target = np.sqrt(sums[0] * sums[1])
                tables = [
                    t * np.divide(target, s, out=np.zeros_like(s), where=s > 0)
                    for t, s in zip(tables, sums, strict=True)
                ]
        if all(t.any() for t in tables):
            tables = [np.where(t < LEAST_WEIGHT * t.max(), 0.0, t) for t in tables]
            return {True: tables[0], False: tables[1]}
    return None
