"""The kinds of findings of the linter, each with a code, a severity and a remedy; and checks of single values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal, cast

from condvln.own_tables import own_rows

__all__ = [
    "CODES",
    "Finding",
    "LintReport",
    "Rule",
    "Severity",
    "check_keys",
    "is_number",
    "is_point",
    "points",
    "straight",
]

Severity = Literal["error", "warning"]
"""An error crashes a known loader or makes a score wrong; a warning may be intended."""


@dataclass(frozen=True)
class Rule:
    """One kind of finding."""

    severity: Severity
    remedy: str


CODES: Final = {
    row["code"]: Rule(cast(Severity, row["severity"]), row["remedy"])
    for row in own_rows("condvln.export.validation", "codes.csv")
}
"""Every code with its severity and remedy, from ``codes.csv``."""


@dataclass(frozen=True, order=True)
class Finding:
    """One finding at one place."""

    file: str
    place: str
    code: str
    message: str
    episode: str = ""
    """The episode's id, or a path's; empty for a finding about the whole file."""

    @property
    def severity(self) -> Severity:
        """The severity of the finding's code."""
        return CODES[self.code].severity

    @property
    def remedy(self) -> str:
        """The remedy of the finding's code."""
        return CODES[self.code].remedy

    def line(self) -> str:
        """Return ``file: place: code message``, in the usual form of linters."""
        place = f"{self.place}: " if self.place else ""
        return f"{self.file}: {place}{self.severity} [{self.code}] {self.message}"


class LintReport:
    """The findings of one file, in the order in which they were made."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.episode = ""
        """Id of the episode that is being checked."""
        self._findings: list[Finding] = []

    def add(self, place: str, code: str, message: str) -> None:
        """Add a finding."""
        assert code in CODES, code
        self._findings.append(Finding(self.file, place, code, message, self.episode))

    def __iter__(self) -> Iterator[Finding]:
        return iter(self._findings)


def is_number(value: Any) -> bool:
    """Return whether a value is a JSON number; booleans are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_point(value: Any, size: int = 3) -> bool:
    """Return whether a value is a list of ``size`` numbers."""
    return isinstance(value, list) and len(value) == size and all(is_number(part) for part in value)


def points(report: LintReport, place: str, value: Any, size: int = 3) -> bool:
    """Return whether ``value`` is a list of points; if not, add a finding."""
    if not isinstance(value, list):
        report.add(place, "wrong-type", f"not a list of points but {type(value).__name__}")
        return False
    for number, point in enumerate(value):
        if not is_point(point, size):
            report.add(f"{place}[{number}]", "wrong-type", f"not {size} numbers: {point!r:.60}")
            return False
        if not all(math.isfinite(part) for part in point):
            report.add(f"{place}[{number}]", "not-finite", f"{point}")
            return False
    return True


def straight(a: Iterable[float], b: Iterable[float]) -> float:
    """Return the Euclidean distance of two points."""
    return math.dist(tuple(a), tuple(b))


def check_keys(report: LintReport, place: str, record: Any, required: frozenset[str], allowed: frozenset[str]) -> bool:
    """Return whether ``record`` is an object with all ``required`` keys; unknown and missing keys are added as
    findings.
    """
    if not isinstance(record, dict):
        report.add(place, "wrong-type", f"not an object but {type(record).__name__}")
        return False
    for key in sorted(set(record) - allowed):
        report.add(f"{place}.{key}" if place else key, "unknown-key", f"unknown key {key!r}")
    missing = sorted(required - set(record))
    for key in missing:
        report.add(place, "missing-key", f"no key {key!r}")
    return not missing
