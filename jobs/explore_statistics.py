"""Counts that the page shows in addition to the counts of episodes: funnel, rejections, relations, bias gate, and how
its episodes differ from those of a former export or snapshot.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from condvln.episodes.candidates import PLACING
from condvln.explorer.rejected import clash_examples, program_example, rule_text
from condvln.manifest import manifest_lines, manifest_paths
from factory.snapshot import Snapshot, read_manifest, read_ref
from jobs.explore_scenes import ExploredScene
from jobs.funnel import SURPLUS, Flow
from jobs.workspace import open_store
from schemas.base import Json
from schemas.config import Config
from schemas.errors import UsageError

__all__ = [
    "Counts",
    "EpisodeFacts",
    "Former",
    "drift_document",
    "former_episodes",
    "scene_yield",
    "statistics_document",
]

SUMS: Final = ("wanted", "candidates", "rejected", "placed")
FULL: Final = "these leaves already have their share; candidates of other leaves are lacking"
"""Why candidates for which there was no room did not fill a gap."""
EXAMPLES: Final = 3
"""Number of examples that are kept of each reason of rejection."""


@dataclass
class Counts:
    """Sums over the scenes of a page. `asked` has, by predicate, the numbers of false and of true conditions."""

    scenes: int = 0
    episodes: int = 0
    asked: dict[str, list[int]] = field(default_factory=dict)
    relations: dict[tuple[str, str], list[int]] = field(default_factory=dict)
    funnel: dict[tuple[str, str], list[int]] = field(default_factory=dict)
    rejections: dict[tuple[str, str, str], int] = field(default_factory=dict)
    places: dict[tuple[str, str, str], Counter[str]] = field(default_factory=dict)
    examples: dict[tuple[str, str, str], list[Json]] = field(default_factory=dict)
    ids: dict[str, EpisodeFacts] = field(default_factory=dict)

    def add(self, scene: ExploredScene) -> None:
        """Add a scene."""
        source, scene_id = scene.scene.family, scene.scene.scene_id
        self.scenes += 1
        self.episodes += len(scene.rows)
        for row in scene.relations or ():
            if row["kind"] == "semantic":
                sums = self.relations.setdefault((source, row["predicate"]), [0, 0])
                sums[0] += 1
                sums[1] += bool(row["true_in_text"])
        for condition in (one for row in scene.rows for one in row["program"]["conditions"]):
            predicate = (condition["qualifier"] or {"predicate": "presence"})["predicate"]
            self.asked.setdefault(predicate, [0, 0])[condition["truth"]] += 1
        tables = scene.tables or {}
        for row in tables.get("funnel", ()):
            sums = self.funnel.setdefault((source, row["cell"]), [0, 0, 0, 0])
            for k, name in enumerate(SUMS):
                sums[k] += row[name]
        for row in tables.get("rejections", ()):
            key = (source, row["stage"], row["reason"])
            self.rejections[key] = self.rejections.get(key, 0) + row["count"]
            self.places.setdefault(key, Counter())[scene_id] += row["count"]
            self.examples.setdefault(key, [])
        self._keep_examples(scene)
        self.ids.update({str(row["episode_id"]): EpisodeFacts.of(row, row["split"]) for row in scene.rows})

    def _keep_examples(self, scene: ExploredScene) -> None:
        """Keep an example of each reason of the scene that has too few, in words where its candidate is known."""
        source, scene_id = scene.scene.family, scene.scene.scene_id
        rows = (scene.tables or {}).get("rejections", ())
        wanted = {
            (row["stage"], row["reason"]): row
            for row in rows
            if len(self.examples[source, row["stage"], row["reason"]]) < EXAMPLES
        }
        if not wanted:
            return
        programs = scene.candidates()
        clashes = clash_examples(programs, [reason for stage, reason in wanted if stage == "programs"])
        for (stage, reason), row in wanted.items():
            known = programs.get(row["example"] or "")
            found = clashes.get(reason) if stage == "programs" else None if known is None else program_example(known)
            if found is not None:
                place = {"scene": scene_id, "cell": "" if stage == "programs" else row["cell"]}
                self.examples[source, stage, reason].append({**place, **found})


def scene_yield(scene: ExploredScene) -> Json | None:
    """Return what became of a scene's candidates: rows of the tables ``funnel`` and ``rejections``, the latter with the
    rule in words, what explains a gap best first; ``wanted`` and ``placed``, summed; and ``reason``, the most frequent
    cause in the cells that have fewer than wanted, as in ``jobs.funnel``. None where nothing is known.
    """
    if not scene.tables:
        return None
    funnel = [[row[name] for name in ("cell", *SUMS)] for row in scene.tables["funnel"]]
    rejections = [[row[name] for name in ("cell", "stage", "reason", "count")] for row in scene.tables["rejections"]]
    flow = Flow()
    for cell, wanted, candidates, _, placed in funnel:
        rejected, undrawn = (
            {reason: n for at, stage, reason, n in rejections if at == cell and (stage == PLACING) == placing}
            for placing in (True, False)
        )
        flow.add(Flow.of_cell(wanted, candidates, placed, rejected, undrawn))
    rejections.sort(key=lambda row: (row[2] in SURPLUS, row[1] != PLACING, -row[3]))
    return {
        "wanted": flow.wanted,
        "placed": flow.placed,
        "reason": flow.reason(),
        "funnel": funnel,
        "rejections": [[*row, FULL if row[2] in SURPLUS else rule_text(row[1], row[2])] for row in rejections],
    }


def statistics_document(counts: Counts, record: Mapping[str, Any] | None, former: Former | None) -> Json:
    """Return what the page's statistics show.

    Parameters
    ----------
    record : the export's ``export.json``
    former : episodes of a former export or snapshot, with which these are compared
    """
    return {
        "asked": counts.asked,
        "relations": [[*key, *sums] for key, sums in sorted(counts.relations.items())],
        "funnel": [[*key, *sums] for key, sums in sorted(counts.funnel.items())],
        "rejections": [
            {
                "source": key[0],
                "stage": key[1],
                "reason": key[2],
                "rule": rule_text(key[1], key[2]),
                "count": count,
                "places": counts.places[key].most_common(EXAMPLES),
                "examples": counts.examples[key],
            }
            for key, count in sorted(counts.rejections.items(), key=lambda item: (-item[1], item[0]))
        ],
        "gate": None if record is None else record.get("bias"),
        "left_out": {} if record is None else record.get("left_out") or {},
        "drift": None if former is None else drift_document(counts.ids, former),
    }


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
        lines = ((path.stem, line) for path in paths for line in manifest_lines(path))
        facts = {str(line.ids()[0]): EpisodeFacts.of(line.fields(), split) for split, line in lines}
        return Former(before, facts, False)
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


def drift_document(now: Episodes, former: Former) -> Json:
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
