"""Counts of statements over rooms, encoded so that those about one scene are found quickly."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from condvln.instructions.statements import ANCHOR_JOINT
from condvln.labels import vocabulary

__all__ = [
    "STATEMENT",
    "CodedTexts",
    "StagedPresence",
    "Statement",
    "StatementCounts",
    "numbered",
    "numbered_statements",
    "of_each",
    "table_of",
]

STATEMENT: Final = ("room_type", "label", "predicate", "anchor", "definite")
"""Columns that tell statements apart."""

Statement = tuple[str, str, str, str, bool]
"""Room type, label, predicate, anchor label, whether the statement is definite. For presence, the predicate and the
anchor label are empty, and the last value is False.
"""

I64 = NDArray[np.int64]


class CodedTexts(NamedTuple):
    """A column of texts: its distinct texts in the order in which they first occur, and their numbers (n,)."""

    texts: list[str]
    numbers: NDArray[np.int32]

    @classmethod
    def of(cls, column: pa.ChunkedArray) -> CodedTexts:
        """Encode a column."""
        whole = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], pa.string())
        coded = whole.dictionary_encode()
        return cls(coded.dictionary.to_pylist(), coded.indices.to_numpy())

    def at(self, rows: NDArray[np.intp]) -> list[str]:
        """Return the texts of some rows."""
        return [*map(self.texts.__getitem__, self.numbers[rows].tolist())]

    def among(self, wanted: Collection[str]) -> NDArray[np.bool_]:
        """Return which rows have a wanted text, (n,)."""
        distinct = np.fromiter((text in wanted for text in self.texts), bool, len(self.texts))
        return distinct[self.numbers]


def numbered_statements(
    texts: Sequence[CodedTexts], definite: NDArray[np.bool_], rows: NDArray[np.intp]
) -> tuple[I64, list[Statement]]:
    """Return the number of the statement in each of `rows`, from 0 in the order in which statements first occur there;
    and the statements by number.

    Parameters
    ----------
    texts, definite : the columns ``STATEMENT`` of all rows
    """
    own, first = numbered(*(one.numbers[rows] for one in texts), definite[rows])
    columns = [one.at(rows[first]) for one in texts]
    return own, list(zip(*columns, definite[rows[first]].tolist(), strict=True))


def numbered(*columns: NDArray[Any]) -> tuple[I64, NDArray[np.intp]]:
    """Return numbers from 0 of the rows of `columns` (n,), in the order in which they first occur; and the row in which
    each first occurs.
    """
    keys = np.zeros(len(columns[0]), np.int64)
    for column in columns:
        keys = keys * (int(column.max(initial=0)) + 1) + column
    _, first, numbers = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    return place[numbers], first[order]


def of_each(number: NDArray[np.int64], values: NDArray[Any]) -> NDArray[Any]:
    """Return the value of each number, where all rows with the same number have the same value."""
    found = np.zeros(number.max(initial=-1) + 1, values.dtype)
    found[number] = values
    return found


def table_of(rows: Sequence[tuple[object, ...]], schema: pa.Schema) -> pa.Table:
    """Return rows as a table of a schema."""
    columns = [list(column) for column in zip(*rows, strict=True)] or [[] for _ in schema]
    return pa.table([pa.array(c, kind.type) for c, kind in zip(columns, schema, strict=True)], schema=schema)


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


def _among(texts: Sequence[str], wanted: Collection[str]) -> NDArray[np.bool_]:
    """Return which of `texts` are wanted, (n,)."""
    return np.fromiter((text in wanted for text in texts), bool, len(texts))


def _halves(text: str) -> list[tuple[str, str]]:
    """Return all ways to read the key of two anchors: one, as long as no label holds the joint itself."""
    parts = text.split(ANCHOR_JOINT)
    return [(ANCHOR_JOINT.join(parts[:k]), ANCHOR_JOINT.join(parts[k:])) for k in range(1, len(parts))]


@dataclass(frozen=True, slots=True)
class StagedPresence:
    """The presence of those labels that some stagings have, and whose absence can be claimed of others.

    rows : a row for each staging and label, with the columns of ``PRIORS``
    counts : by type of room and label, the number of stagings in which presence is true and of those in which it is
        false
    """

    rows: pa.Table
    counts: Mapping[tuple[str, str], tuple[int, int]]

    @classmethod
    def of(cls, held: pa.Table, asked: Collection[tuple[str, str]]) -> StagedPresence:
        """Return the presence of labels in the stagings of a layout.

        Absence can't be claimed where a word for the label might name something that is there, be it hidden.

        Parameters
        ----------
        held : rows of presence about one layout, with the columns of ``PRIORS``; a row with an empty label stands for
            a room, one without counts for a label that something in it might be called
        asked : type of room and label, of labels whose presence may be asked
        """
        seen: dict[tuple[str, str, str], set[str]] = {}
        possible: dict[tuple[str, str, str], set[str]] = {}
        columns = (held[name].to_pylist() for name in ("layout", "staging", "room_type", "label", "n_true", "n_false"))
        for layout, staging, room_type, label, true, false in zip(*columns, strict=True):
            room = layout, staging, room_type
            if true:
                seen.setdefault(room, set()).add(label)
            if not false:
                possible.setdefault(room, set()).add(label)
        truths: dict[tuple[str, str], dict[tuple[str, str, str], bool]] = {}
        for room, words in possible.items():
            there = seen.get(room, set())
            for room_type, label in asked:
                if room_type == room[-1] and (label in there or not words & vocabulary.overlapping(label)):
                    truths.setdefault((room_type, label), {})[room] = label in there
        found = {key: known for key, known in sorted(truths.items()) if len({*known.values()}) == 2}
        rows = [
            (*room, label, "", "", False, int(true), int(not true), 0)
            for (_, label), known in found.items()
            for room, true in sorted(known.items())
        ]
        counts = {key: (sum(known.values()), len(known) - sum(known.values())) for key, known in found.items()}
        return cls(table_of(rows, held.schema), counts)
