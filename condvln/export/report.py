"""The report of an export: what was written, what was left out and why. Stored as ``export.json``, written last."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from condvln.bias import BiasReport
from condvln.bias.report import fields_of
from condvln.export.selection import SelectionCell
from schemas.base import SCHEMA_VERSION

__all__ = ["CardPicture", "ExportReport", "WrittenFile"]


SMALL_SPLIT: Final = 0.05
"""A split with less than this share of the largest split's episodes is reported as lopsided."""

FEW_SCENES: Final = 5
"""A split with fewer scenes than this is reported if another one has at least twice as many."""

THIN_CATEGORY: Final = 0.25
"""A category is reported if its part of a split is less than this share of its part of all episodes."""


def _sums(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    found: Counter[str] = Counter()
    for one in counts:
        found.update(one)
    return dict(found)


@dataclass(frozen=True)
class WrittenFile:
    """One file of the export: its size in bytes and its SHA-256."""

    bytes: int
    sha256: str


@dataclass(frozen=True)
class CardPicture:
    """A picture of the dataset card: its path below the export's folder, its caption, and the bytes of the file."""

    path: str
    caption: str
    data: bytes


@dataclass
class ExportReport:
    """The counts and settings of one export."""

    snapshot: str
    texts: dict[str, Any] = field(default_factory=dict)
    """The settings with which the texts were rendered; ``condvln export --oracle`` reuses them."""
    episodes: dict[str, int] = field(default_factory=dict)
    scenes: dict[str, list[str]] = field(default_factory=dict)
    """Scenes of each split, as ``<source>/<scene>``."""
    cells: list[SelectionCell] = field(default_factory=list)
    left_out: dict[str, int] = field(default_factory=dict)
    """Number of the pool's episodes that are in no split, by reason."""
    lost: dict[str, dict[str, int]] = field(default_factory=dict)
    """The same by category and reason."""
    empty_splits: dict[str, str] = field(default_factory=dict)
    """Requested splits without episodes, with the reason."""
    truth_imbalance: dict[str, float] = field(default_factory=dict)
    """Imbalance by source: 0 if conditions on a label in a room type are true as often as false, 1 if the label
    determines the truth.
    """
    shapes: dict[str, dict[str, dict[str, int]]] = field(default_factory=dict)
    """Number of episodes by split, axis and value."""
    examples: dict[str, tuple[int, str]] = field(default_factory=dict)
    """For each category the episode of the least id, and its text."""
    pictures: dict[str, str] = field(default_factory=dict)
    """Captions of the card's pictures by path."""
    most_steps: int = 0
    """Largest step budget of an episode; of all episodes if the configuration sets one number."""
    least_steps: int = 0
    """Smallest step budget of an episode."""
    looking_left_out: int = 0
    """Number of episodes without a looking path, which are in no file of looking paths."""
    r2r_episodes: int = 0
    r2r_left_out: dict[str, int] = field(default_factory=dict)
    """Number of Matterport3D episodes that are not possible on the graph, by reason."""
    vocabulary: int = 0
    texts_cut: int = 0
    """Number of texts that are truncated to the kept tokens; ``instruction_text`` is complete."""
    bias: BiasReport | None = None
    """The bias gate's report; None if the gate was not run."""
    files: dict[str, WrittenFile] = field(default_factory=dict)
    """Files by path below the export's folder."""

    @property
    def language(self) -> str:
        """Language code of the texts."""
        return str(self.texts.get("language", "en"))

    @property
    def shortfalls(self) -> list[SelectionCell]:
        """Cells with fewer episodes than wanted."""
        return [cell for cell in self.cells if cell.shortfall]

    @property
    def lopsided(self) -> dict[str, str]:
        """The splits that have too few episodes or scenes compared with the others, each with a description of what it
        lacks.
        """
        largest = max(self.episodes.values(), default=0)
        total = sum(self.episodes.values())
        categories = _sums(found.get("category", {}) for found in self.shapes.values())
        most_scenes = max((len(scenes) for scenes in self.scenes.values()), default=0)
        told = {}
        for split, count in self.episodes.items():
            if not count or count == largest:
                continue
            own = self.shapes.get(split, {}).get("category", {})
            scenes = len(self.scenes[split])
            odd = []
            if count < SMALL_SPLIT * largest:
                odd.append(f"{count:,} episodes where the largest split has {largest:,}")
            if scenes < FEW_SCENES <= most_scenes / 2:
                odd.append(f"{scenes} scenes where another split has {most_scenes:,}")
            missing = [name for name in categories if not own.get(name)]
            if missing:
                odd.append(f"no {', no '.join(missing)}")
            for name, held in own.items():
                if held > count / 2 and held / count > 2 * categories[name] / total:
                    odd.append(f"{held:,} of them {name}")
                elif 0 < held < THIN_CATEGORY * count * categories[name] / total:
                    odd.append(f"only {held:,} of its {count:,} episodes are {name}")
            if odd:
                told[split] = "; ".join(odd)
        return told

    def document(self) -> dict[str, Any]:
        """Return the report as JSON; equal exports give equal documents."""
        cells = [{**fields_of(cell), "shortfall": cell.shortfall} for cell in self.cells]
        return {
            "schema_version": SCHEMA_VERSION,
            **{key: value for key, value in fields_of(self).items() if key not in ("cells", "files", "bias")},
            "lopsided_splits": self.lopsided,
            "bias": None if self.bias is None else self.bias.document(),
            "cells": cells,
            "files": {path: fields_of(self.files[path]) for path in sorted(self.files)},
        }
