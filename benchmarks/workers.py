"""Two workers beside one, and how much two processes that share nothing do beside one on this machine.

Real scenes of a family run from an empty store to published tables, with one worker and with two. Then half of the
scenes run in one process, and beside it the other half in another. What the two halves take one after the other,
divided by what they take side by side, is what the machine allows.

CONDVLN_BENCH_FAMILIES (``procthor``), CONDVLN_BENCH_SCENES (60, spread evenly) and CONDVLN_BENCH_CATEGORY (160 episodes
a category, more than two minutes for one worker) say what is run. One worker is this process, two are Ray's, whose
start is included. Nothing else should run meanwhile.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from rich.console import Console
from rich.table import Table

from benchmarks.costs import real_families
from jobs.generate import run_generate
from jobs.pipeline import list_units
from jobs.workspace import file_hashes, hasher, published
from schemas.config import Config, Family, InstructionsConfig, RayConfig, SourceConfig
from schemas.config.run import SplitsConfig
from schemas.program import CATEGORIES

__all__ = ["main"]


@dataclass
class _Run:
    """What a run took.

    seconds : by the clock, the start of the workers included
    stages : seconds of the stages by the clock, added up over the workers
    driver : CPU seconds of the process that handed out the work, if another did it
    """

    episodes: int
    seconds: float
    stages: float
    driver: float


def _configured(family: Family, root: Path, folder: Path, asked: int, scenes: Sequence[str] = ("*",)) -> Config:
    return Config(
        name=family,
        store=str(folder),
        sources=(SourceConfig(family=family, root=root, scenes=tuple(scenes)),),
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, asked)),
        splits=SplitsConfig(bias="warn"),
    )


def _run(config: Config, workers: int) -> _Run:
    """Run a configuration from an empty store with Ray workers, or in this process (0, 1)."""
    config = config.model_copy(update={"ray": RayConfig(workers=workers or None, address="local")})
    began, cpu = time.perf_counter(), time.process_time()
    report = run_generate(config, inline=not workers, console=Console(quiet=True))
    seconds, driver = time.perf_counter() - began, time.process_time() - cpu
    assert not report.exit_code, report.lines
    episodes = published(config).manifest.tables["episodes"].rows
    return _Run(episodes, seconds, sum(report.document["stage_seconds"].values()), driver)


def _side_by_side(configs: Sequence[Config], at_once: int) -> float:
    """Return the seconds by the clock in which processes of their own, so many at once, run these configurations."""
    with ProcessPoolExecutor(at_once, mp_context=multiprocessing.get_context("spawn")) as pool:
        list(pool.map(_load, range(at_once)))
        began = time.perf_counter()
        list(pool.map(_run, configs, [0] * len(configs)))
        return time.perf_counter() - began


def _load(number: int) -> None:
    importlib.import_module("jobs.generate")
    time.sleep(1)  # so that each process of the pool gets one


def main() -> None:
    """Print what one worker, two workers, and two processes that share nothing take."""
    scenes = int(os.environ.get("CONDVLN_BENCH_SCENES", "60"))
    asked = int(os.environ.get("CONDVLN_BENCH_CATEGORY", "160"))
    table = Table(title=f"{scenes} scenes, {asked} episodes a category")
    columns = ("family", "run", "episodes", "s", "s of stages", "CPU s of the driver", "× one")
    for column in columns:
        table.add_column(column, justify="right")
    real = real_families()
    chosen = os.environ.get("CONDVLN_BENCH_FAMILIES", "procthor").split(",")
    for family in [family for family in get_args(Family) if family in chosen]:
        if family not in real:
            raise SystemExit(f"{family}: its real scenes are not here")
        root = real[family]
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            config = _configured(family, root, folder / "all", asked)
            units = list_units(config, hasher(file_hashes(config)))
            ids = [unit.unit_id.partition("/")[2] for unit in units]
            ids = [ids[at * len(ids) // scenes] for at in range(scenes)] if len(ids) > scenes else ids
            runs = {
                workers: _run(_configured(family, root, folder / str(workers), asked, ids), workers)
                for workers in (1, 2)
            }
            for workers, run in runs.items():
                ratio = f"{runs[1].seconds / run.seconds:.2f}"
                cells = (f"{run.seconds:.1f}", f"{run.stages:.1f}", f"{run.driver:.1f}", ratio)
                table.add_row(family, f"{workers} workers", str(run.episodes), *cells)
            halves = {
                at_once: _side_by_side(
                    [_configured(family, root, folder / f"{at_once}-{k}", asked, ids[k::2]) for k in range(2)], at_once
                )
                for at_once in (1, 2)
            }
            for at_once, seconds in halves.items():
                said = "two halves, " + ("one after the other", "side by side")[at_once - 1]
                table.add_row(family, said, "", f"{seconds:.1f}", "", "", f"{halves[1] / seconds:.2f}")
    Console(width=150).print(table)


if __name__ == "__main__":
    main()
