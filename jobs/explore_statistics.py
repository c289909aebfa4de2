"""Counts that the page shows in addition to the counts of episodes: funnel, rejections, relations, bias gate, drift."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from condvln.explorer.rejected import clash_examples, program_example, rule_text
from jobs.explore_drift import EpisodeFacts, Former, drift_document
from jobs.explore_scenes import ExploredScene

__all__ = ["Counts", "statistics_document"]

Document = dict[str, Any]
EXAMPLES: Final = 3
"""Number of examples that are kept of each reason of rejection."""


@dataclass
class Counts:
    """Sums over the scenes of a page."""

    scenes: int = 0
    episodes: int = 0
    objects: Counter[str] = field(default_factory=Counter)
    rooms: Counter[str] = field(default_factory=Counter)
    relations: dict[tuple[str, str], list[int]] = field(default_factory=dict)
    funnel: dict[tuple[str, str], list[int]] = field(default_factory=dict)
    rejections: dict[tuple[str, str, str], int] = field(default_factory=dict)
    places: dict[tuple[str, str, str], Counter[str]] = field(default_factory=dict)
    examples: dict[tuple[str, str, str], list[Document]] = field(default_factory=dict)
    ids: dict[str, EpisodeFacts] = field(default_factory=dict)

    def add(self, scene: ExploredScene) -> None:
        """Add a scene."""
        source, scene_id = scene.scene.family, scene.scene.scene_id
        self.scenes += 1
        self.episodes += len(scene.rows)
        self.objects.update(item.label for item in scene.scene.objects)
        self.rooms.update(room.label for room in scene.scene.rooms)
        for row in scene.relations or ():
            if row["kind"] == "semantic":
                sums = self.relations.setdefault((source, row["predicate"]), [0, 0])
                sums[0] += 1
                sums[1] += bool(row["true_in_text"])
        tables = scene.tables or {}
        for row in tables.get("funnel", ()):
            sums = self.funnel.setdefault((source, row["cell"]), [0, 0, 0, 0])
            for k, name in enumerate(("wanted", "candidates", "rejected", "placed")):
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


def statistics_document(counts: Counts, record: Mapping[str, Any] | None, former: Former | None) -> Document:
    """Return what the page's statistics show.

    Parameters
    ----------
    record : the export's ``export.json``
    former : episodes of a former export or snapshot, with which these are compared
    """
    return {
        "objects": counts.objects.most_common(),
        "rooms": counts.rooms.most_common(),
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
