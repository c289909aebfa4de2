"""Output of a verb: its report on standard output, as text or JSON, and its exit code."""

from __future__ import annotations

import json
import sys
from typing import Any

import typer
from rich.console import Console

__all__ = ["answer", "console", "leave"]


def console(quiet: bool = False) -> Console:
    """Create the console for progress: standard error, so that a program can read the report on standard output."""
    # In a log a line is one message; a terminal wraps it where it is narrow.
    return Console(stderr=True, quiet=quiet, soft_wrap=not sys.stderr.isatty())


def answer(report: Any, as_json: bool) -> None:
    """Print a report: for a person, or as one line of JSON."""
    if as_json:
        sys.stdout.write(json.dumps(report.as_json(), ensure_ascii=False, sort_keys=True) + "\n")
    else:
        from jobs.report import print_report

        print_report(report)


def leave(code: int) -> None:
    """Exit with this code unless it is 0."""
    if code:
        raise typer.Exit(code)
