"""Counts of statements over rooms, encoded so that those about one scene are found quickly."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Final, TypeAlias

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from condvln.instructions.statement_rows import STATEMENT, CodedTexts, Statement
from condvln.instructions.statements import ANCHOR_JOINT

__all__ = ["StatementCounts"]

Counts: TypeAlias = dict[Statement, tuple[int, int]]
Rows: TypeAlias = NDArray[np.intp]


class StatementCounts:
    """Counts of statements, summed over layouts and stagings, in the order of the statements.

    Texts are kept as numbers: which statements are about a scene is then decided for each distinct text, and the rest
    is a few array operations for all statements.
    """

    def __init__(self, rows: pa.Table) -> None:
        """Sum `rows`, a table of schema ``PRIORS``. Statements without counts are left out."""
        sums = rows.group_by(list(STATEMENT)).aggregate([("n_true", "sum"), ("n_false", "sum")])
        sums = sums.filter(pc.greater(pc.add(sums["n_true_sum"], sums["n_false_sum"]), 0))
        sums = sums.sort_by([(name, "ascending") for name in STATEMENT]).combine_chunks()
        self._types, self._labels, self._predicates, self._anchors = (
            CodedTexts.of(sums[name]) for name in STATEMENT[:4]
        )
        self._quoted = [
            pa.array([orjson.dumps(text).decode() for text in column.texts], pa.string())
            for column in (self._types, self._labels, self._predicates, self._anchors)
        ]
        self._definite, self._true, self._false = (
            sums[name].to_numpy() for name in ("definite", "n_true_sum", "n_false_sum")
        )
        pairs = [(at, *both) for at, text in enumerate(self._anchors.texts) for both in _halves(text)]
        words = sorted({word for _, *both in pairs for word in both})
        number = {word: at for at, word in enumerate(words)}
        self._words = words
        self._pairs = np.array(
            [(at, number[one], number[two]) for at, one, two in pairs if one < two], dtype=np.int64
        ).reshape(-1, 3)
        """Rows of (anchors of a statement, the one word of theirs, the other), as numbers."""

    def about(self, types: Collection[str], labels: Collection[str], *, all_present: bool = False) -> Counts:
        """Return the counts of the statements about rooms of `types` in which all words are in `labels`; see `rows`."""
        return self.counts(self.rows(types, labels, all_present=all_present))

    def rows(self, types: Collection[str], labels: Collection[str], *, all_present: bool = False) -> Rows:
        """Return the numbers of the statements about rooms of `types` in which all words are in `labels`, ascending.

        all_present : also those that any label is present
        """
        rows = np.flatnonzero(_among(self._types.texts, {*types})[self._types.numbers])
        read = self._said_with(labels, rows)
        if all_present:
            read |= self._about_presence(rows)
        return rows[read]

    def sayable(self, rows: Rows, labels: Mapping[str, Collection[str]]) -> Rows:
        """Return those of `rows` in which all words are among the `labels` of the type of room, and those about the
        presence of a label.
        """
        found = self._about_presence(rows)
        for room_type, words in labels.items():
            of_type = np.flatnonzero(_among(self._types.texts, {room_type})[self._types.numbers[rows]])
            found[of_type] |= self._said_with(words, rows[of_type])
        return rows[found]

    def _said_with(self, labels: Collection[str], rows: Rows) -> NDArray[np.bool_]:
        """Return whether all words of each statement are in `labels`, (n,)."""
        words = {*labels, ""}
        known = _among(self._words, {*labels})
        anchor = _among(self._anchors.texts, words)
        anchor[self._pairs[known[self._pairs[:, 1]] & known[self._pairs[:, 2]], 0]] = True
        said: NDArray[np.bool_] = _among(self._labels.texts, words)[self._labels.numbers[rows]]
        return said & anchor[self._anchors.numbers[rows]]

    def _about_presence(self, rows: Rows) -> NDArray[np.bool_]:
        """Return whether each statement is the presence of a label, or counts the rooms of a type, (n,)."""
        about: NDArray[np.bool_] = _among(self._predicates.texts, {""})[self._predicates.numbers[rows]]
        return about

    def counts(self, rows: Rows) -> Counts:
        """Return the numbers of rooms in which some statements are true and in which they are false."""
        texts = (column.at(rows) for column in (self._types, self._labels, self._predicates, self._anchors))
        statements = zip(*texts, self._definite[rows].tolist(), strict=True)
        return dict(
            zip(statements, zip(self._true[rows].tolist(), self._false[rows].tolist(), strict=True), strict=True)
        )

    def all(self) -> Counts:
        """Return the counts of all statements."""
        return self.counts(np.arange(len(self._true)))

    def of_labels(self, rows: Rows, types: Collection[str]) -> Rows:
        """Return those of `rows` that are about labels in rooms of `types`: all but the numbers of rooms."""
        about = _among(self._types.texts, types)[self._types.numbers[rows]]
        about &= ~_among(self._labels.texts, {""})[self._labels.numbers[rows]]
        return rows[about]

    def presence(self, rows: Rows) -> Counts:
        """Return the counts of those of `rows` that are the presence of a label, or count the rooms of a type."""
        return self.counts(rows[self._about_presence(rows)])

    def rates(self, rows: Rows, room_type: str, steps: int) -> str:
        """Return, as items of a JSON array, the statements of `rows` that are about labels in rooms of `room_type`,
        each with the rate at which it is true in whole `steps`.
        """
        rows = self.of_labels(rows, {room_type})
        if not len(rows):
            return ""
        true, false = (count[rows].astype(np.float64) for count in (self._true, self._false))
        rates = pa.array(np.rint(steps * (true / (true + false))).astype(np.int64)).cast(pa.string())
        columns = (self._types, self._labels, self._predicates, self._anchors)
        texts = (
            quoted.take(pa.array(column.numbers[rows])) for column, quoted in zip(columns, self._quoted, strict=True)
        )
        definite = _BOOLEANS.take(pa.array(self._definite[rows].astype(np.int8)))
        lines = pc.binary_join_element_wise(*texts, definite, rates, ",")
        whole = pc.binary_join(pa.LargeListArray.from_arrays(pa.array([0, len(rows)], pa.int64()), lines), "],[")
        return f"[{whole[0].as_py()}]"


_BOOLEANS: Final = pa.array(["false", "true"])


def _among(texts: Sequence[str], wanted: Collection[str]) -> NDArray[np.bool_]:
    """Return which of `texts` are wanted, (n,)."""
    return np.fromiter((text in wanted for text in texts), bool, len(texts))


def _halves(text: str) -> list[tuple[str, str]]:
    """Return all ways to read the key of two anchors: one, as long as no label holds the joint itself."""
    parts = text.split(ANCHOR_JOINT)
    return [(ANCHOR_JOINT.join(parts[:k]), ANCHOR_JOINT.join(parts[k:])) for k in range(1, len(parts))]
