"""Select the scenes of a dataset by ids and patterns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

__all__ = ["SceneChoice"]


@dataclass(frozen=True, slots=True)
class SceneChoice:
    """Scene ids or patterns with ``*`` and ``?`` to include, and to exclude."""

    scenes: Sequence[str] = ("*",)
    exclude: Sequence[str] = ()

    def wanted(self, scene_id: str) -> bool:
        """Return whether a scene is included."""
        return _fits(scene_id, self.scenes) and not self.excluded(scene_id)

    def excluded(self, scene_id: str) -> bool:
        """Return whether an exclusion matches `scene_id`, which is a scene's id or a path at which no scene could be
        listed.
        """
        return _fits(scene_id, self.exclude)

    def only_names(self) -> bool:
        """Return whether all scenes are selected by id and none by a pattern."""
        return not any(_is_pattern(scene) for scene in self.scenes)

    def idle(self, known: Sequence[str]) -> list[str]:
        """Return the inclusion patterns that match no scene in `known`. A pattern that matches only excluded scenes is
        not returned.
        """
        return sorted({p for p in self.scenes if _is_pattern(p) and not any(fnmatchcase(s, p) for s in known)})

    def idle_exclusions(self, known: Sequence[str]) -> list[str]:
        """Return the exclusions, ids or patterns, that match no scene in `known`."""
        return sorted({p for p in self.exclude if not any(fnmatchcase(s, p) for s in known)})

    def missing(self, known: Iterable[str]) -> list[str]:
        """Return the selected ids that the dataset does not have, sorted."""
        there = set(known)
        named = {s for s in self.scenes if not _is_pattern(s)}
        return sorted(s for s in named - there if not _fits(s, self.exclude))


def _is_pattern(scene: str) -> bool:
    return any(character in scene for character in "*?[")


def _fits(scene_id: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(scene_id, p) for p in patterns)
