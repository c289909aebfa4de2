"""Rows about statements, such as counts of rooms, as numbers: of texts, of statements, of rooms."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

__all__ = ["STATEMENT", "CodedTexts", "Statement", "numbered", "numbered_statements", "of_each", "table_of"]

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
