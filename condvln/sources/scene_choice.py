"""Which scenes of a dataset are asked for: ids and patterns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

__all__ = ["SceneChoice"]


@dataclass(frozen=True, slots=True)
class SceneChoice:
    """Scene ids or patterns with ``*`` and ``?`` that are wanted, and those that are not."""

    scenes: Sequence[str] = ("*",)
    exclude: Sequence[str] = ()

    def wanted(self, scene_id: str) -> bool:
        """Is this scene asked for?"""
        return _fits(scene_id, self.scenes) and not _fits(scene_id, self.exclude)

    def missing(self, known: Iterable[str]) -> list[str]:
        """Ids asked for by name that the dataset does not have, sorted."""
        there = set(known)
        named = {s for s in self.scenes if not any(c in s for c in "*?[")}
        return sorted(s for s in named - there if not _fits(s, self.exclude))


def _fits(scene_id: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(scene_id, p) for p in patterns)
