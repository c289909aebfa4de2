"""Which statements about a room are true and which false, each with a margin, as tables over labels and anchors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.predicates import ASKED
from condvln.instructions.referents import Referents, meant_by
from condvln.labels import Vocabulary
from condvln.labels.roles import labels_with_role
from schemas.program import Predicate

__all__ = ["StatementTruths", "anchor_key", "statement_truths"]

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class StatementTruths:
    """The statements "there is a <label> <predicate> the <anchor>" of one room and one predicate.

    labels (l,) : nameable labels of the room; anchors (a, k) : indices of the k anchors of each column
    exact (l, n) : which objects that can be seen bear a label; held (n, a) : which objects are related with margin
    true (l, a) : an object that can be seen of exactly this label is in the relation
    false (l, a) : every object that the label might mean, seen or not, or that has no name and may bear the label,
        fails the relation at the loose threshold
    Neither where an anchor is not the larger or the fixed one beside each object of the label.
    """

    predicate: Predicate
    labels: tuple[str, ...]
    anchors: NDArray[np.intp]
    exact: Bools
    held: Bools
    true: Bools
    false: Bools

    def anchor_key(self, column: int, own: Sequence[str]) -> str:
        """The anchors' labels as the priors know them; `own` are the labels of the room's objects."""
        return anchor_key(own[a] for a in self.anchors[column])


def anchor_key(labels: Iterable[str]) -> str:
    """Labels of a statement's anchors as one, whatever their order."""
    return " + ".join(sorted(labels))


def statement_truths(referents: Referents, vocabulary: Vocabulary) -> Iterator[StatementTruths]:
    """All statements of relation about one room, a table per predicate."""
    own = referents.arrays.labels
    labels = tuple(sorted({label for label, fit in zip(own, referents.nameable, strict=True) if fit}))
    if not labels or not len(referents.anchors):
        return
    exact = np.array([[x == label for x in own] for label in labels], dtype=bool) & referents.nameable
    overlap = meant_by(labels, own, referents.may_be, vocabulary)
    # A label that something unseen may bear is asked with neither truth.
    decided = np.array([referents.decides(label, vocabulary) for label in labels], dtype=bool)
    # "A lamp near the bed" is false only where no nameless thing that may be a lamp is near it. "The lamp" is seen.
    definite = np.array([label in referents.unique_labels for label in labels], dtype=bool)
    possible = overlap | (meant_by(labels, own, referents.open, vocabulary) & ~definite[:, None])
    for predicate in ASKED:
        anchors, status, _, suits = referents.related(predicate)
        # "a bed near the bed" says nothing; neither does any word for it.
        sayable = ~overlap[:, anchors].any(axis=2) & decided[:, None]
        sayable &= exact.astype(np.float32) @ (~suits).astype(np.float32) == 0
        if predicate == "on":
            # Nobody asks whether the faucet is on the painting, or the side table on the sink.
            surfaces = labels_with_role("surface")
            sayable &= np.array([own[a] in surfaces for a in anchors[:, 0].tolist()], dtype=bool)
            sayable &= np.array([label not in surfaces for label in labels], dtype=bool)[:, None]
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
