"""Which statements about a room are true and which false, each with a margin, as tables over labels and anchors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.predicates import PREDICATES
from condvln.instructions.referents import Referents, meant_by
from condvln.labels import Vocabulary
from schemas.program import Predicate

__all__ = ["StatementTruths", "statement_truths"]

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class StatementTruths:
    """The statements "there is a <label> <predicate> the <anchor>" of one room and one predicate.

    labels (l,) : nameable labels of the room; anchors (a,) : indices of objects unique by label and not small
    exact (l, n) : which objects that can be seen bear a label; held (n, a) : which objects are related with margin
    true (l, a) : an object that can be seen of exactly this label is in the relation
    false (l, a) : every object that the label might mean, seen or not, or that has no name and may bear the label,
        fails the relation at the loose threshold
    """

    predicate: Predicate
    labels: tuple[str, ...]
    anchors: NDArray[np.intp]
    exact: Bools
    held: Bools
    true: Bools
    false: Bools


def statement_truths(referents: Referents, vocabulary: Vocabulary) -> Iterator[StatementTruths]:
    """All statements of relation about one room, a table per predicate."""
    own = referents.arrays.labels
    labels = tuple(sorted({label for label, fit in zip(own, referents.nameable, strict=True) if fit}))
    anchors = np.flatnonzero(referents.anchor & ~referents.small)
    if not labels or not len(anchors):
        return
    exact = np.array([[x == label for x in own] for label in labels], dtype=bool) & referents.nameable
    overlap = meant_by(labels, own, referents.may_be, vocabulary)
    # "a bed near the bed" says nothing; neither does any word for it. A label that something unseen may bear is asked
    # with neither truth.
    decided = np.array([referents.decides(label, vocabulary) for label in labels], dtype=bool)
    # "A lamp near the bed" is false only where no nameless thing that may be a lamp is near it. "The lamp" is seen.
    definite = np.array([label in referents.unique_labels for label in labels], dtype=bool)
    possible = overlap | (meant_by(labels, own, referents.open, vocabulary) & ~definite[:, None])
    sayable = ~overlap[:, anchors] & decided[:, None]
    for predicate in PREDICATES:
        status = referents.facts.status[predicate][:, anchors]
        held = np.asarray(status == 1)
        left = possible.astype(np.float32) @ (status != -1).astype(np.float32)
        yield StatementTruths(
            predicate=predicate,
            labels=labels,
            anchors=anchors,
            exact=exact,
            held=held,
            true=np.asarray((exact.astype(np.float32) @ held.astype(np.float32) > 0) & sayable),
            false=np.asarray((left == 0) & sayable),
        )
