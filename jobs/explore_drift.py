"""How the episodes of a page differ from those of a former export or snapshot."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from condvln.manifest import manifest_lines, manifest_paths
from factory.snapshot import Snapshot, read_manifest, read_ref
from jobs.workspace import open_store
from schemas.config import Config
from schemas.errors import UsageError

__all__ = ["EpisodeFacts", "Former", "drift_document", "former_episodes"]

Document = dict[str, Any]


@dataclass(frozen=True)
class EpisodeFacts:
    """The properties of an episode that are compared. `split` is empty in a snapshot, which has no splits."""

    split: str
    source: str
    scene: str
    category: str
    text: bytes

    @classmethod
    def of(cls, row: Mapping[str, Any], split: str) -> EpisodeFacts:
        """Return the compared properties of one episode; `row` comes from a manifest or a snapshot's joined tables."""
        text = hashlib.sha256(str(row.get("instruction_text")).encode()).digest()[:8]
        return cls(split, str(row.get("source")), str(row.get("scene_id")), str(row.get("category")), text)


Episodes = dict[str, EpisodeFacts]
"""By episode id."""


@dataclass(frozen=True)
class Former:
    """The episodes of a former export or snapshot. `name` says which."""

    name: str
    episodes: Episodes
    snapshot: bool


def former_episodes(before: str, config: Config | None) -> Former:
    """Return the episodes of a former export or, in the configuration's store, of a snapshot.

    Parameters
    ----------
    before : folder of an export; or the first characters of a former snapshot's id, or the name of a ref

    Raises
    ------
    UsageError : there is no such export or snapshot
    StoreError : the snapshot is damaged
    """
    paths = manifest_paths(Path(before))
    if paths:
        rows = ((path.stem, line.fields()) for path in paths for line in manifest_lines(path))
        return Former(before, {str(row.get("episode_id")): EpisodeFacts.of(row, split) for split, row in rows}, False)
    snapshot = None if config is None or Path(before).is_dir() else _former_snapshot(before, config)
    if snapshot is None:
        raise UsageError(
            "--before names no export and no snapshot",
            place=before,
            remedy="Name the folder of a former export; or, with a configuration, a snapshot's id (condvln status "
            "lists them) or a ref.",
        )
    table = snapshot.table("episodes", columns=["episode_id", "scene_id", "category", "instruction_text"])
    found = {str(row["episode_id"]): EpisodeFacts.of(row, "") for row in table.to_pylist()}
    return Former(snapshot.snapshot_id, found, True)


def _former_snapshot(name: str, config: Config) -> Snapshot | None:
    store = open_store(config)
    ref, _ = read_ref(store, config.name)
    for state in ref.history if ref is not None and name else ():
        manifest = read_manifest(store, state.snapshot_id) if state.snapshot_id.startswith(name) else None
        if manifest is not None:
            return Snapshot(store, manifest, state.index)
    if not name.replace("-", "").replace("_", "").replace(".", "").isalnum() or read_ref(store, name)[0] is None:
        return None
    return Snapshot.open(store, name)


def drift_document(now: Episodes, former: Former) -> Document:
    """Return how the episodes changed.

    Returns
    -------
    ``cells``: counts before and now by split (source, for snapshots) and category; ``scenes``: the same by source and
    scene, where they differ; ``kept``, ``gone`` and ``new`` episodes by id; ``reworded``: kept ones with another text.
    """
    old, new = former.episodes.keys(), now.keys()
    kept = old & new

    def cell(one: EpisodeFacts) -> tuple[str, str]:
        return (one.source if former.snapshot else one.split), one.category

    scenes = _compared(
        ((one.source, one.scene) for one in former.episodes.values()), ((one.source, one.scene) for one in now.values())
    )
    return {
        "before": former.name,
        "by": "source" if former.snapshot else "split",
        "cells": _compared(map(cell, former.episodes.values()), map(cell, now.values())),
        "scenes": [row for row in scenes if row[2] != row[3]],
        "kept": len(kept),
        "gone": len(old - new),
        "new": len(new - old),
        "reworded": sum(former.episodes[name].text != now[name].text for name in kept),
    }


def _compared(before: Iterable[tuple[str, str]], now: Iterable[tuple[str, str]]) -> list[list[Any]]:
    was, are = Counter(before), Counter(now)
    return [[*key, was[key], are[key]] for key in sorted({*was, *are})]
