"""Format tables as terminal text, Markdown, LaTeX (booktabs), JSON and CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

from rich import box
from rich.table import Table as RichTable

from condvln.evaluation.tables import Cell, Column, Table

__all__ = ["as_csv", "as_document", "as_latex", "as_markdown", "as_rich", "written"]

_NAME: Final = 16
"""Largest number of characters of a name that a terminal table keeps on one line."""
_WIDE: Final = 9
"""Largest number of numeric columns that fit one column of a paper."""
_NOTHING: Final = "–"
_SCALE: Final = {"percent": 100.0}
_DECIMALS: Final = {"percent": 1, "metres": 2, "number": 1, "p": 4, "count": 0}
_ARROWS: Final = {"higher": "↑", "lower": "↓", "": ""}
_LATEX_ARROWS: Final = {"higher": r"$\uparrow$", "lower": r"$\downarrow$", "": ""}
_LATEX_ESCAPES: Final = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "τ": r"$\tau$", "–": "--",
}  # fmt: skip


def written(cell: Cell, column: Column, *, interval: bool = True) -> str:
    """Return a cell as text: rounded number, interval in brackets, and the number of episodes if some are left out."""
    if cell.value is None or (isinstance(cell.value, float) and math.isnan(cell.value)):
        return _NOTHING
    if isinstance(cell.value, str) or column.kind == "text":
        return str(cell.value)
    text = _number(cell.value, column)
    if interval and not math.isnan(cell.low):
        text += f" [{_number(cell.low, column)}, {_number(cell.high, column)}]"
    if cell.n is not None and cell.n != cell.total:
        text += f" ({cell.n})"
    return text


def _narrow(cell: Cell, column: Column) -> str:
    """Return a cell as :func:`written` does, but with the interval on a separate line and one decimal fewer; for narrow
    terminals.
    """
    lines = [written(replace(cell, low=math.nan, high=math.nan, n=cell.total), column)]
    if not math.isnan(cell.low):
        digits = max(0, _DECIMALS[column.kind] - 1)
        scale = _SCALE.get(column.kind, 1.0)
        lines.append(f"{cell.low * scale:.{digits}f}–{cell.high * scale:.{digits}f}")
    if cell.n is not None and cell.n != cell.total and not math.isnan(float(cell.value or 0.0)):
        lines.append(f"({cell.n})")
    return "\n".join(lines)


def _number(value: float, column: Column) -> str:
    return f"{value * _SCALE.get(column.kind, 1.0):.{_DECIMALS[column.kind]}f}"


def as_rich(table: Table) -> RichTable:
    """Return a table for the terminal."""
    shown = RichTable(
        title=table.title, caption=_note(table) or None, box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False
    )
    shown.collapse_padding = True
    for index, column in enumerate(table.columns):
        # If a heading may break, it is no wider than its numbers.
        heading = f"{column.heading} {_ARROWS[column.better]}".strip().replace("-", "-\n")
        # A terminal that is too narrow breaks a number but never cuts it; names of usual length do not break.
        longest = max((len(str(row[index].value)) for row in table.rows), default=1)
        if column.kind == "text":
            shown.add_column(heading, overflow="fold", min_width=min(longest, _NAME))
        else:
            # Columns of episode counts are short and would be squeezed to nothing first.
            least = longest if column.kind == "count" else None
            shown.add_column(heading, justify="right", overflow="fold", min_width=least)
    for row in table.rows:
        shown.add_row(*(_narrow(cell, column) for cell, column in zip(row, table.columns, strict=True)))
    return shown


def as_markdown(table: Table) -> str:
    """Return a pipe table with a title."""
    headings = [f"{column.heading} {_ARROWS[column.better]}".strip() for column in table.columns]
    rules = ["---" if column.kind == "text" else "---:" for column in table.columns]
    lines = [f"### {table.title}", "", _piped(headings), _piped(rules)]
    for row in table.rows:
        cells = [written(cell, column) for cell, column in zip(row, table.columns, strict=True)]
        lines.append(_piped([text.replace("|", r"\|") for text in cells]))
    if note := _note(table):
        lines += ["", note]
    return "\n".join(lines) + "\n"


def _note(table: Table) -> str:
    return " ".join(filter(None, (table.intervals, table.note)))


def _piped(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def as_latex(table: Table) -> str:
    """Return a booktabs float: values without intervals, the best of each block in bold.

    A wide table spans both columns of a paper, in smaller type.
    """
    wide = len(table.columns) > _WIDE
    align = "".join("l" if column.kind == "text" else "r" for column in table.columns)
    headings = [f"{_escaped(column.heading)} {_LATEX_ARROWS[column.better]}".strip() for column in table.columns]
    lines = [
        r"\begin{table*}[t]" if wide else r"\begin{table}[t]",
        r"  \centering",
        *((r"  \footnotesize", r"  \setlength{\tabcolsep}{3pt}") if wide else ()),
        rf"  \caption{{{_escaped(f'{table.title}. {table.note}'.strip())}}}",
        rf"  \label{{tab:{table.name}}}",
        rf"  \begin{{tabular}}{{{align}}}",
        r"    \toprule",
        "    " + " & ".join(headings) + r" \\",
        r"    \midrule",
    ]
    for number, block in enumerate(_blocks(table)):
        if number and table.blocks:
            lines.append(r"    \midrule")
        best = [_best(block, index, column) for index, column in enumerate(table.columns)]
        for row in block:
            cells = []
            for cell, column, top in zip(row, table.columns, best, strict=True):
                text = _escaped(written(cell, column, interval=False))
                cells.append(rf"\textbf{{{text}}}" if top is not None and cell.value == top else text)
            lines.append("    " + " & ".join(cells) + r" \\")
    lines += [r"    \bottomrule", r"  \end{tabular}", r"\end{table*}" if wide else r"\end{table}", ""]
    return "\n".join(lines)


def _blocks(table: Table) -> list[list[tuple[Cell, ...]]]:
    blocks: list[list[tuple[Cell, ...]]] = []
    last: tuple[Any, ...] | None = None
    for row in table.rows:
        key = tuple(cell.value for cell in row[: table.blocks])
        if not blocks or key != last:
            blocks.append([])
        blocks[-1].append(row)
        last = key
    return blocks


def _best(block: Sequence[tuple[Cell, ...]], index: int, column: Column) -> float | None:
    values = [row[index].value for row in block]
    numbers = [value for value in values if isinstance(value, int | float) and not math.isnan(value)]
    if not column.better or len(numbers) < 2:
        return None
    return max(numbers) if column.better == "higher" else min(numbers)


def _escaped(text: str) -> str:
    return "".join(_LATEX_ESCAPES.get(character, character) for character in text)


def as_document(table: Table) -> dict[str, Any]:
    """Return a table as JSON: unrounded numbers, undefined ones null."""
    rows = []
    for row in table.rows:
        entry: dict[str, Any] = {}
        for cell, column in zip(row, table.columns, strict=True):
            if cell.n is None:
                entry[column.key] = _plain(cell.value)
            else:
                entry[column.key] = {
                    "mean": _plain(cell.value),
                    "low": _plain(cell.low),
                    "high": _plain(cell.high),
                    "n": cell.n,
                    "total": cell.total,
                }
        rows.append(entry)
    return {"name": table.name, "title": table.title, "note": _note(table), "rows": rows}


def _plain(value: float | int | str | None) -> float | int | str | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_csv(table: Table) -> str:
    """Return unrounded CSV, with columns ``_low``, ``_high`` and ``_n`` for numbers with an interval; undefined
    cells are empty.
    """
    header: list[str] = []
    wide = [any(row[index].n is not None for row in table.rows) for index in range(len(table.columns))]
    for column, has_interval in zip(table.columns, wide, strict=True):
        header += [column.key]
        header += [f"{column.key}_low", f"{column.key}_high", f"{column.key}_n"] if has_interval else []
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    for row in table.rows:
        cells: list[Any] = []
        for cell, has_interval in zip(row, wide, strict=True):
            cells.append(_plain(cell.value))
            cells += [_plain(cell.low), _plain(cell.high), cell.n] if has_interval else []
        writer.writerow(cells)
    return out.getvalue()
