"""The report of the bias gate: each guesser's accuracy against chance, and how evenly gold leaves are distributed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Final

__all__ = ["ALL", "ALPHA", "PRESENCE", "BiasReport", "Finding", "Uniformity", "fields_of"]

ALPHA: Final = 0.01
"""Significance level of all tests together: the probability that a fair dataset is called biased."""
ALL: Final = "all"
"""Placeholder for the source, category or predicate in a test over all of them."""
MOST_NAMED: Final = 6
"""Largest number of findings named in the verdict; the table holds all of them."""
PRESENCE: Final = "presence"
"""Placeholder for the predicate of a condition without a relation."""


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one guesser on one part of the episodes, given by source, category and predicate.

    chance : mean of 1 / number of leaves; low, high : 95 % confidence interval of the accuracy
    p : one-sided p-value; p_holm : p-value after Holm's correction
    """

    guesser: str
    source: str
    category: str
    episodes: int
    scenes: int
    accuracy: float
    chance: float
    low: float
    high: float
    p: float
    p_holm: float = 1.0
    predicate: str = ALL

    @property
    def part(self) -> str:
        """Name of this part of the episodes: its category; or "asks: " and a predicate, for the episodes that have a
        condition with this predicate.
        """
        return self.category if self.predicate == ALL else f"asks: {self.predicate}"

    @property
    def beats_chance(self) -> bool:
        """Whether the guesser finds the gold leaf significantly more often than chance."""
        return self.p_holm < ALPHA


@dataclass(frozen=True, slots=True)
class Uniformity:
    """How often each leaf is gold in one category of one source."""

    source: str
    category: str
    counts: tuple[int, ...]
    p: float
    p_holm: float = 1.0

    @property
    def uneven(self) -> bool:
        """Whether the numbers of episodes per gold leaf differ significantly."""
        return self.p_holm < ALPHA


@dataclass(frozen=True)
class BiasReport:
    """All tests of one export.

    episodes : number of guessed episodes; a counterfactual group counts as one
    groups : number of counterfactual groups
    untested : (source, category, episodes) of parts that are too small for their own test
    """

    episodes: int
    groups: int
    findings: tuple[Finding, ...]
    uniformity: tuple[Uniformity, ...]
    untested: tuple[tuple[str, str, int], ...] = field(default=())

    @property
    def tests(self) -> int:
        """Number of tests whose p-values are corrected together."""
        return len(self.findings) + len(self.uniformity)

    @property
    def beaten(self) -> list[Finding]:
        """Findings of the guessers that beat chance, the most significant first."""
        return sorted((f for f in self.findings if f.beats_chance), key=lambda f: f.p_holm)

    @property
    def uneven(self) -> list[Uniformity]:
        """Categories of a source whose gold leaves are unevenly distributed."""
        return [cell for cell in self.uniformity if cell.uneven]

    @property
    def passed(self) -> bool:
        """Whether no guesser beats chance and all gold leaves are evenly distributed."""
        return not (self.beaten or self.uneven)

    def verdict(self) -> str:
        """The result in one sentence."""
        if not self.tests:
            return "too few episodes to say whether a guess beats chance"
        said = f"{self.tests} tests on {self.episodes:,} episodes, α = {ALPHA:g} corrected for their number (Holm)"
        if self.passed:
            return f"no guesser beats chance: {said}"
        surest = self.beaten
        found = [_told(finding) for finding in surest[:MOST_NAMED]]
        if len(surest) > MOST_NAMED:
            found.append(f"{len(surest) - MOST_NAMED} more in the table")
        found += [
            f"gold leaves of {cell.source} {cell.category} are uneven: {list(cell.counts)}" for cell in self.uneven
        ]
        return f"guesses beat chance: {'; '.join(found)} ({said})"

    def document(self) -> dict[str, Any]:
        """Return the report as a JSON document."""
        return {
            "alpha": ALPHA,
            "passed": self.passed,
            "verdict": self.verdict(),
            "tests": self.tests,
            "episodes": self.episodes,
            "groups": self.groups,
            "findings": [{**_rounded(fields_of(f)), "beats_chance": f.beats_chance} for f in self.findings],
            "uniformity": [{**_rounded(fields_of(u)), "uneven": u.uneven} for u in self.uniformity],
            "untested": [{"source": s, "category": c, "episodes": n} for s, c, n in self.untested],
        }

    def overview(self) -> list[tuple[str | int | float, ...]]:
        """Return the rows of the report's summary table: one for each guesser in each source, and one for each category
        or predicate in which the guesser beats chance.

        Columns: guesser, source, category or predicate, episodes, accuracy, low, high, chance, corrected p.
        """
        names = dict.fromkeys(finding.guesser for finding in self.findings)
        order = {name: k for k, name in enumerate(names)}
        shown = [f for f in self.findings if f.part == ALL or f.beats_chance]
        shown.sort(key=lambda f: (f.source != ALL, f.source, f.part != ALL, f.part, order[f.guesser]))
        return [(f.guesser, f.source, f.part, f.episodes, f.accuracy, f.low, f.high, f.chance, f.p_holm) for f in shown]


def fields_of(record: Any) -> dict[str, Any]:
    """Return the values of a dataclass by name. Unlike ``dataclasses.asdict``, it copies none of them."""
    return {one.name: getattr(record, one.name) for one in fields(record)}


def _told(finding: Finding) -> str:
    where = f"{finding.source} {finding.part}"
    return f"{finding.guesser} {finding.accuracy:.3f} where chance is {finding.chance:.3f} ({where})"


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Round shares to four decimals and p-values to three significant digits; later digits vary between machines."""
    shares: Sequence[str] = ("accuracy", "chance", "low", "high")
    found = {key: round(value, 4) if key in shares else value for key, value in values.items()}
    return {key: float(f"{value:.3g}") if key in ("p", "p_holm") else value for key, value in found.items()}
