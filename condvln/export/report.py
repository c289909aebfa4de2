"""What an export wrote, what it left out and why; stands in the export as ``export.json``, written last."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from condvln.bias import BiasReport
from condvln.export.selection import SelectionCell
from schemas.version import SCHEMA_VERSION

__all__ = ["ExportReport", "WrittenFile"]


SMALL_SPLIT: Final = 0.05
"""A split with less than this share of the largest one's episodes is named."""

FEW_SCENES: Final = 5
"""Fewer scenes than these are named, where another split has twice as many at least."""


def _sums(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    found: Counter[str] = Counter()
    for one in counts:
        found.update(one)
    return dict(found)


@dataclass(frozen=True)
class WrittenFile:
    """One file of the export: its size on disk and the hash of its bytes."""

    bytes: int
    sha256: str


@dataclass
class ExportReport:
    """Counts of one export."""

    snapshot: str
    texts: dict[str, Any] = field(default_factory=dict)
    """What the texts were rendered with, so that ``condvln oracle`` finds the same words again."""
    episodes: dict[str, int] = field(default_factory=dict)
    scenes: dict[str, list[str]] = field(default_factory=dict)
    """By split, ``<source>/<scene>``."""
    cells: list[SelectionCell] = field(default_factory=list)
    left_out: dict[str, int] = field(default_factory=dict)
    """Episodes of the pool in no split, by reason."""
    empty_splits: dict[str, str] = field(default_factory=dict)
    """Splits that were asked for and have no episode, with the reason."""
    truth_imbalance: dict[str, float] = field(default_factory=dict)
    """By source: 0 = conditions on a label in a room type are true as often as false; 1 = the label gives it away."""
    shapes: dict[str, dict[str, dict[str, int]]] = field(default_factory=dict)
    """Episodes by split, axis and value."""
    examples: dict[str, tuple[int, str]] = field(default_factory=dict)
    """By category the episode of the least id, and its text."""
    most_steps: int = 0
    """Largest step budget of an episode, and of all where the configuration sets one number."""
    least_steps: int = 0
    """Smallest one."""
    r2r_episodes: int = 0
    r2r_left_out: dict[str, int] = field(default_factory=dict)
    """Episodes of Matterport3D scans that mean nothing on the graph, by reason."""
    vocabulary: int = 0
    texts_cut: int = 0
    """Texts with more tokens than are kept; ``instruction_text`` is whole."""
    bias: BiasReport | None = None
    """Whether a guess beats chance; None where nobody asked."""
    files: dict[str, WrittenFile] = field(default_factory=dict)
    """By path below the export's folder."""

    @property
    def language(self) -> str:
        """Code of the language of the texts."""
        return str(self.texts.get("language", "en"))

    @property
    def shortfalls(self) -> list[SelectionCell]:
        """Cells with fewer episodes than were wanted."""
        return [cell for cell in self.cells if cell.shortfall]

    @property
    def lopsided(self) -> dict[str, str]:
        """Splits that could not be filled as the others are, with what is odd about each."""
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
            if odd:
                told[split] = "; ".join(odd)
        return told

    def document(self) -> dict[str, Any]:
        """The report as JSON; the same export gives the same document."""
        cells = [{**asdict(cell), "shortfall": cell.shortfall} for cell in self.cells]
        return {
            "schema_version": SCHEMA_VERSION,
            **{key: value for key, value in asdict(self).items() if key not in ("cells", "files", "bias")},
            "lopsided_splits": self.lopsided,
            "bias": None if self.bias is None else self.bias.document(),
            "cells": cells,
            "files": {path: asdict(self.files[path]) for path in sorted(self.files)},
        }
