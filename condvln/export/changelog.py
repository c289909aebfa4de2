"""What changed between two exports, and why: ``CHANGELOG.md``, newest first.

It is the history of a folder, so it is no part of the export's own index. It carries no dates: the same two snapshots
give the same entry on any day.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import orjson

from condvln.export.splits import SPLITS

__all__ = ["CHANGELOG", "Changes", "PublishedEpisodes", "changes_between", "with_entry"]

CHANGELOG: Final = "CHANGELOG.md"
_TITLE: Final = "# Changelog\n"
_EXAMPLES: Final = 5
_GEOMETRY: Final = ("start_position", "start_rotation", "leaves", "max_steps", "success_distance")


class _Episode(NamedTuple):
    scene: str
    split: str
    text: bytes
    geometry: bytes
    navmesh: str


@dataclass
class PublishedEpisodes:
    """The episodes of an export as its manifests have them; hashes only, so that two fit in memory."""

    snapshot: str = ""
    episodes: dict[str, _Episode] = field(default_factory=dict)

    @classmethod
    def of(cls, export: Path) -> PublishedEpisodes:
        """Read the manifests of an export; empty where there is none, or none that can be read."""
        found = cls()
        try:
            for split in SPLITS:
                with (export / "manifest" / f"{split}.jsonl").open("rb") as lines:
                    for line in lines:
                        found._add(orjson.loads(line), split)
        except (OSError, ValueError, KeyError, TypeError):
            return cls()
        return found

    def _add(self, row: dict[str, Any], split: str) -> None:
        self.snapshot = row["snapshot"]
        geometry = {
            key: row[key] for key in ("start_position", "start_rotation", "leaves", "max_steps", "success_distance")
        }
        self.episodes[row["episode_id"]] = _Episode(
            f"{row['source']}/{row['scene_id']}",
            split,
            hashlib.blake2b(row["instruction_text"].encode(), digest_size=8).digest(),
            hashlib.blake2b(orjson.dumps(geometry), digest_size=8).digest(),
            row["navmesh_sha256"],
        )


@dataclass
class Changes:
    """Counts by reason, and a few examples of each."""

    former: str
    snapshot: str
    added: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    changed: Counter[str] = field(default_factory=Counter)
    examples: dict[str, list[str]] = field(default_factory=dict)
    kept: int = 0

    def note(self, kind: Counter[str], reason: str, name: str) -> None:
        """Count one episode."""
        kind[reason] += 1
        found = self.examples.setdefault(reason, [])
        if len(found) < _EXAMPLES:
            found.append(name)

    def entry(self) -> str:
        """The section of the changelog."""
        lines = [f"## {self.snapshot}", "", f"From {self.former}; {self.kept:,} episodes are as they were."]
        for title, kind in (("Added", self.added), ("Dropped", self.dropped), ("Changed", self.changed)):
            if kind:
                lines += ["", f"### {title}", ""]
                lines += [
                    f"* {count:,} {reason} (such as {', '.join(self.examples[reason])})"
                    for reason, count in sorted(kind.items())
                ]
        return "\n".join(lines) + "\n"


def changes_between(former: PublishedEpisodes, new: PublishedEpisodes) -> Changes:
    """Compare two exports, each episode under the likeliest reason."""
    changes = Changes(former.snapshot, new.snapshot)
    old_scenes = {e.scene: e.navmesh for e in former.episodes.values()}
    new_scenes = {e.scene: e.navmesh for e in new.episodes.values()}
    for name, now in sorted(new.episodes.items()):
        then = former.episodes.get(name)
        if then is None:
            changes.note(changes.added, f"added: {_why(now, old_scenes, 'new')}", name)
        elif then == now:
            changes.kept += 1
        else:
            changes.note(changes.changed, _difference(then, now), name)
    for name, then in sorted(former.episodes.items()):
        if name not in new.episodes:
            changes.note(changes.dropped, f"dropped: {_why(then, new_scenes, 'gone')}", name)
    return changes


def _why(episode: _Episode, others: dict[str, str], word: str) -> str:
    navmesh = others.get(episode.scene)
    if navmesh is None:
        return f"their scene is {word}"
    if navmesh != episode.navmesh:
        return "the navmesh of their scene changed"
    return "generated or selected otherwise in a scene that stayed"


def _difference(then: _Episode, now: _Episode) -> str:
    if then.split != now.split:
        return f"moved from {then.split} to {now.split}"
    if then.geometry != now.geometry or then.navmesh != now.navmesh:
        return "other start, goals or routes"
    return "other wording" if then.text != now.text else "other in what no agent sees"


def with_entry(changelog: str, changes: Changes) -> str:
    """The changelog with one section more at its head; as it was where that section is there already."""
    body = changelog.removeprefix(_TITLE).lstrip("\n")
    entry = changes.entry()
    if entry in body:
        return changelog
    return f"{_TITLE}\n{entry}" + (f"\n{body}" if body else "")
