"""The bias gate: its part of an export's report, and ``condvln bias``, the gate alone on an export or any VLN files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal

from condvln.bias import BiasReport, judge_export, judge_files
from condvln.bias.foreign_gate import LEAST_GUESSES, ForeignReport
from condvln.bias.report import ALL, ALPHA
from factory.snapshot import Snapshot
from jobs.report import Report, Section
from jobs.workspace import pins_of
from schemas.errors import ProofError, UsageError

__all__ = ["add_bias", "priors_behind", "report_bias"]

_COLUMNS = ("guesser", "source", "part", "episodes", "right", "low", "high", "chance", "p (Holm)")

BY_STATEMENT: Final = frozenset({"label and room", "whole statement"})
"""Guessers that learn how often a statement is true."""


def add_bias(
    report: Report,
    found: BiasReport | None,
    action: Literal["off", "warn", "fail"],
    behind: tuple[int, int] | None = None,
    statements: Literal["any", "even"] = "even",
    *,
    asked: bool = False,
) -> None:
    """Add the verdict of the bias gate to `report`, and its table if it failed or was `asked` for. The exit code is 3
    if a guesser beats chance and `action` is ``fail``.

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
            "true in the other scenes; condvln generate CONFIG --priors counts them again"
        )
    learned = {finding.guesser for finding in found.beaten} & BY_STATEMENT
    if learned and statements == "any":
        report.lines.append(
            "some statements are asked more often where they are true, others where they are false; "
            "splits.statements=even leaves out episodes until they are even"
        )
    if failed or asked:
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
    for name, pin in pins_of(snapshot.store):
        pinned = pin.tables.get("priors")
        if name == ref and pinned is not None and pinned.units < now:
            return pinned.units, now
    return None


def report_bias(targets: Sequence[Path]) -> Report:
    """Test whether guessing without seeing the scene beats chance, on the manifests of one export, or on the texts and
    paths in files of any VLN dataset.

    The exit code is 3 where a guess beats chance.

    Raises
    ------
    UsageError : a folder among several targets, or a configuration
    InputError : a file can't be read
    """
    if named := [str(path) for path in targets if path.suffix in (".yaml", ".yml")]:
        raise UsageError("that is a configuration", where=named[0], remedy="Give an export: its folder.")
    folders = [path for path in targets if path.is_dir()]
    if folders and len(targets) > 1:
        raise UsageError(
            "an export can't be tested together with other files",
            where=str(folders[0]),
            remedy="Give the export alone, or files alone.",
        )
    if folders:
        found = judge_export(folders[0])
        report = Report({"path": str(folders[0]), **found.document()}, [])
        add_bias(report, found, "fail", asked=True)
        return report
    foreign = judge_files(targets)
    report = Report(foreign.document(), _lines(foreign), [_overview(foreign)])
    if foreign.bias.tests:
        add_bias(report, foreign.bias, "fail", asked=True)
        report.sections[-1] = Section(
            report.sections[-1].title,
            ("guesser", "question", "part", "texts", "right", "low", "high", "chance", "p (Holm)"),
            [*foreign.bias.overview()],
        )
    report.exit_code = 0 if foreign.bias.passed else ProofError.exit_code
    return report


def _overview(found: ForeignReport) -> Section:
    rows = [
        (name, one.texts, one.scenes, one.mean_words, one.conditional, one.read, one.decided)
        for name, one in found.files.items()
    ]
    return Section("Files", ("file", "texts", "scenes", "words", "conditional", "taken apart", "decided"), [*rows])


def _lines(found: ForeignReport) -> list[str]:
    if found.bias.tests:
        return []
    conditional = sum(one.conditional for one in found.files.values())
    if not conditional:
        return ["no text has a condition: there is no branch to guess"]
    return [
        f"{conditional} texts have a condition, but of fewer than {LEAST_GUESSES} the path says which clause was "
        "right: nothing is tested. The branches of a CondVLN file are in the manifests of its export: name that folder"
    ]
