"""What the linter remembers of a document once its episodes are checked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from condvln.export.tokens import Vocabulary
from condvln.navigation.protocol import PathfinderProtocol

__all__ = ["Document", "Kind", "PathfinderOf"]

Kind = Literal["vlnce", "ansr", "rxr", "r2r"]

PathfinderOf = Callable[[dict[str, Any]], PathfinderProtocol | None]
"""Navmesh of an episode's scene; None where none is known."""


@dataclass
class Document:
    """What later checks need of a document."""

    kind: Kind
    vocabulary: Vocabulary | None = None
    scenes: set[str] = field(default_factory=set)
    starts: dict[str, list[float]] = field(default_factory=dict)
    goals: dict[str, list[tuple[list[float], float]]] = field(default_factory=dict)
    told: dict[tuple[str, str, tuple[float, ...]], str] = field(default_factory=dict)
    """Episode id by scene, text and start."""

    def merge(self, other: Document) -> None:
        """Take in another document of the same split: a shard."""
        self.vocabulary = self.vocabulary or other.vocabulary
        self.scenes |= other.scenes
        self.starts |= other.starts
        self.goals |= other.goals
        self.told |= other.told
