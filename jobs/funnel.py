"""The funnel of a snapshot: what was wanted of each scene and cell, what was drawn, what each filter cost, what is
left.

Candidates are programs that were drawn; each is placed, and so published, or rejected under one reason. Before that a
draw may fail, for reasons that are counted as well, but a failed draw is followed by another and is no candidate.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

import pyarrow as pa

from factory.snapshot import Snapshot
from jobs.report import Report, Section
from schemas.errors import StoreError

__all__ = ["Flow", "Funnel", "add_funnel", "funnel_of"]

SHOWN_REASONS: Final = 3
"""Reasons named beside a row on a terminal; ``--json`` has all of them."""
SHOWN_SCENES: Final = 20
"""Scenes without episodes that are listed on a terminal."""
PLACING: Final = "episodes"
"""Stage whose rejections end candidates; those of other stages end draws."""


@dataclass
class Flow:
    """What went in and what came out of one scene, or of one cell over all scenes.

    rejected : candidates by the filter that ended them; undrawn : draws by what ended them
    """

    wanted: int = 0
    candidates: int = 0
    placed: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    undrawn: Counter[str] = field(default_factory=Counter)

    @property
    def short(self) -> int:
        """Episodes that were wanted and could not be had."""
        return max(0, self.wanted - self.placed)

    def document(self) -> dict[str, Any]:
        """As JSON, filters by what they cost."""
        return {
            "wanted": self.wanted,
            "candidates": self.candidates,
            "rejected": dict(_ranked(self.rejected)),
            "placed": self.placed,
            "short": self.short,
            "undrawn": dict(_ranked(self.undrawn)),
        }

    def why(self) -> str:
        """The costliest filters, in a line; of the draws where nothing was drawn."""
        counts = self.rejected if self.candidates else self.undrawn
        return ", ".join(f"{reason} {count:,}" for reason, count in _ranked(counts)[:SHOWN_REASONS])


@dataclass
class Funnel:
    """Flows by scene and by (source, cell); `barren` : why a scene has no episodes, in words, by its name."""

    scenes: dict[str, Flow]
    cells: dict[tuple[str, str], Flow]
    barren: dict[str, str]

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "scenes": [
                {"scene": name, **flow.document(), "why": self.barren.get(name)} for name, flow in self.scenes.items()
            ],
            "cells": [
                {"source": source, "cell": cell, **flow.document()} for (source, cell), flow in self.cells.items()
            ],
        }

    def sections(self) -> list[Section]:
        """For people: the cells, and the scenes that yielded nothing."""
        rows = [
            (
                source,
                cell,
                f.wanted,
                f.candidates,
                sum(f.rejected.values()),
                f.placed,
                f.short,
                f.why() if f.short else "",
            )
            for (source, cell), f in self.cells.items()
        ]
        columns = ("source", "cell", "wanted", "candidates", "rejected", "placed", "short", "mostly by")
        barren = list(self.barren.items())
        more = [("…", f"and {len(barren) - SHOWN_SCENES:,} more")] if len(barren) > SHOWN_SCENES else []
        return [
            Section("Funnel", columns, [*rows]),
            Section("Scenes without episodes", ("scene", "why"), [*barren[:SHOWN_SCENES], *more]),
        ]


def add_funnel(report: Report, snapshot: Snapshot) -> None:
    """Tell the funnel of a snapshot in `report`; a damaged file of it is told in its place."""
    try:
        funnel = funnel_of(snapshot)
    except (StoreError, FileNotFoundError) as error:
        report.lines.append(f"no funnel: {error}")
        return
    if funnel is not None:
        report.document["funnel"] = funnel.document()
        report.sections += funnel.sections()


def funnel_of(snapshot: Snapshot) -> Funnel | None:
    """The funnel of all scenes of a snapshot, those skipped included; None of a snapshot from before it was counted."""
    if "funnel" not in snapshot.manifest.tables:
        return None
    scenes: defaultdict[str, Flow] = defaultdict(Flow)
    cells: defaultdict[tuple[str, str], Flow] = defaultdict(Flow)
    told: dict[str, str] = {}
    for row in _rows(snapshot.table("scenes", ["scene_id", "status", "reason"])):
        name = f"{row['source']}/{row['scene_id']}"
        scenes[name] = Flow()
        if row["reason"] is not None:
            told[name] = row["reason"]
    for row in _rows(snapshot.table("funnel")):
        for flow in (scenes[f"{row['source']}/{row['scene_id']}"], cells[row["source"], row["cell"]]):
            flow.wanted += row["wanted"]
            flow.candidates += row["candidates"]
            flow.placed += row["placed"]
    for row in _rows(snapshot.table("rejections", ["scene_id", "stage", "cell", "reason", "count"])):
        for flow in (scenes[f"{row['source']}/{row['scene_id']}"], cells[row["source"], row["cell"]]):
            counts = flow.rejected if row["stage"] == PLACING else flow.undrawn
            counts[row["reason"]] += row["count"]
    barren = {name: told.get(name) or _explained(flow) for name, flow in scenes.items() if not flow.placed}
    return Funnel(dict(sorted(scenes.items())), dict(sorted(cells.items())), dict(sorted(barren.items())))


def _rows(table: pa.Table) -> Iterable[dict[str, Any]]:
    for batch in table.to_batches():
        yield from batch.to_pylist()


def _explained(flow: Flow) -> str:
    """What kept a scene from yielding anything: its costliest filter, or what ended its draws."""
    # The science is needed for its words alone, and only here.
    from condvln.episodes.rules import REASONS as PLACING_REASONS
    from condvln.instructions.rejection import REASONS as DRAWING_REASONS

    if not flow.wanted:
        return "nothing was wanted of it"
    counts, meanings = (flow.rejected, PLACING_REASONS) if flow.candidates else (flow.undrawn, DRAWING_REASONS)
    if not counts:
        return "nothing was drawn"
    reason, count = _ranked(counts)[0]
    what = "candidates" if flow.candidates else "draws"
    return f"{reason}: {meanings[reason]} ({count:,} of {sum(counts.values()):,} {what})"


def _ranked(counts: Counter[str]) -> list[tuple[str, int]]:
    return sorted(counts.items(), key=lambda item: (-item[1], item[0]))
