"""Estimates of first runs and their measured cost, then episodes per second from scene files to tables, inline and with
Ray.

Estimates: the real scenes of each family (CONDVLN_REAL_DATA, or ``shared/data`` beside the checkout; all of them, or
CONDVLN_BENCH_REAL_SCENES of each) run inline from an empty store, kernels warm. CPU seconds of the whole process are
printed beside what the plan said.

Throughput: the work is made apartments (CONDVLN_BENCH_SCENES of them, 60 by default), or a configuration named by
CONDVLN_BENCH_CONFIG. Ray is up and its workers have loaded the code before the clock starts.
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.costs import first_run, real_families
from condvln.samples import make_samples
from factory.executor import Executor, InlineExecutor
from factory.ray_executor import RayExecutor
from factory.run import run
from factory.snapshot import Snapshot
from factory.store import LocalStore
from jobs.configuration import load_config
from jobs.pipeline import build_pipeline, list_units
from jobs.workspace import file_hashes, hasher
from schemas.config import Config, SourceConfig

EPISODES_A_CATEGORY = 12
"""Episodes per category in the shipped configurations."""


def _configuration(folder: Path) -> Config:
    named = os.environ.get("CONDVLN_BENCH_CONFIG")
    if named:
        return load_config(Path(named), [f"store={folder / 'store'}"])
    scenes = int(os.environ.get("CONDVLN_BENCH_SCENES", "60"))
    make_samples(folder / "scenes", family="replicacad", scenes=scenes, seed=1)
    return Config(
        name="bench", store=folder / "store", sources=(SourceConfig(family="replicacad", root=folder / "scenes"),)
    )


def estimates(console: Console) -> None:
    """Print the estimate and the measurement of each family's first run, side by side."""
    families = real_families()
    if not families:
        console.print("no real scenes here: estimates are not compared (set CONDVLN_REAL_DATA)")
        return
    scenes = int(os.environ.get("CONDVLN_BENCH_REAL_SCENES", "1000000"))
    table = Table(title="first runs, CPU seconds")
    for column in ("family", "scenes", "estimate", "measured", "measured ÷ estimate", "by stage (estimate → measured)"):
        table.add_column(column, justify="right")
    with tempfile.TemporaryDirectory() as name:
        for family, root in families.items():
            first_run(family, root, EPISODES_A_CATEGORY, Path(name) / "kernels", 1)  # compiles and loads kernels
            found = first_run(family, root, EPISODES_A_CATEGORY, Path(name), scenes)
            stages = ", ".join(
                f"{stage} {seconds:.1f} → {sum(spent for _, spent in found.stages[stage]):.1f}"
                for stage, seconds in found.expected.items()
            )
            ratio = f"{found.seconds / found.estimate:.2f}"
            table.add_row(family, str(len(found.units)), f"{found.estimate:.1f}", f"{found.seconds:.1f}", ratio, stages)
    console.print(table)


def main() -> None:
    """Print the estimates, one row per way of running, and the ratios."""
    console = Console(width=160)
    estimates(console)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = _configuration(folder)
        units = list_units(config, hasher(file_hashes(config)))
        pipeline = build_pipeline(config)
        rows = []
        ways: list[tuple[str, Executor | RayExecutor]] = [
            ("inline", InlineExecutor()),
            ("1 worker", RayExecutor(workers=1)),
            ("2 workers", RayExecutor(workers=2)),
        ]
        for label, executor in ways:
            if isinstance(executor, RayExecutor):
                executor.start()
                # A few units in a store of their own, so that every worker has imported and loaded its kernels.
                run(pipeline, units[:4], LocalStore(folder / f"warm {label}"), "bench", executor)
            store = LocalStore(folder / label)
            began, cpu = time.perf_counter(), time.process_time()
            report = run(pipeline, units, store, "bench", executor)
            seconds, driver_cpu = time.perf_counter() - began, time.process_time() - cpu
            if isinstance(executor, RayExecutor):
                executor.close()
            episodes = Snapshot.open(store, "bench").manifest.tables["episodes"].rows
            driver = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            rows.append(
                (label, seconds, episodes, report.snapshot_id or "", report.peak_rss / 2**20, driver, driver_cpu)
            )
    table = Table(title=f"{len(units)} scenes, scene files to published tables")
    for column in ("way", "seconds", "episodes", "episodes/s", "worker peak MiB", "driver peak MiB", "snapshot"):
        table.add_column(column, justify="right")
    for label, seconds, episodes, snapshot, worker, driver, _ in rows:
        table.add_row(
            label,
            f"{seconds:.1f}",
            f"{episodes}",
            f"{episodes / seconds:.1f}",
            f"{worker:.0f}",
            f"{driver:.0f}",
            snapshot[:12],
        )
    console.print(table)
    inline, one, two = (row[1] for row in rows)
    console.print(f"one worker takes {one / inline:.2f} × inline; two workers are {one / two:.2f} × one")
    if len({row[3] for row in rows}) != 1:
        raise SystemExit("the snapshots differ")
