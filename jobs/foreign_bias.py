"""``condvln bias``: the bias gate alone, on an export or on files from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from condvln.bias import judge_export, judge_files
from condvln.bias.foreign_gate import LEAST_GUESSES, ForeignReport
from jobs.bias import add_bias
from jobs.report import Report, Section
from schemas.errors import ProofError, UsageError

__all__ = ["report_bias"]


def report_bias(targets: Sequence[Path]) -> Report:
    """Test whether guessing without seeing the scene beats chance, on the manifests of one export, or on the texts and
    paths in files of any VLN dataset.

    The exit code is 3 where a guess beats chance.

    Raises
    ------
    UsageError : a folder among several targets
    InputError : a file can't be read
    """
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
        add_bias(report, found, "fail")
        return report
    foreign = judge_files(targets)
    report = Report(foreign.document(), _lines(foreign), [_overview(foreign)])
    if foreign.bias.tests:
        add_bias(report, foreign.bias, "fail")
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
