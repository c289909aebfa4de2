"""Tables of statements about a room, by label and anchors: which are true, and which are false, both with margin."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.predicates import ASKED
from condvln.instructions.referents import Referents, meant_by
from condvln.labels import Vocabulary
from condvln.labels.lists import LEAST_WORTH, belongs_by, known_purposes, labels_with_role, worth
from schemas.program import Predicate

__all__ = ["ANCHOR_JOINT", "StatementTruths", "anchor_key", "statement_truths"]

Bools = NDArray[np.bool_]

ANCHOR_JOINT: Final = " + "
"""Stands between the labels in the key of a statement's anchors."""


@dataclass(frozen=True, eq=False)
class StatementTruths:
    """The truths of all statements "there is a <label> <predicate> the <anchor>" about one room, for one predicate.

    labels (l,) : nameable labels of the room
    anchors (a, k) : each row is one choice of the k anchors of a statement, as indices
    definite (l,) : only one object can be meant by a label, so that text says "the lamp"
    exact (l, n) : which visible objects have a label
    held (n, a) : which objects are in the relation, with margin
    true (l, a) : a visible object of exactly this label is in the relation
    false (l, a) : every object that the label might mean, visible or not, and every unlabelled object that may have the
        label, fails the relation at the loose threshold (for compass words, at `sector_denied`)

    Of labels that nobody would ask about, and beside anchors that nobody would name (``worth``), `true` and `false` are
    unset; likewise where an anchor is neither fixed nor larger than each object of the label.
    """

    predicate: Predicate
    labels: tuple[str, ...]
    anchors: NDArray[np.intp]
    definite: Bools
    exact: Bools
    held: Bools
    true: Bools
    false: Bools

    def anchor_keys(self, own: Sequence[str]) -> list[str]:
        """Return the keys under which the priors count the anchors of each column of `true` and `false`. `own` has the
        labels of the room's objects.
        """
        if self.anchors.shape[1] == 1:
            return [own[a] for a in self.anchors[:, 0].tolist()]
        return [anchor_key(own[a] for a in row) for row in self.anchors.tolist()]


def anchor_key(labels: Iterable[str]) -> str:
    """Return the key of a statement's anchors: their labels, sorted and joined."""
    return ANCHOR_JOINT.join(sorted(labels))


def statement_truths(
    referents: Referents, vocabulary: Vocabulary, *, usual_places: bool = False
) -> Iterator[StatementTruths]:
    """Yield one table for each predicate with anchors: the truths of all statements about one room that use it.

    usual_places : leave out statements about a thing beside something that it serves no purpose with
    """
    own = referents.arrays.labels
    labels = tuple(sorted({label for label, fit in zip(own, referents.nameable, strict=True) if fit}))
    if not labels or not len(referents.anchors):
        return
    exact = np.array([[x == label for x in own] for label in labels], dtype=bool) & referents.nameable
    overlap = meant_by(labels, own, referents.may_be, vocabulary)
    # A label that an invisible object may have is used with neither truth.
    room_type = referents.room.label
    asked = np.array(
        [worth(x, room_type).relation >= LEAST_WORTH and referents.decides(x, vocabulary) for x in labels], dtype=bool
    )
    landmark = np.array([worth(label, room_type).goto >= LEAST_WORTH for label in own], dtype=bool)
    # "A lamp near the bed" is false only if no unlabelled object that may be a lamp is near it. "The lamp" is visible.
    definite = np.array([label in referents.unique_labels for label in labels], dtype=bool)
    possible = overlap | (meant_by(labels, own, referents.open, vocabulary) & ~definite[:, None])
    exactly, perhaps = exact.astype(np.float32), possible.astype(np.float32)
    suited = np.ones(exact.shape, dtype=bool)
    if usual_places:
        suited = _suited(labels, own, anywhere=not vocabulary.room(room_type).fit_for_text)
    fit: dict[int, Bools] = {}  # by the number of anchors: predicates with as many have the same choices of them
    for predicate in ASKED:
        anchors, status, _, suits = referents.related(predicate)
        if anchors.shape[1] not in fit:
            # "a bed near the bed" is pointless, and so is any other word for the bed.
            meant = overlap[:, anchors].any(axis=2)
            fit[anchors.shape[1]] = (
                landmark[anchors].all(axis=1)
                & suited[:, anchors].all(axis=2)
                & ~meant
                & asked[:, None]
                & (exactly @ (~suits).astype(np.float32) == 0)
            )
        sayable = fit[anchors.shape[1]]
        if predicate == "on":
            # Nobody would ask whether the faucet is on the painting, or the side table on the sink.
            surfaces = labels_with_role("surface")
            sayable = sayable & np.array([own[a] in surfaces for a in anchors[:, 0].tolist()], dtype=bool)
            sayable &= np.array([label not in surfaces for label in labels], dtype=bool)[:, None]
        held = np.asarray(status == 1)
        left = perhaps @ (~referents.denied(predicate, status)).astype(np.float32)
        yield StatementTruths(
            predicate=predicate,
            labels=labels,
            anchors=anchors,
            definite=definite,
            exact=exact,
            held=held,
            true=np.asarray((exactly @ held.astype(np.float32) > 0) & sayable),
            false=np.asarray((left == 0) & sayable),
        )


def _suited(labels: Sequence[str], own: Sequence[str], *, anywhere: bool) -> Bools:
    """Return whether it is worth asking if a thing of each of `labels` is by each thing of the room, (l, n): nobody
    asks whether the pillow is on the counter. Where no purpose of a label is known, it is.

    anywhere : furniture may be anywhere, as in a home without rooms
    """
    known, free = known_purposes(), labels_with_role("surface") if anywhere else frozenset[str]()
    rows = []
    for label in labels:
        places = belongs_by().get(label, frozenset())
        everywhere = label not in known or label in free
        rows.append([everywhere or x in places or x not in known for x in own])
    return np.array(rows, dtype=bool)
