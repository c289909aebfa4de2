"""Describe what changed between two exports, and why, in the file ``CHANGELOG.md``; its newest section comes first.

The file is the history of a folder, so the export's own index does not list it. It has no dates: the same two snapshots
give the same entry on any day. Only hashes of each episode are kept, so that two exports of a million fit in memory.
"""

from __future__ import annotations

import heapq
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import orjson

from condvln.export.pool import FIT, ExportPool, Hashes, hashes_of
from condvln.export.splits import SPLITS, Split
from condvln.manifest import manifest_lines, manifest_path
from schemas.errors import InputError

__all__ = ["Changes", "Generated", "PublishedEpisodes", "changes_between", "with_entry"]

_TITLE: Final = "# Changelog\n"
_EXAMPLES: Final = 5
_GEOMETRY: Final = ("start_position", "start_rotation", "leaves", "max_steps", "success_distance")


@dataclass(frozen=True, eq=False)
class PublishedEpisodes:
    """All published episodes of an export, n in number, as hashes.

    Attributes
    ----------
    names : (n,) episode ids
    ids, text, geometry : (n,) 64-bit hashes of each episode's id, of its text, and of its start, path and goals
    scene : (n,) indices into ``scenes``, each ``<source>/<scene>``; ``split`` (n,) into the splits
    navmeshes : SHA-256 by scene
    """

    snapshot: str
    names: npt.NDArray[np.int64]
    ids: Hashes
    scene: npt.NDArray[np.int32]
    split: npt.NDArray[np.int8]
    text: Hashes
    geometry: Hashes
    scenes: tuple[str, ...]
    navmeshes: Mapping[str, str]

    @classmethod
    def of_export(cls, export: Path) -> PublishedEpisodes | None:
        """Read the manifests of an export; None if the export has no manifests, or if they can't be read."""

        def rows() -> Iterator[tuple[Split, str, dict[str, Any]]]:
            for split in SPLITS:
                for line in manifest_lines(manifest_path(export, split)):
                    row = line.fields()
                    snapshots.add(row["snapshot"])
                    yield split, row["source"], row

        snapshots: set[str] = set()
        try:
            found = cls.of_rows("", rows())
        except (InputError, ValueError, KeyError, TypeError):
            return None
        return cls(**{**vars(found), "snapshot": min(snapshots)}) if snapshots else None

    @classmethod
    def of_rows(cls, snapshot: str, rows: Iterator[tuple[Split, str, dict[str, Any]]]) -> PublishedEpisodes:
        """Build the episodes from triples (split, source, row). A row is one of a manifest or of the episodes table."""
        codes: dict[str, int] = {}
        navmeshes: dict[str, str] = {}
        names, scenes, places = array("q"), array("i"), array("b")
        ids, text, geometry = array("Q"), array("Q"), array("Q")
        for split, source, row in rows:
            scene = f"{source}/{row['scene_id']}"
            navmeshes[scene] = row["navmesh_sha256"]
            posed = orjson.dumps({key: row[key] for key in _GEOMETRY}).decode()
            hashes = hashes_of([(row["episode_hash"],), (row["instruction_text"],), (posed,)]).tolist()
            for column, value in zip((ids, text, geometry), hashes, strict=True):
                column.append(value)
            names.append(int(row["episode_id"]))
            scenes.append(codes.setdefault(scene, len(codes)))
            places.append(SPLITS.index(split))
        return cls(
            snapshot,
            np.array(names, dtype=np.int64),
            np.array(ids, dtype=np.uint64),
            np.array(scenes, dtype=np.int32),
            np.array(places, dtype=np.int8),
            np.array(text, dtype=np.uint64),
            np.array(geometry, dtype=np.uint64),
            tuple(codes),
            navmeshes,
        )

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class Generated:
    """All episodes that a snapshot has, published or not, and the reasons why some of them can be in no split."""

    ids: Hashes
    unfit: npt.NDArray[np.int64]
    reasons: tuple[str, ...]

    @classmethod
    def of(cls, pool: ExportPool) -> Generated:
        """Return the episodes of a pool in ascending order of their hashes. Each episode that can be in no split has
        the reason why.
        """
        order = np.argsort(pool.episode)
        return cls(pool.episode[order], pool.unfit[order], pool.reasons)

    def reason(self, name: int) -> str | None:
        """Return the reason why an episode can be in no split: empty text if the episode can be in a split, None if the
        snapshot does not have the episode.
        """
        at = int(np.searchsorted(self.ids, np.uint64(name)))
        if at == len(self.ids) or int(self.ids[at]) != name:
            return None
        code = int(self.unfit[at])
        return self.reasons[code] if code != FIT else ""


@dataclass
class Changes:
    """The differences between two exports: numbers of episodes by reason, with a few examples of each reason."""

    former: str
    snapshot: str
    added: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    changed: Counter[str] = field(default_factory=Counter)
    examples: dict[str, list[str]] = field(default_factory=dict)
    kept: int = 0

    def note(self, kind: Counter[str], title: str, reason: str, name: str) -> None:
        """Count one episode under a reason, and collect its name as an example."""
        kind[reason] += 1
        found = self.examples.setdefault(f"{title} {reason}", [])
        found.append(name)
        if len(found) > 2 * _EXAMPLES:
            found[:] = heapq.nsmallest(_EXAMPLES, found)

    def entry(self) -> str:
        """Return the section of the changelog."""
        lines = [f"## {self.snapshot}", "", f"From {self.former}; {self.kept:,} episodes are as they were."]
        for title, kind in (("Added", self.added), ("Dropped", self.dropped), ("Changed", self.changed)):
            if kind:
                lines += ["", f"### {title}", ""]
            for reason, count in sorted(kind.items()):
                shown = heapq.nsmallest(_EXAMPLES, self.examples[f"{title} {reason}"])
                lines.append(f"* {count:,}: {reason} (such as {', '.join(shown)})")
        return "\n".join(lines) + "\n"


def changes_between(
    former: PublishedEpisodes,
    new: PublishedEpisodes,
    *,
    before: Generated | None = None,
    now: Generated | None = None,
) -> Changes:
    """Compare two exports. Each episode that differs is counted under its most likely reason.

    Parameters
    ----------
    before, now : unpublished episodes of the two snapshots; without them, changes of generation and of selection are
        left out
    """
    changes = Changes(former.snapshot, new.snapshot)
    _, at, to = np.intersect1d(former.ids, new.ids, assume_unique=True, return_indices=True)
    moved = former.split[at] != new.split[to]
    rooted = np.array([former.navmeshes[s] != new.navmeshes.get(s) for s in former.scenes], dtype=bool)
    placed = (former.geometry[at] != new.geometry[to]) | rooted[former.scene[at]]
    reworded = former.text[at] != new.text[to]
    for row in np.flatnonzero(moved | placed | reworded).tolist():
        if moved[row]:
            reason = f"moved from {SPLITS[former.split[at[row]]]} to {SPLITS[new.split[to[row]]]}"
        else:
            reason = "other start, goals or routes" if placed[row] else "other wording"
        changes.note(changes.changed, "Changed", reason, str(new.names[int(to[row])]))
    changes.kept = len(at) - sum(changes.changed.values())
    for row in np.setdiff1d(np.arange(len(new)), to, assume_unique=True).tolist():
        reason = _why_alone(_ADDED, new, row, former.navmeshes, before)
        changes.note(changes.added, "Added", reason, str(new.names[row]))
    for row in np.setdiff1d(np.arange(len(former)), at, assume_unique=True).tolist():
        reason = _why_alone(_DROPPED, former, row, new.navmeshes, now)
        changes.note(changes.dropped, "Dropped", reason, str(former.names[row]))
    return changes


class _Words(NamedTuple):
    """The wording of the reasons for episodes that are in only one of two exports."""

    left_out: str
    scene: str
    generated: str


_ADDED: Final = _Words("was left out before", "their scene is new", "newly generated")
_DROPPED: Final = _Words("left out now", "their scene is gone", "no longer generated")


def _why_alone(
    words: _Words, own: PublishedEpisodes, row: int, navmeshes: Mapping[str, str], other: Generated | None
) -> str:
    """Return the reason why an episode is in only one of two exports. `own` and `row` give the episode in the export
    that has it; `navmeshes` and `other` belong to the export that lacks it.
    """
    reason = other.reason(int(own.ids[row])) if other is not None else None
    if reason is not None:
        return f"{words.left_out}: {reason or 'beyond the balance'}"
    scene = own.scenes[own.scene[row]]
    if scene not in navmeshes:
        return words.scene
    if navmeshes[scene] != own.navmeshes[scene]:
        return "the navmesh of their scene changed"
    return words.generated if other is not None else "generated or chosen otherwise in a scene that stayed"


def with_entry(changelog: str, changes: Changes) -> str:
    """Return the changelog with one more section at its head; unchanged if the changelog already has this section."""
    body = changelog.removeprefix(_TITLE).lstrip("\n")
    entry = changes.entry()
    if entry in body:
        return changelog
    return f"{_TITLE}\n{entry}" + (f"\n{body}" if body else "")
