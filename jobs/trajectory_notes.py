"""Notes on the images of ``condvln trajectories``: how those of a scene are known to deviate from real views."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Final

import orjson

from factory.pipeline import Pipeline
from factory.snapshot import Snapshot
from factory.unit import Unit
from jobs.stages.trajectories import NOTES

__all__ = ["note_lines", "scene_notes"]

SHOWN: Final = 10
"""Number of different notes shown on a terminal; ``trajectories.json`` has all of them."""
NAMED: Final = 3
"""Number of scenes that a note names."""


def scene_notes(snapshot: Snapshot, pipeline: Pipeline, units: Sequence[Unit]) -> dict[str, list[str]]:
    """Return the notes of each scene that has some, by unit id, sorted."""
    found = {}
    for unit_id in sorted(unit.unit_id for unit in units):
        notes = orjson.loads(snapshot.unit_files(unit_id, pipeline).get(NOTES, b"[]"))
        if notes:
            found[unit_id] = [str(note) for note in notes]
    return found


def note_lines(notes: Mapping[str, Sequence[str]]) -> list[str]:
    """Return a sentence for each different note, the most frequent first, with the scenes that have it."""
    scenes: defaultdict[str, list[str]] = defaultdict(list)
    for unit_id, texts in notes.items():
        for text in texts:
            scenes[text].append(unit_id)
    ranked = sorted(scenes, key=lambda text: (-len(scenes[text]), text))
    lines = []
    for text in ranked[:SHOWN]:
        named = scenes[text]
        more = f" and {len(named) - NAMED:,} more scenes" if len(named) > NAMED else ""
        lines.append(f"{', '.join(named[:NAMED])}{more}: {text}")
    if len(ranked) > SHOWN:
        lines.append(f"… and {len(ranked) - SHOWN:,} more notes, see notes in trajectories.json")
    return lines
