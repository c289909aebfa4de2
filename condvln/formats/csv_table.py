"""Tables of comma-separated values that come with a dataset, with a first line that names their columns."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from schemas.errors import FormatError

__all__ = ["csv_columns"]


def csv_columns(data: bytes, columns: Sequence[str], where: str) -> list[tuple[str, ...]]:
    """Return the cells of the named columns, without white space around them, row by row; a cell that a short row lacks
    is empty.

    Raises
    ------
    FormatError : the table is not text in UTF-8, or lacks a column
    """
    try:
        rows = csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
        missing = [name for name in columns if name not in (rows.fieldnames or ())]
        if missing:
            raise FormatError(
                f"the table has no column {' and no column '.join(missing)}",
                where=where,
                place="line 1",
                remedy="Download the table again",
            )
        return [tuple((row[name] or "").strip() for name in columns) for row in rows]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FormatError(
            f"not a table of comma-separated values: {error}", where=where, remedy="Download the table again"
        ) from None
