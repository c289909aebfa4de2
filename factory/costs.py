"""Cost model of units: the cost measured when the unit was last made, else the unit's own estimate, corrected by how
accurate earlier estimates were.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pyarrow as pa

from factory.index import Index
from factory.machine import slowness
from factory.pipeline import Pipeline
from factory.scratch import batches
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
        self._index = index
        self._names = tuple(stage.name for stage in pipeline.stages)
        self._sums: dict[str, dict[str, Any]] = {name: defaultdict(lambda: np.zeros(2)) for name in self._names}
        for _, batch in batches(index.rows, [name for name in index.rows.schema.names if _counts(name)]):
            self._learn(batch)
        self._scales: dict[tuple[str, str], float] = {}

    def _learn(self, batch: pa.RecordBatch) -> None:
        """Add measured CPU seconds and estimated CPU seconds of each stage to the sums of the units' partitions, and to
        those over all partitions, under the key ''.
        """
        partitions, numbers = np.unique(batch.column("partition").to_numpy(zero_copy_only=False), return_inverse=True)
        for name in self._names:
            spent, estimated = _numbers(batch, f"{name}.cpu_seconds"), _numbers(batch, f"{name}.estimate")
            both = (spent > 0) & (estimated > 0)
            self._sums[name][""] += spent[both].sum(), estimated[both].sum()
            took = np.bincount(numbers[both], spent[both], len(partitions))
            said = np.bincount(numbers[both], estimated[both], len(partitions))
            for partition, *both_sums in zip(partitions, took, said, strict=True):
                self._sums[name][str(partition)] += both_sums

    def _scale(self, stage: str, partition: str) -> float:
        known = self._scales.get((stage, partition))
        if known is None:
            known = self._slowness()
            for group in ("", partition):
                took, said = map(float, self._sums[stage].get(group, (0.0, 0.0)))
                known = (took + PRIOR_SECONDS * known) / (said + PRIOR_SECONDS)
            self._scales[stage, partition] = known
        return known

    def stage_seconds(self, unit: Unit, row: int, stage: str) -> float:
        """Return the expected CPU seconds of one stage. ``row`` is the unit's row in the published index, or -1."""
        estimate = unit.costs.get(stage, 0.0)
        spent = self._number(row, f"{stage}.cpu_seconds")
        if spent > 0:
            before = self._number(row, f"{stage}.estimate")
            return spent * estimate / before if before > 0 and estimate > 0 else spent
        return estimate * self._scale(stage, unit.partition) if estimate > 0 else 0.0

    def seconds(self, unit: Unit, row: int, first: int = 0, until: int | None = None) -> float:
        """Return the expected CPU seconds of the stages at positions ``first`` to ``until`` (all by default)."""
        return sum(self.stage_seconds(unit, row, name) for name in self._names[first:until])

    def memory(self, unit: Unit, row: int) -> int:
        """Return the expected peak memory of a unit in bytes: the peak measured when the unit was last made, with a
        margin, else the unit's own estimate.
        """
        peak = max(self._number(row, f"{name}.peak_rss") for name in self._names)
        return int(MEMORY_MARGIN * peak) if peak > 0 else unit.memory

    def _number(self, row: int, column: str) -> float:
        """Return a value of the unit in ``row``; 0 where there is none."""
        found = self._index.value(row, column) if row >= 0 else None
        return 0.0 if found is None or found != found else float(found)


def _counts(column: str) -> bool:
    return column == "partition" or column.endswith((".cpu_seconds", ".estimate"))


def _numbers(batch: pa.RecordBatch, column: str) -> Any:
    """Return a column as (rows,) float64, with 0 where it is null or missing."""
    if column not in batch.schema.names:
        return np.zeros(batch.num_rows)
    return np.nan_to_num(batch.column(column).to_numpy(zero_copy_only=False).astype(float))
