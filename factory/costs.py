"""Cost model of units: the cost measured when the unit was last made, else the unit's own estimate, corrected by how
accurate earlier estimates were.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from factory.index import Index
from factory.machine import slowness
from factory.pipeline import Pipeline
from factory.unit import Unit

__all__ = ["MEMORY_MARGIN", "PRIOR_SECONDS", "CostModel"]

MEMORY_MARGIN: Final = 1.25
"""Factor on the measured peak memory when memory is requested: the same unit varies by some percent from run to run."""

PRIOR_SECONDS: Final = 1.0
"""Weight of the prior in CPU seconds of receipts: a stage's scale changes little until that much work is measured."""


class CostModel:
    """Expected CPU seconds of each stage of a unit, and expected peak memory of units.

    A stage that was published for a unit is expected to take what it took then, times the ratio of its estimates now
    and then (more episodes are asked for, say). Any other is expected to take its own estimate times a scale: CPU
    seconds over estimates of that stage in the unit's partition, drawn towards that over all partitions, and this one
    towards the slowness of the machine, each by ``PRIOR_SECONDS``. So a first run goes by estimates and a probe of
    the machine, and every receipt makes the next estimate better.

    slowness : CPU seconds on this machine for one of the reference machine; asked only where an estimate is used
    """

    def __init__(self, index: Index, pipeline: Pipeline, slowness: Callable[[], float] = slowness) -> None:
        self._slowness = slowness
        self._names = tuple(stage.name for stage in pipeline.stages)
        self._spent = {name: _numbers(index, f"{name}.cpu_seconds") for name in self._names}
        self._estimated = {name: _numbers(index, f"{name}.estimate") for name in self._names}
        self._peak_rss: Any = np.zeros(len(index))
        for name in self._names:
            self._peak_rss = np.maximum(self._peak_rss, _numbers(index, f"{name}.peak_rss"))
        self._sums: dict[str, dict[str, tuple[float, float]]] = {}
        if len(index):
            partitions, numbers = np.unique(index.table.column("partition").to_numpy(), return_inverse=True)
            self._sums = {name: self._learned(name, [str(p) for p in partitions], numbers) for name in self._names}
        self._scales: dict[tuple[str, str], float] = {}

    def _learned(self, stage: str, partitions: list[str], numbers: Any) -> dict[str, tuple[float, float]]:
        """Return, by partition, (measured CPU seconds, estimated CPU seconds) of a stage, summed over the units of the
        partition. Under the key '' are the sums over all partitions.
        """
        spent, estimated = self._spent[stage], self._estimated[stage]
        both = (spent > 0) & (estimated > 0)
        sums = {"": (float(spent[both].sum()), float(estimated[both].sum()))}
        took = np.bincount(numbers[both], spent[both], len(partitions))
        said = np.bincount(numbers[both], estimated[both], len(partitions))
        return sums | {p: (float(t), float(s)) for p, t, s in zip(partitions, took, said, strict=True)}

    def _scale(self, stage: str, partition: str) -> float:
        known = self._scales.get((stage, partition))
        if known is None:
            known = self._slowness()
            for group in ("", partition):
                took, said = self._sums.get(stage, {}).get(group, (0.0, 0.0))
                known = (took + PRIOR_SECONDS * known) / (said + PRIOR_SECONDS)
            self._scales[stage, partition] = known
        return known

    def stage_seconds(self, unit: Unit, row: int, stage: str) -> float:
        """Return the expected CPU seconds of one stage. ``row`` is the unit's row in the published index, or -1."""
        estimate = unit.costs.get(stage, 0.0)
        spent = float(self._spent[stage][row]) if row >= 0 else 0.0
        if spent > 0:
            before = float(self._estimated[stage][row])
            return spent * estimate / before if before > 0 and estimate > 0 else spent
        return estimate * self._scale(stage, unit.partition) if estimate > 0 else 0.0

    def seconds(self, unit: Unit, row: int, first: int = 0, until: int | None = None) -> float:
        """Return the expected CPU seconds of the stages at positions ``first`` to ``until`` (all by default)."""
        return sum(self.stage_seconds(unit, row, name) for name in self._names[first:until])

    def memory(self, unit: Unit, row: int) -> int:
        """Return the expected peak memory of a unit in bytes: the peak measured when the unit was last made, with a
        margin, else the unit's own estimate.
        """
        if row >= 0 and self._peak_rss[row] > 0:
            return int(MEMORY_MARGIN * self._peak_rss[row])
        return unit.memory


def _numbers(index: Index, column: str) -> Any:
    """Return a column as (rows,) float64, with 0 where it is null or missing."""
    if column not in index.table.column_names:
        return np.zeros(len(index))
    return np.nan_to_num(index.table.column(column).to_numpy().astype(float))
