"""CPU seconds of first runs, and coefficients of the cost model (``jobs/costs.py``) that fit them.

Each family's real scenes (CONDVLN_REAL_DATA, or ``shared/data`` beside the checkout) run inline from an empty store,
kernels warm, once for each number of episodes asked. Each stage's CPU seconds are fitted by non-negative least squares
on the counts that are known before a run. CONDVLN_BENCH_SCENES bounds the scenes of a family (24, spread evenly).
"""

from __future__ import annotations

import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import nnls

from condvln.sources.source import SceneCounts
from factory.executor import InlineExecutor
from factory.index import Index
from factory.planner import CostModel
from factory.receipt import Receipt
from factory.report import Progress
from factory.run import run
from factory.stage import Unit
from factory.store import LocalStore
from jobs.costs import COEFFICIENTS, STAGES, counts_of
from jobs.pipeline import build_pipeline, list_units, open_configured
from jobs.workspace import file_hashes, hasher
from schemas.config import Config, InstructionsConfig, SourceConfig
from schemas.program import CATEGORIES

__all__ = ["FirstRun", "first_run", "real_families"]

ASKED = (4, 12, 24)
"""Episodes per category for which the coefficients are fitted."""


@dataclass
class FirstRun:
    """The first run of one family, from an empty store.

    estimate : CPU seconds expected before it began
    seconds : CPU seconds of the whole process, planning and publishing included
    stages : by stage, (unit, its CPU seconds)
    """

    family: str
    units: list[Unit]
    counts: Mapping[str, SceneCounts]
    estimate: float = 0.0
    seconds: float = 0.0
    expected: dict[str, float] = field(default_factory=dict)
    stages: dict[str, list[tuple[str, float]]] = field(default_factory=lambda: defaultdict(list))

    def spent(self, *stages: str) -> float:
        """Return the CPU seconds that stages took."""
        return sum(seconds for stage in stages for _, seconds in self.stages[stage])

    def ratio(self, *stages: str) -> float:
        """Return the estimate of stages over the CPU seconds that they took; NaN where they took none."""
        spent = self.spent(*stages)
        return sum(self.expected[stage] for stage in stages) / spent if spent else float("nan")


class _Listener(Progress):
    def __init__(self, found: FirstRun) -> None:
        self._found = found

    def unit(self, receipt: Receipt) -> None:
        for stage in receipt.stages:
            if stage.made:
                self._found.stages[stage.stage].append((receipt.unit_id, stage.cpu_seconds))


def real_families() -> dict[str, Path]:
    """Return the folder of each family's real scenes that is present."""
    data = Path(os.environ.get("CONDVLN_REAL_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    return {family: data / family for family in COEFFICIENTS if (data / family).is_dir()}


def first_run(family: str, root: Path, asked: int, folder: Path, scenes: int) -> FirstRun:
    """Run `scenes` scenes of a family, spread evenly, from an empty store in `folder`.

    asked : episodes asked of each category
    """
    config = Config(
        name="costs",
        store=folder / f"{family}-{asked}",
        sources=(SourceConfig(family=family, root=root),),
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, asked)),
    )
    hashes = hasher(file_hashes(config))
    units = list_units(config, hashes)
    units = [units[at * len(units) // scenes] for at in range(scenes)] if len(units) > scenes else units
    handles = open_configured(config, config.sources[0], hashes).handles()
    found = FirstRun(family, units, {f"{family}/{h.scene_id}": h.counts for h in handles})
    pipeline = build_pipeline(config)
    model = CostModel(Index.empty(pipeline), pipeline)
    found.expected = {s.name: sum(model.stage_seconds(u, -1, s.name) for u in units) for s in pipeline.stages}
    found.estimate = sum(found.expected.values())
    began = time.process_time()
    run(pipeline, units, LocalStore(folder / f"{family}-{asked}"), "costs", InlineExecutor(), progress=_Listener(found))
    found.seconds = time.process_time() - began
    return found


def _fit(runs: Iterable[tuple[int, FirstRun]], stage: str) -> tuple[list[float], int]:
    """Return (coefficients, scenes) of one stage, in CPU seconds of this machine."""
    rows, spent = [], []
    for asked, found in runs:
        for unit_id, seconds in found.stages[stage]:
            counts = counts_of(found.family, found.counts[unit_id], asked)
            rows.append([counts[name] for name in COEFFICIENTS[found.family][stage]])
            spent.append(seconds)
    if not rows:
        return [], 0
    found_coefficients, _ = nnls(np.array(rows), np.array(spent))
    return [float(value) for value in found_coefficients], len(rows)


def main() -> None:
    """Print the estimates of the first runs beside the CPU seconds that they took, and the fitted coefficients beside
    those in use.
    """
    console = Console(width=160)
    scenes = int(os.environ.get("CONDVLN_BENCH_SCENES", "24"))
    judged = Table(title="Estimates before the first run ÷ CPU seconds that its stages took")
    for column in ("family", "a category", "CPU s", "all stages", *STAGES):
        judged.add_column(column)
    table = Table(title="CPU seconds for one of each count")
    for column in ("family", "stage", "counts", "fitted here", "in use", "scenes"):
        table.add_column(column)
    with tempfile.TemporaryDirectory() as name:
        for family, root in real_families().items():
            first_run(family, root, ASKED[0], Path(name) / "kernels", 1)  # compiles and loads kernels
            runs = [
                (len(CATEGORIES) * asked + 8, first_run(family, root, asked, Path(name), scenes)) for asked in ASKED
            ]
            for asked, (_, found) in zip(ASKED, runs, strict=True):
                ratios = [f"{found.ratio(*stages):.2f}" for stages in (STAGES, *([stage] for stage in STAGES))]
                judged.add_row(family, str(asked), f"{found.spent(*STAGES):.1f}", *ratios)
            for stage, counted in COEFFICIENTS[family].items():
                fitted, count = _fit(runs, stage)
                numbers = (", ".join(f"{value:.4f}" for value in values) for values in (fitted, counted.values()))
                table.add_row(family, stage, ", ".join(counted), *numbers, str(count))
    console.print(judged)
    console.print(table)
