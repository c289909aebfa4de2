"""What a unit will cost, learned from what the published ones did."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factory.index import Index
from factory.pipeline import Pipeline
from factory.unit import Unit

__all__ = ["MEMORY_MARGIN", "CostModel"]

MEMORY_MARGIN: Final = 1.25
"""Asked for above the peak that was measured: the same unit varies by some percent from run to run."""


class CostModel:
    """Seconds and bytes of units: as measured last time, else their own estimate, the seconds scaled by how right such
    estimates were in the unit's partition (or over all, for a partition that is new).
    """

    def __init__(self, index: Index, pipeline: Pipeline) -> None:
        self._seconds: Any = np.zeros(len(index))
        self._peak_rss: Any = np.zeros(len(index))
        self._scale: dict[str, float] = {}
        self._overall = 1.0
        if not len(index):
            return
        for stage in pipeline.stages:
            if f"{stage.name}.seconds" in index.table.column_names:
                self._seconds += _numbers(index, f"{stage.name}.seconds")
                self._peak_rss = np.maximum(self._peak_rss, _numbers(index, f"{stage.name}.peak_rss"))
        estimates = _numbers(index, "estimate")
        told = (estimates > 0) & (self._seconds > 0)
        if not told.any():
            return
        self._overall = float(self._seconds[told].sum() / estimates[told].sum())
        names, numbers = np.unique(index.table.column("partition").to_numpy(), return_inverse=True)
        spent = np.bincount(numbers[told], self._seconds[told], len(names))
        expected = np.bincount(numbers[told], estimates[told], len(names))
        self._scale = {str(n): float(s / e) for n, s, e in zip(names, spent, expected, strict=True) if e > 0}

    def seconds(self, unit: Unit, row: int) -> float:
        """Expected seconds of all stages; ``row`` of the index it was published in, or -1."""
        if row >= 0 and self._seconds[row] > 0:
            return float(self._seconds[row])
        return unit.cost * self._scale.get(unit.partition, self._overall)

    def memory(self, unit: Unit, row: int) -> int:
        """Expected bytes at the peak, with a margin where they were measured."""
        if row >= 0 and self._peak_rss[row] > 0:
            return int(MEMORY_MARGIN * self._peak_rss[row])
        return unit.memory


def _numbers(index: Index, column: str) -> Any:
    """(rows,) float64 of a column; 0 where it is null."""
    return np.nan_to_num(index.table.column(column).to_numpy().astype(float))
