"""The report of a command, for people (rich) and for scripts (JSON), its output and its exit code."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, TypeVar

import typer
from rich.console import Console, ConsoleOptions, RenderResult
from rich.progress import track
from rich.table import Table
from rich.text import Text

__all__ = ["PIPE_WIDTH", "Report", "Section", "answer", "by_cause", "console", "followed", "print_report"]

T = TypeVar("T")

PIPE_WIDTH: Final = 200
"""Width in columns of output that does not go to a terminal."""


def _terminal() -> Console:
    """Create the console for reports. If the output is a file or a pipe, the console gets a fixed width, since rich
    would wrap at 80 columns.
    """
    console = Console()
    return console if console.is_terminal else Console(width=PIPE_WIDTH)


def print_report(report: object) -> None:
    """Print a report, or a line, on standard output. No line is cut at the width of the console."""
    _terminal().print(report, crop=False)


@dataclass
class Section:
    """A table with a title. A table without rows is not shown."""

    title: str
    columns: Sequence[str]
    rows: list[Sequence[Any]] = field(default_factory=list)

    def table(self) -> Table:
        """Return the table for rich."""
        table = Table(title=self.title, title_justify="left", header_style="bold")
        for k, column in enumerate(self.columns):
            numeric = bool(self.rows) and all(isinstance(row[k], int | float) for row in self.rows)
            table.add_column(column, justify="right" if numeric else "left", overflow="fold")
        for row in self.rows:
            table.add_row(*(Text(_cell(value)) for value in row))
        return table


@dataclass
class Report:
    """Lines, tables and `notes` after them for people, `document` for scripts, and the exit code."""

    document: dict[str, Any]
    lines: list[str] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    exit_code: int = 0
    notes: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Return the document, with the exit code."""
        return {**self.document, "exit_code": self.exit_code}

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        # A terminal wraps long lines where it is narrow; in a file a line is one message.
        whole = not console.is_terminal
        text = partial(Text, no_wrap=whole, overflow="ignore" if whole else None)
        yield from map(text, self.lines)
        yield from (section.table() for section in self.sections if section.rows)
        yield from map(text, self.notes)


def by_cause(rows: Iterable[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Return rows of (scene, …, cause), those of one cause as one row that counts the scenes and names the first."""
    groups: dict[tuple[Any, ...], list[Any]] = {}
    for scene, *rest in rows:
        groups.setdefault(tuple(rest), []).append(scene)
    return [
        (scenes[0] if len(scenes) == 1 else f"{scenes[0]} and {len(scenes) - 1} more", *rest)
        for rest, scenes in groups.items()
    ]


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:,.3g}" if abs(value) < 1000 else f"{value:,.0f}"
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)


def console(quiet: bool = False) -> Console:
    """Create the console for progress: standard error, so that a program can read the report on standard output."""
    # In a log a line is one message; a terminal wraps it where it is narrow.
    return Console(stderr=True, quiet=quiet, soft_wrap=not sys.stderr.isatty())


def followed(items: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """Yield the items; on a terminal, a bar says how far they are while it lasts."""
    shown = console()
    yield from track(items, what, total, console=shown, transient=True, disable=not shown.is_terminal)


def answer(report: Any, as_json: bool) -> None:
    """Print a report: for a person, or as one line of JSON. Exits with the report's code unless it is 0."""
    if as_json:
        sys.stdout.write(json.dumps(report.as_json(), ensure_ascii=False, sort_keys=True) + "\n")
    else:
        print_report(report)
    if report.exit_code:
        raise typer.Exit(report.exit_code)
