"""Tables of an evaluation for the page: the cells as ``condvln evaluate`` writes them, and the numbers for charts."""

from __future__ import annotations

from typing import Any

from condvln.evaluation.render import as_document, written
from condvln.evaluation.tables import Table

__all__ = ["table_document"]


def table_document(table: Table, split: str) -> dict[str, Any]:
    """Return a table of one split.

    Returns
    -------
    What :func:`~condvln.evaluation.render.as_document` returns, the ``split``, ``headings`` (a heading of numbers
    begins with ``#``), and ``cells``, the rows as texts, with the same digits as in Markdown.
    """
    marks = {"higher": " ↑", "lower": " ↓", "": ""}
    headings = [
        f"{'' if column.kind == 'text' else '#'}{column.heading}{', m' if column.kind == 'metres' else ''}"
        f"{marks[column.better]}"
        for column in table.columns
    ]
    cells = [[written(cell, column) for cell, column in zip(row, table.columns, strict=True)] for row in table.rows]
    return {**as_document(table), "split": split, "headings": headings, "cells": cells}
