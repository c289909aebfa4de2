"""What the linter keeps of a document for later checks, and functions that check single values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Literal

from condvln.export.tokens import Vocabulary
from condvln.export.validation.findings import LintReport
from condvln.navigation.protocol import PathfinderProtocol

__all__ = ["Document", "Kind", "PathfinderOf", "check_keys", "is_number", "is_point", "points", "straight"]

Kind = Literal["vlnce", "ansr", "rxr", "r2r"]

PathfinderOf = Callable[[dict[str, Any]], PathfinderProtocol | None]
"""Returns the navmesh of an episode's scene; None if unknown."""


@dataclass
class Document:
    """The parts of a document that later checks need."""

    kind: Kind
    vocabulary: Vocabulary | None = None
    bert: bool = False
    """Whether the vocabulary is BERT's, so that tokens are word pieces between [CLS] and [SEP]."""
    scenes: set[str] = field(default_factory=set)
    starts: dict[str, list[float]] = field(default_factory=dict)
    goals: dict[str, list[tuple[list[float], float]]] = field(default_factory=dict)
    told: dict[tuple[str, str, tuple[float, ...]], str] = field(default_factory=dict)
    """Episode id by (scene, text, start)."""

    def merge(self, other: Document) -> None:
        """Merge another document of the same split, such as a shard, into this one."""
        self.vocabulary = self.vocabulary or other.vocabulary
        self.bert |= other.bert
        self.scenes |= other.scenes
        self.starts |= other.starts
        self.goals |= other.goals
        self.told |= other.told


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
