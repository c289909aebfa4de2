"""The funnel of a snapshot: episodes wanted, candidates drawn, rejections by each filter, and episodes placed.

Candidates are programs that were drawn; each is placed, and so published, or rejected under one reason. Before that a
draw may fail. The reasons are counted as well, but another draw follows, and a failed one is never a candidate.

A cell of a scene is short where it has fewer episodes than were wanted. Its causes are the rejections of its
candidates, without those that only say that there was no room for more (SURPLUS): these candidates would not have
filled the gap. Where even all the others would not have filled it, the rest is counted as TOO_FEW. A cell of a scene
that has all that was wanted has no causes, whatever was rejected on the way.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Final

import pyarrow as pa

from factory.snapshot import Snapshot
from jobs.report import Report, Section

__all__ = ["SURPLUS", "Flow", "Funnel", "add_funnel", "funnel_of", "listed"]

SHOWN_REASONS: Final = 3
"""Number of reasons named beside a row on a terminal; ``--json`` has all of them."""
SHOWN_SCENES: Final = 20
"""Number of scenes without episodes that are listed on a terminal."""
SURPLUS: Final = frozenset({"quota_full", "gold_leaf_full", "truth_full"})
"""Reasons of candidates for which there was no room, in the cell or among those of their gold leaf."""
NO_QUESTION: Final = "no statement about it is both possible as true and as false"
UNCHECKED: Final = "its annotation was checked by nobody ('absence: never' at the source asks what claims no absence)"
"""Why there is no question about a room, where its annotation lets it be asked and where not."""
ADVICE: Final = "Put about six objects in a room, of different labels, each seen from where an agent can stand."
SHOWN_ROOMS: Final = 6
"""Number of rooms that are named of a scene without a question."""
UNASKED: Final = "nothing_to_ask"
"""Reason of draws in a scene about which there is no question."""
TOO_FEW: Final = "too_few_candidates"
"""Cause of the episodes that would be missing even if every candidate had been placed."""
PLACING: Final = "episodes"
"""Stage whose rejections end candidates; rejections of other stages end draws."""


@dataclass
class Flow:
    """Counts of one scene, or of one cell over all scenes: episodes wanted, candidates drawn and rejected, and episodes
    placed.

    rejected : candidates by the filter that ended them; undrawn : draws by what ended them
    short : episodes that were wanted and could not be had
    causes : of what is short, the candidates by the filter that ended them, and TOO_FEW
    undrawn_of_short : draws by what ended them, where there were too few candidates
    """

    wanted: int = 0
    candidates: int = 0
    placed: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    undrawn: Counter[str] = field(default_factory=Counter)
    short: int = 0
    causes: Counter[str] = field(default_factory=Counter)
    undrawn_of_short: Counter[str] = field(default_factory=Counter)

    @classmethod
    def of_cell(
        cls, wanted: int, candidates: int, placed: int, rejected: Mapping[str, int], undrawn: Mapping[str, int]
    ) -> Flow:
        """Return the flow of one cell of one scene."""
        flow = cls(wanted, candidates, placed, Counter(rejected), Counter(undrawn), max(0, wanted - placed))
        if flow.short:
            flow.causes = Counter({reason: n for reason, n in rejected.items() if reason not in SURPLUS})
            missing = flow.short - flow.causes.total()
            if missing > 0:
                flow.causes[TOO_FEW] = missing
                flow.undrawn_of_short = Counter(undrawn)
        return flow

    def add(self, other: Flow) -> None:
        """Add the counts of another flow."""
        for count in fields(self):
            setattr(self, count.name, getattr(self, count.name) + getattr(other, count.name))

    def document(self) -> dict[str, Any]:
        """Return the flow as JSON, filters sorted by their counts."""
        return {
            "wanted": self.wanted,
            "candidates": self.candidates,
            "rejected": dict(_ranked(self.rejected)),
            "placed": self.placed,
            "short": self.short,
            "causes": dict(_ranked(self.causes)),
            "undrawn": dict(_ranked(self.undrawn)),
        }

    def reason(self) -> str:
        """Return the most frequent cause of a shortage; where candidates are lacking, the most frequent one of that.
        Empty where nothing is short.
        """
        cause = next((reason for reason, _ in _ranked(self.causes)), "")
        return next((reason for reason, _ in _ranked(self.undrawn_of_short) if cause == TOO_FEW), cause)

    def why(self) -> str:
        """Return the most frequent causes of a shortage in one line. After the cause TOO_FEW, the line names the most
        frequent reasons why draws failed.
        """
        return ", ".join(self._cause(reason, count) for reason, count in _ranked(self.causes)[:SHOWN_REASONS])

    def _cause(self, reason: str, count: int) -> str:
        why = f" ({listed(self.undrawn_of_short)})" if reason == TOO_FEW and self.undrawn_of_short else ""
        return f"{reason} {count:,}{why}"


@dataclass
class Funnel:
    """How many candidates each step kept and rejected, by scene and by (source, cell). `barren` maps each scene without
    episodes to the reason.
    """

    scenes: dict[str, Flow]
    cells: dict[tuple[str, str], Flow]
    barren: dict[str, str]

    def document(self) -> dict[str, Any]:
        """Return the funnel as JSON."""
        return {
            "scenes": [
                {"scene": name, **flow.document(), "why": self.barren.get(name)} for name, flow in self.scenes.items()
            ],
            "cells": [
                {"source": source, "cell": cell, **flow.document()} for (source, cell), flow in self.cells.items()
            ],
        }

    def sections(self) -> list[Section]:
        """Return sections for a terminal: the cells, and the scenes without episodes."""
        rows = [
            (source, cell, f.wanted, f.candidates, f.rejected.total(), f.placed, f.short, f.why())
            for (source, cell), f in self.cells.items()
        ]
        columns = ("source", "cell", "wanted", "candidates", "rejected", "placed", "short", "mostly by")
        barren = list(self.barren.items())
        more = [("…", f"and {len(barren) - SHOWN_SCENES:,} more")] if len(barren) > SHOWN_SCENES else []
        return [
            Section("Funnel", columns, [*rows]),
            Section("Scenes without episodes", ("scene", "why"), [*barren[:SHOWN_SCENES], *more]),
        ]


def add_funnel(report: Report, snapshot: Snapshot, *, short: bool = False) -> None:
    """Add the funnel of a snapshot to `report`: all cells, or those that are `short` and a line on the others. Raises
    ``CorruptShardError`` where a file of the snapshot is damaged.
    """
    funnel = funnel_of(snapshot)
    report.document["funnel"] = funnel.document()
    if short:
        full = {key: flow for key, flow in funnel.cells.items() if not flow.short}
        report.lines.append(
            f"{sum(flow.placed for flow in funnel.cells.values()):,} episodes; "
            f"{len(full)} of {len(funnel.cells)} cells have all that were wanted"
        )
        funnel.cells = {key: flow for key, flow in funnel.cells.items() if key not in full}
    report.sections += funnel.sections()


def funnel_of(snapshot: Snapshot) -> Funnel:
    """Count the funnel of all scenes of a snapshot, skipped scenes included."""
    scenes: defaultdict[str, Flow] = defaultdict(Flow)
    cells: defaultdict[tuple[str, str], Flow] = defaultdict(Flow)
    told: dict[str, str] = {}
    for row in _rows(snapshot.table("scenes", ["scene_id", "status", "reason"])):
        name = f"{row['source']}/{row['scene_id']}"
        scenes[name] = Flow()
        if row["reason"] is not None:
            told[name] = row["reason"]
    rejected: defaultdict[tuple[str, str, str], Counter[str]] = defaultdict(Counter)
    undrawn: defaultdict[tuple[str, str, str], Counter[str]] = defaultdict(Counter)
    for row in _rows(snapshot.table("rejections", ["scene_id", "stage", "cell", "reason", "count"])):
        counts = rejected if row["stage"] == PLACING else undrawn
        counts[row["source"], row["scene_id"], row["cell"]][row["reason"]] += row["count"]
    for row in _rows(snapshot.table("funnel")):
        key = source, scene, cell = row["source"], row["scene_id"], row["cell"]
        flow = Flow.of_cell(
            row["wanted"], row["candidates"], row["placed"], rejected.pop(key, {}), undrawn.pop(key, {})
        )
        scenes[f"{source}/{scene}"].add(flow)
        cells[source, cell].add(flow)
    barren = {name: told.get(name) or _explained(flow) for name, flow in scenes.items() if not flow.placed}
    barren |= _unasked(snapshot, {name for name, why in barren.items() if why.startswith(f"{UNASKED}:")})
    return Funnel(dict(sorted(scenes.items())), dict(sorted(cells.items())), dict(sorted(barren.items())))


def _rows(table: pa.Table) -> Iterable[dict[str, Any]]:
    for batch in table.to_batches():
        yield from batch.to_pylist()


def _unasked(snapshot: Snapshot, wanted: Collection[str]) -> dict[str, str]:
    """Return why there is no question about the `wanted` scenes, room by room, and what to do."""
    if not wanted:
        return {}

    def rows(table: str, *columns: str) -> Iterable[tuple[str, dict[str, Any]]]:
        for row in _rows(snapshot.table(table, ["scene_id", *columns])):
            if (name := f"{row['source']}/{row['scene_id']}") in wanted:
                yield name, row

    seeable = {(name, row["object_id"]) for name, row in rows("visibility", "object_id", "seeable") if row["seeable"]}
    things = rows("objects", "object_id", "room_id")
    seen = Counter((name, row["room_id"]) for name, row in things if (name, row["object_id"]) in seeable)
    told: defaultdict[str, list[str]] = defaultdict(list)
    for name, row in rows("rooms", "room_id", "label", "asked", "n_objects"):
        room, why = row["room_id"], NO_QUESTION if row["asked"] else UNCHECKED
        called = room if room.startswith(row["label"]) else f"{row['label']} ({room})"
        told[name].append(f"{called}: {row['n_objects']} objects, {seen[name, room]} of them seen; {why}")
    for rooms in told.values():
        rooms[SHOWN_ROOMS:] = [f"and {len(rooms) - SHOWN_ROOMS} more rooms"] if len(rooms) > SHOWN_ROOMS else []
    return {name: f"{UNASKED}: {'. '.join([*rooms, ADVICE])}" for name, rooms in told.items()}


def _explained(flow: Flow) -> str:
    """Return why a scene has no episodes: the most frequent reason why candidates were rejected or, without candidates,
    why draws failed.
    """
    # The science is needed for its words alone, and only here.
    from condvln.explorer.rejected import REASONS

    if not flow.wanted:
        return "no episodes were wanted of it"
    counts, stage = (flow.rejected, PLACING) if flow.candidates else (flow.undrawn, "programs")
    counts = Counter({reason: count for reason, count in counts.items() if reason not in SURPLUS})
    if not counts:
        return "no candidate was drawn"
    reason, count = _ranked(counts)[0]
    what = "candidates" if flow.candidates else "draws"
    return f"{reason}: {REASONS[stage][reason]} ({count:,} of {sum(counts.values()):,} {what})"


def listed(counts: Counter[str]) -> str:
    """Return the most frequent reasons with their counts, in one line."""
    return ", ".join(f"{reason} {count:,}" for reason, count in _ranked(counts)[:SHOWN_REASONS])


def _ranked(counts: Counter[str]) -> list[tuple[str, int]]:
    return sorted(counts.items(), key=lambda item: (-item[1], item[0]))
