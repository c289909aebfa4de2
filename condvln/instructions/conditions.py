"""The statements about a room that a condition can use: known to be true or false, with a margin.

Presence: "there is a lamp in the bedroom". Relation: "there is a lamp near the bed"; its false twins are about the same
label near another anchor, or about another label that is in the room but not near the bed. A false presence claims
absence, and so does a false relation of an indefinite object ("a lamp near the bed"). A definite relation ("the lamp is
near the bed") claims no absence: the lamp is visible, only elsewhere. So conditions about incompletely annotated rooms
are always definite, with either truth; otherwise their form would reveal the truth.

Where a label names several objects, one of them is in a relation more often than a single object is. So definite and
indefinite statements are kept apart: a true statement and the false one that might be used in its place have the same
form.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.balance import (
    UNCHANGED,
    balanced_weights,
    informative_weights,
    jointly_balanced_weights,
    statement_weights,
)
from condvln.instructions.degeneracy import PLACES, Claim
from condvln.instructions.predicates import ASKED, COMPASS
from condvln.instructions.priors import PriorBits
from condvln.instructions.referents import Referents
from condvln.instructions.statements import StatementTruths, statement_truths
from condvln.labels import Vocabulary
from condvln.labels.lists import LEAST_WORTH, worth
from schemas.program import BEARINGS, Predicate

__all__ = ["ConditionPool", "Form", "PresencePool", "Question", "RelationPool", "Statements"]

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

Form: TypeAlias = tuple[Predicate, bool]
"""The form of a relational statement: its predicate, and whether it is about one definite object."""


@dataclass(frozen=True, slots=True)
class Question:
    """A statement about a room by labels and indices: ``exists(label [predicate anchors])``."""

    label: str
    truth: bool
    witnesses: tuple[str, ...]
    predicate: Predicate | None = None
    anchors: tuple[int, ...] = ()
    definite: bool = False


@dataclass(frozen=True, eq=False)
class RelationPool:
    """The statements of one form about one room: with one predicate, and all definite or all indefinite.

    cells[truth] (c, 2) : row and column of each statement in the tables; sums[truth] (c,) : cumulative weights
    mass : geometric mean of the total weights of true and of false statements
    """

    truths: StatementTruths
    definite: bool
    object_ids: tuple[str, ...]
    cells: Mapping[bool, NDArray[np.intp]]
    sums: Mapping[bool, F64]
    mass: float

    @property
    def egocentric(self) -> bool:
        """Whether the start pose decides the statements' truth."""
        return self.truths.predicate in BEARINGS

    def claims(self, room_id: str, labels: Sequence[str], truth: bool) -> list[Claim]:
        """Return what the statements with this `truth` claim. `labels` are those of the room's objects."""
        names = [tuple([labels[i] for i in row]) for row in self.truths.anchors.tolist()]
        placed = self.truths.predicate in PLACES
        return [
            Claim(room_id, None, self.truths.labels[row], names[column], presence=False, placed=placed)
            for row, column in self.cells[truth].tolist()
        ]

    def question(self, truth: bool, cell: int) -> Question:
        """Return the statement with index `cell` among the statements with this `truth`."""
        row, column = self.cells[truth][cell].tolist()
        witnesses = np.flatnonzero(self.truths.exact[row] & self.truths.held[:, column]) if truth else ()
        return Question(
            label=self.truths.labels[row],
            truth=truth,
            witnesses=tuple(self.object_ids[i] for i in witnesses),
            predicate=self.truths.predicate,
            anchors=tuple(self.truths.anchors[column].tolist()),
            definite=self.definite,
        )


@dataclass(frozen=True, eq=False)
class PresencePool:
    """The statements of presence about one room, and their cumulative weights, each by truth."""

    questions: Mapping[bool, tuple[Question, ...]]
    sums: Mapping[bool, tuple[float, ...]]
    egocentric: ClassVar[bool] = False

    def claims(self, room_id: str, labels: Sequence[str], truth: bool) -> list[Claim]:
        """Return what the statements with this `truth` claim."""
        return [Claim(room_id, None, question.label) for question in self.questions[truth]]

    def question(self, truth: bool, place: int) -> Question:
        """Return the statement with index `place` among the statements with this `truth`."""
        return self.questions[truth][place]


Statements: TypeAlias = PresencePool | RelationPool
"""The statements of one kind and form about one room. A kind of condition is such a class: it says what its statements
claim, their running weights, whether they are egocentric, and which `Question` each of them asks.
"""


@dataclass(frozen=True, eq=False)
class ConditionPool:
    """All statements about one room: those of presence, and relational ones by form. A kind or form is included only if
    it has both true and false statements.
    """

    presence: PresencePool | None
    relations: Mapping[Form, RelationPool]

    @classmethod
    def of(
        cls,
        referents: Referents,
        bits: PriorBits,
        elsewhere: Iterable[str],
        vocabulary: Vocabulary,
        asked: Container[str] = ASKED,
        *,
        alone: bool = False,
        usual_places: bool = False,
    ) -> ConditionPool:
        """Return the statements about one room.

        Parameters
        ----------
        bits : which labels are plausible in this type of room, and how often its statements are true
        elsewhere : labels that may be claimed absent, because other rooms of the scene or other scenes have them
        asked : predicates that conditions may use
        alone : weigh the statements for programs of one condition
        usual_places : see ``statement_truths``
        """
        if not referents.room.asked:
            return cls(None, {})
        tables = statement_truths(referents, vocabulary, usual_places=usual_places)
        relations = _relations(referents, bits, tables, asked, alone=alone) | _bearings(referents, asked)
        complete = referents.complete
        return cls(_presence(referents, bits, {*elsewhere}, vocabulary, alone=alone) if complete else None, relations)


def _presence(
    referents: Referents, bits: PriorBits, elsewhere: set[str], vocabulary: Vocabulary, *, alone: bool
) -> PresencePool | None:
    room_type, labels = referents.room.label, referents.arrays.labels
    varies = bits.varies.get(room_type, frozenset())
    plausible = bits.plausible.get(room_type, frozenset())
    members: dict[str, list[str]] = {}
    for name, label, fit in zip(referents.arrays.object_ids, labels, referents.nameable, strict=True):
        if fit and label in varies and label not in referents.fixtures:
            members.setdefault(label, []).append(name)
    true = [Question(label, True, tuple(members[label])) for label in sorted(members)]
    false = [
        Question(label, False, ())
        for label in sorted(elsewhere & plausible)
        if vocabulary.fit_for_text(label) and referents.lacks(label, vocabulary)
    ]
    questions, sums, evidence = {}, {}, bits.evidence(room_type)
    for truth, found in ((True, true), (False, false)):
        said = [(room_type, question.label, "", "", False) for question in found]
        even = [bits.even.get(statement, UNCHANGED) for statement in said]
        factors = [own.one if alone else own.several for own in even]
        weights = [informative_weights(*bits.counts.get(statement, (0, 0)), evidence)[truth] for statement in said]
        weighed = [
            (question, weight * (factor if truth else 1.0 / factor))
            for question, weight, factor in zip(found, weights, factors, strict=True)
            if weight > 0.0
        ]
        questions[truth] = tuple(question for question, _ in weighed)
        sums[truth] = tuple(accumulate(weight for _, weight in weighed))
    return PresencePool(questions, sums) if all(questions.values()) else None


def _relations(
    referents: Referents, bits: PriorBits, tables: Iterable[StatementTruths], asked: Container[str], *, alone: bool
) -> dict[Form, RelationPool]:
    pools: dict[Form, RelationPool] = {}
    uneven: list[StatementTruths] = []
    for truths in tables:
        if truths.predicate not in asked:
            continue
        weights = _counted_weights(referents, truths, bits, alone=alone)
        if weights is None:
            weights = balanced_weights(truths.true, truths.false)
        if weights is not None:
            pools.update(_pools_of(referents, truths, weights))
        elif truths.predicate in COMPASS:
            uneven.append(truths)
    pools.update(_joint_pools(referents, uneven))
    return pools


def _joint_pools(referents: Referents, uneven: Sequence[StatementTruths]) -> Iterator[tuple[Form, RelationPool]]:
    """Yield the pools by form of directions that can't be balanced by themselves.

    In a room with few objects, a label or an anchor may have one truth by each direction, but both over all directions.
    """
    forms = [
        (truths, definite, (truths.definite == definite)[:, None]) for truths in uneven for definite in (True, False)
    ]
    if not forms:
        return
    weights = jointly_balanced_weights(
        np.stack([truths.true & own for truths, _, own in forms]),
        np.stack([truths.false & own for truths, _, own in forms]),
    )
    for k, (truths, definite, _) in enumerate(forms if weights else ()):
        own_weights = {truth: table[k] for truth, table in (weights or {}).items()}
        if all(table.any() for table in own_weights.values()):
            yield (truths.predicate, definite), _relation_pool(referents, truths, own_weights, definite=definite)


def _pools_of(
    referents: Referents, truths: StatementTruths, weights: Mapping[bool, F64]
) -> Iterator[tuple[Form, RelationPool]]:
    """Yield the pools of one predicate by form; a form with only one truth is left out."""
    for definite in (True, False):
        of_form = (truths.definite == definite)[:, None]
        own = {truth: np.where(of_form, table, 0.0) for truth, table in weights.items()}
        if all(table.any() for table in own.values()):
            yield (truths.predicate, definite), _relation_pool(referents, truths, own, definite=definite)


def _relation_pool(
    referents: Referents, truths: StatementTruths, weights: Mapping[bool, F64], *, definite: bool
) -> RelationPool:
    return RelationPool(
        truths=truths,
        definite=definite,
        object_ids=referents.arrays.object_ids,
        cells={truth: np.argwhere(table > 0.0) for truth, table in weights.items()},
        sums={truth: np.cumsum(table[table > 0.0]) for truth, table in weights.items()},
        mass=float(min(weights[True].sum(), weights[False].sum())),
    )


def _bearings(referents: Referents, asked: Container[str]) -> dict[Form, RelationPool]:
    """Return the egocentric statements about a room by predicate. They use only objects that are not small, whose label
    is unique, and that are worth going to.

    The start pose is chosen to give the wanted truths, so each object can be used with either truth.
    """
    own = referents.arrays.labels
    fit = {own[i] for i in np.flatnonzero(referents.unique & referents.sized & ~referents.small)}
    labels = tuple(sorted(label for label in fit if worth(label, referents.room.label).goto >= LEAST_WORTH))
    if not labels:
        return {}
    exact = np.array([[x == label for x in own] for label in labels], dtype=bool)
    any_of_them = np.ones((len(labels), 1), dtype=bool)
    cells = np.stack([np.arange(len(labels)), np.zeros(len(labels), np.intp)], axis=1)
    sums = np.arange(1.0, len(labels) + 1.0)
    return {
        (bearing, True): RelationPool(
            truths=StatementTruths(
                predicate=bearing,
                labels=labels,
                anchors=np.empty((1, 0), dtype=np.intp),
                definite=np.ones(len(labels), dtype=bool),
                exact=exact,
                held=np.ones((len(own), 1), dtype=bool),
                true=any_of_them,
                false=any_of_them,
            ),
            definite=True,
            object_ids=referents.arrays.object_ids,
            cells={True: cells, False: cells},
            sums={True: sums, False: sums},
            mass=float(len(labels)),
        )
        for bearing in BEARINGS
        if bearing in asked
    }


def _counted_weights(
    referents: Referents, truths: StatementTruths, bits: PriorBits, *, alone: bool
) -> dict[bool, F64] | None:
    """Return the weights of all statements of one predicate by truth, from what the priors count; None if none of them
    was counted in enough rooms. `alone`: for programs of one condition.
    """
    room_type, evidence, definite = referents.room.label, bits.evidence(referents.room.label), truths.definite.tolist()
    forms = [(room_type, label, truths.predicate, one) for label, one in zip(truths.labels, definite, strict=True)]
    factors = np.array([bits.label_weights.get(form, (1.0, 1.0)) for form in forms])
    anchors = truths.anchor_keys(referents.arrays.labels)
    known, tables = False, dict[bool, F64]()
    for truth, support in ((True, truths.true), (False, truths.false)):
        tables[truth] = np.zeros(support.shape)
        rows, columns = np.nonzero(support)
        said = [
            (room_type, truths.labels[row], truths.predicate, anchors[column], definite[row])
            for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        ]
        if not said:
            continue
        counts = np.array([bits.counts.get(statement, (0, 0)) for statement in said], dtype=np.float64)
        known |= bool((counts.sum(axis=1) >= evidence).any())
        fitted = [bits.even.get(statement, UNCHANGED) for statement in said]
        even = np.array([own.one if alone else own.several for own in fitted])
        weights = statement_weights(counts, evidence)[truth] * (even if truth else 1.0 / even)
        tables[truth][rows, columns] = factors[rows, int(truth)] * weights
    return tables if known else None
