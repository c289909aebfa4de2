"""The bias gate's part of the report of an export."""

from __future__ import annotations

from typing import Final, Literal

from pydantic import ValidationError

from condvln.bias import BiasReport
from condvln.bias.report import ALL, ALPHA
from factory.snapshot import Snapshot
from jobs.report import Report, Section
from schemas.errors import ProofError
from schemas.snapshot import Pin

__all__ = ["add_bias", "priors_behind"]

_COLUMNS = ("guesser", "source", "part", "episodes", "right", "low", "high", "chance", "p (Holm)")

BY_STATEMENT: Final = frozenset({"label and room", "whole statement"})
"""Guessers that learn how often a statement is true."""


def add_bias(
    report: Report,
    found: BiasReport | None,
    action: Literal["off", "warn", "fail"],
    behind: tuple[int, int] | None = None,
    statements: Literal["any", "even"] = "even",
) -> None:
    """Add the verdict and the table of the bias gate to `report`. The exit code is 3 if a guesser beats chance and
    `action` is ``fail``.

    behind : where the priors were counted over fewer scenes than are published, both numbers; a likely cause
    statements : ``any`` if the export could still leave out episodes until statements are even
    """
    if found is None:
        return
    failed = not found.passed
    report.lines.append(f"{'WARNING: ' if failed else ''}bias gate: {found.verdict()}")
    if failed and behind is not None:
        counted, now = behind
        report.lines.append(
            f"label priors were counted over {counted} scenes, but {now} are published, so words may predict what is "
            "true in the other scenes; condvln rebuild CONFIG --priors counts them again"
        )
    learned = {finding.guesser for finding in found.beaten} & BY_STATEMENT
    if learned and statements == "any":
        report.lines.append(
            "some statements are asked more often where they are true, others where they are false; "
            "splits.statements=even leaves out episodes until they are even"
        )
    rows = found.overview()
    # Source by source there are dozens; what is in order stands in export.json and on the card.
    told = [row for row in rows if row[1] == ALL or row[2] != ALL or float(row[-1]) < ALPHA]
    report.sections.append(Section("Guesses that see no scene", _COLUMNS, [*(told or rows)]))
    if failed and action == "fail":
        report.exit_code = max(report.exit_code, ProofError.exit_code)


def priors_behind(snapshot: Snapshot, ref: str) -> tuple[int, int] | None:
    """Return (number of scenes that the pinned priors were counted over, number of scenes published). Returns None
    unless the second number is larger.
    """
    now = max((stage.units - stage.skipped for stage in snapshot.manifest.stages.values()), default=0)
    for entry in snapshot.store.list("pins"):
        if entry.path.endswith(f"/{ref}.json"):
            try:
                pinned = Pin.model_validate_json(snapshot.store.read(entry.path)).tables.get("priors")
            except (FileNotFoundError, ValidationError):
                continue
            if pinned is not None and pinned.units < now:
                return pinned.units, now
    return None
