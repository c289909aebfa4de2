"""Facts of many rows that are checked together, as arrays, and recorded on the rows' certificates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from condvln.verify.certificate import Certificate

__all__ = ["Details", "Findings"]

Bools = NDArray[np.bool_]
I64 = NDArray[np.int64]

Details = Callable[[int], tuple[Any, Any]]
"""Returns the claimed and the found value of a fact that disagrees, by the number of its row or leaf."""


class Findings:
    """Facts of r rows with l leaves in all, collected first and then recorded on the rows' certificates.

    A certificate has its disagreements in the order of the calls, and those of consecutive calls of `leaves` leaf by
    leaf.

    Parameters
    ----------
    row_ends (r,) : end index of each row's leaves
    """

    def __init__(self, row_ends: I64) -> None:
        sizes = np.diff(row_ends, prepend=0)
        self._row = np.repeat(np.arange(len(sizes)), sizes)
        self._first = row_ends - sizes
        self._counts: dict[str, I64] = {}
        self._wrong: list[tuple[tuple[int, int, int, int], tuple[str, bool, Any, Any, str]]] = []
        self._block, self._leaf_by_leaf = 0, False

    def rows(
        self,
        fact: str,
        agreed: Bools,
        details: Details,
        place: str | Callable[[int], str] = "",
        of: Bools | None = None,
    ) -> None:
        """Note a fact of all rows, or of those in the mask `of`: whether each agrees (r,)."""
        self._begin(leaf_by_leaf=False)
        self.count(fact, np.ones(len(agreed), np.int64) if of is None else of.astype(np.int64))
        wrong = ~agreed if of is None else of & ~agreed
        for row in np.flatnonzero(wrong).tolist():
            self._refute(row, -1, fact, details(row), place if isinstance(place, str) else place(row))

    def leaf_by_leaf(self) -> None:
        """Begin facts of leaves, which are refuted with `refute_leaf`."""
        self._begin(leaf_by_leaf=True)

    def leaves(self, fact: str, agreed: Bools, details: Details, of: Bools | None = None) -> None:
        """Note a fact of all leaves, or of those of the rows in the mask `of` (r,): whether each agrees (l,)."""
        self._begin(leaf_by_leaf=True)
        asked = self._row if of is None else self._row[of[self._row]]
        self.count(fact, np.bincount(asked, minlength=len(self._first)))
        wrong = ~agreed if of is None else of[self._row] & ~agreed
        for leaf in np.flatnonzero(wrong).tolist():
            self.refute_leaf(leaf, fact, *details(leaf))

    def count(self, fact: str, checks: I64) -> None:
        """Note how many checks of a fact there were in each row (r,)."""
        self._counts[fact] = self._counts[fact] + checks if fact in self._counts else checks

    def refute_leaf(self, leaf: int, fact: str, claimed: Any, found: Any) -> None:
        """Note that a fact of a leaf disagrees. The check itself must be counted too."""
        row = int(self._row[leaf])
        number = leaf - int(self._first[row])
        self._refute(row, number, fact, (claimed, found), f"leaf {number}")

    def refute_row(self, row: int, fact: str, claimed: Any, found: Any, place: str) -> None:
        """Note that a fact of a row disagrees. The check itself must be counted too."""
        self._begin(leaf_by_leaf=False)
        self._refute(row, -1, fact, (claimed, found), place)

    def record(self, certificates: Sequence[Certificate]) -> None:
        """Record all that was noted on the certificates of the rows."""
        counts = [(fact, checks.tolist()) for fact, checks in self._counts.items()]
        for row, certificate in enumerate(certificates):
            checked = certificate.checked
            for fact, checks in counts:
                if checks[row]:
                    checked[fact] += checks[row]
        for (row, *_), (fact, agreed, claimed, found, place) in sorted(self._wrong, key=lambda one: one[0]):
            certificates[row].checked[fact] -= 1  # counted above, and once more here
            certificates[row].holds(fact, agreed, claimed, found, place)

    def _begin(self, *, leaf_by_leaf: bool) -> None:
        if not (leaf_by_leaf and self._leaf_by_leaf):
            self._block += 1
        self._leaf_by_leaf = leaf_by_leaf

    def _refute(self, row: int, leaf: int, fact: str, values: tuple[Any, Any], place: str) -> None:
        self._wrong.append(((row, self._block, leaf, len(self._wrong)), (fact, False, *values, place)))
