"""What the bias gate has to say in the report of an export."""

from __future__ import annotations

from typing import Literal

from condvln.bias import BiasReport
from condvln.bias.report import ALL, ALPHA
from jobs.report import Report, Section
from schemas.errors import ProofError

__all__ = ["add_bias"]

_COLUMNS = ("guesser", "source", "category", "episodes", "right", "low", "high", "chance", "p (Holm)")


def add_bias(report: Report, found: BiasReport | None, action: Literal["off", "warn", "fail"]) -> None:
    """Add the verdict and the table; exit code 3 where chance is beaten and the configuration says ``fail``."""
    if found is None:
        return
    failed = not found.passed
    report.lines.append(f"{'WARNING: ' if failed else ''}bias gate: {found.verdict()}")
    rows = found.overview()
    # Source by source there are dozens; what is in order stands in export.json and on the card.
    told = [row for row in rows if row[1] == ALL or row[2] != ALL or float(row[-1]) < ALPHA]
    report.sections.append(Section("Guesses that see no scene", _COLUMNS, [*(told or rows)]))
    if failed and action == "fail":
        report.exit_code = max(report.exit_code, ProofError.exit_code)
