"""What the gate found: every guesser against chance, and how even the gold leaves are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

__all__ = ["ALL", "ALPHA", "PRESENCE", "BiasReport", "Finding", "Uniformity"]

ALPHA: Final = 0.01
"""Probability at which a fair dataset is called biased by any of all tests together."""
ALL: Final = "all"
"""Stands for the source, category or predicate of a test over all of them."""
MOST_NAMED: Final = 6
"""Findings that the verdict names; the table has them all."""
PRESENCE: Final = "presence"
"""Stands for the predicate of a condition that asks for no relation."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One guesser on one part of the episodes: of a source, a category, and one predicate that conditions ask for.

    chance : mean of 1 ÷ leaves; low, high : 95 % interval of the accuracy; p : one-sided; p_holm : corrected
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
        """The category, or the predicate that a condition of its episodes asks for."""
        return self.category if self.predicate == ALL else f"asks: {self.predicate}"

    @property
    def beats_chance(self) -> bool:
        """Whether the guesser finds the right leaf more often than chance."""
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
        """Whether the leaves differ more than by chance."""
        return self.p_holm < ALPHA


@dataclass(frozen=True)
class BiasReport:
    """All tests of one export.

    episodes : guessed at; of a counterfactual group one
    groups : counterfactual groups; untested : (source, category, episodes) of cells too small for tests of their own
    """

    episodes: int
    groups: int
    findings: tuple[Finding, ...]
    uniformity: tuple[Uniformity, ...]
    untested: tuple[tuple[str, str, int], ...] = field(default=())

    @property
    def tests(self) -> int:
        """Number of tests that are corrected for together."""
        return len(self.findings) + len(self.uniformity)

    @property
    def beaten(self) -> list[Finding]:
        """Findings above chance, the surest first."""
        return sorted((f for f in self.findings if f.beats_chance), key=lambda f: f.p_holm)

    @property
    def uneven(self) -> list[Uniformity]:
        """Cells whose gold leaves are unevenly distributed."""
        return [cell for cell in self.uniformity if cell.uneven]

    @property
    def passed(self) -> bool:
        """Whether nothing was found."""
        return not (self.beaten or self.uneven)

    def verdict(self) -> str:
        """One sentence."""
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
        """The report as JSON."""
        return {
            "alpha": ALPHA,
            "passed": self.passed,
            "verdict": self.verdict(),
            "tests": self.tests,
            "episodes": self.episodes,
            "groups": self.groups,
            "findings": [{**_rounded(asdict(f)), "beats_chance": f.beats_chance} for f in self.findings],
            "uniformity": [{**_rounded(asdict(u)), "uneven": u.uneven} for u in self.uniformity],
            "untested": [{"source": s, "category": c, "episodes": n} for s, c, n in self.untested],
        }

    def overview(self) -> list[tuple[str | int | float, ...]]:
        """A row a guesser and source over all, and one for each category and predicate in which chance is beaten.

        (guesser, source, category or predicate, episodes, right, low, high, chance, corrected p)
        """
        names = dict.fromkeys(finding.guesser for finding in self.findings)
        order = {name: k for k, name in enumerate(names)}
        shown = [f for f in self.findings if f.part == ALL or f.beats_chance]
        shown.sort(key=lambda f: (f.source != ALL, f.source, f.part != ALL, f.part, order[f.guesser]))
        return [(f.guesser, f.source, f.part, f.episodes, f.accuracy, f.low, f.high, f.chance, f.p_holm) for f in shown]


def _told(finding: Finding) -> str:
    where = f"{finding.source} {finding.part}"
    return f"{finding.guesser} {finding.accuracy:.3f} where chance is {finding.chance:.3f} ({where})"


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Shares to four digits after the point, p-values to three significant ones: the rest is the machine's."""
    shares: Sequence[str] = ("accuracy", "chance", "low", "high")
    found = {key: round(value, 4) if key in shares else value for key, value in values.items()}
    return {key: float(f"{value:.3g}") if key in ("p", "p_holm") else value for key, value in found.items()}
