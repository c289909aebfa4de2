"""What the factory itself costs: planning and publishing from 10^3 to 10^6 units, and handing work to Ray.

Scale is simulated: the driver plans, queues, takes receipts in, composes and publishes as ever, on a real store, while
an executor makes up the receipts; so the numbers are the driver's own. Each size runs in a fresh process, for its
memory. CONDVLN_BENCH_UNITS caps the sizes (10^6 by default).

Overhead is measured on real work: units that hash for a fixed number of rounds (CONDVLN_BENCH_WORK_SECONDS of them, 60
by default), after Ray is up and its workers have loaded the code. CPU seconds are those of the driver and all of Ray's
processes, so they hold on a busy machine too; the speed-up is by the clock and needs idle CPUs.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import resource
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import psutil
import pyarrow as pa
from rich.console import Console
from rich.table import Table

from factory import (
    InlineExecutor,
    InputFile,
    LocalStore,
    Pipeline,
    Stage,
    StageOutput,
    Store,
    TableSpec,
    Unit,
    plan,
    run,
)
from factory.context import RunContext
from factory.executor import Executor, Task
from factory.packing import Packed, PackJob
from factory.ray_executor import RayExecutor
from factory.receipt import Receipt, StageReceipt, TableReceipt
from schemas.canonical import JSON
from schemas.snapshot import PartRecord

ROWS: Final = pa.schema([pa.field("unit", pa.string(), nullable=False), pa.field("digest", pa.string())])

UNIT_SECONDS: Final = 0.25
"""Work of one unit of the overhead measurement, about that of a small room."""


@dataclass(frozen=True)
class Burn(Stage):
    """Hashes for a number of rounds; one row."""

    name: str = "burn"
    version: int = 1
    tables: tuple[str, ...] = ("rows",)
    rounds: int = 0

    def parameters(self, unit: Unit) -> JSON:
        return None

    def run(self, unit: Unit, upstream: Mapping[str, pa.Table], shared: Mapping[str, pa.Table]) -> StageOutput:
        data = unit.unit_id.encode()
        for _ in range(self.rounds):
            data = hashlib.sha256(data).digest()
        return StageOutput({"rows": pa.table({"unit": [unit.unit_id], "digest": [data.hex()]}, schema=ROWS)})


class Simulated:
    """Makes up what workers would hand back."""

    workers = 2

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        for task in tasks:
            for item in task.work:
                made = hashlib.sha256(item.unit.unit_id.encode()).digest()
                key, rows = made[:16], (TableReceipt("rows", made[16:], 3, 60),)
                stage = StageReceipt("burn", key, key, key, key, key, 0.001, 1 << 20, True, False, rows)
                yield Receipt(
                    item.unit.unit_id,
                    item.unit.partition,
                    "ok",
                    "",
                    item.fingerprint,
                    (stage,),
                    estimate=item.unit.cost,
                )

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        for job in jobs:
            part = PartRecord(path=job.path.split("/", 2)[2], rows=1, bytes=1, sha256="0" * 64, content=job.content)
            yield Packed(job.table, job.partition, part)


def pipeline(rounds: int = 0) -> Pipeline:
    """One stage, one table."""
    return Pipeline("bench", (Burn(rounds=rounds),), {"rows": TableSpec(ROWS, ("unit",), "burn")})


def units(count: int, cost: float = 0.001) -> Iterator[Unit]:
    """Units as a corpus lists them: one file each, a payload, costs that vary."""
    for at in range(count):
        name = f"{at:08d}"
        file = InputFile(f"scenes/{name}.json", 1000 + at % 77, f"{at:064x}")
        yield Unit(f"corpus/{name}", "corpus", (file,), {"root": "/data", "scene": name}, cost * (1 + at % 5 / 10))


@dataclass(frozen=True)
class Scale:
    """Seconds of the three jobs at one size, and the peak memory of the process in bytes."""

    first: float
    plan: float
    rebuild: float
    peak: int


def measure_scale(count: int, store: Store | None = None) -> Scale:
    """A first run, a plan and a rebuild of the unchanged corpus."""
    with tempfile.TemporaryDirectory() as folder:
        kept = store or LocalStore(folder)
        seconds = []
        started = time.perf_counter()
        run(pipeline(), units(count), kept, executor=Simulated())
        seconds.append(time.perf_counter() - started)
        started = time.perf_counter()
        assert plan(pipeline(), units(count), kept).empty
        seconds.append(time.perf_counter() - started)
        started = time.perf_counter()
        assert not run(pipeline(), units(count), kept, executor=Simulated()).published
        seconds.append(time.perf_counter() - started)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return Scale(seconds[0], seconds[1], seconds[2], peak)


def scale(console: Console) -> None:
    """Print the curve."""
    most = int(os.environ.get("CONDVLN_BENCH_UNITS", 10**6))
    table = Table(
        "units", "first run s", "units/s", "plan s", "rebuild s", "driver MiB", title="Driver alone, simulated work"
    )
    context = multiprocessing.get_context("spawn")
    for count in (10**3, 10**4, 10**5, 10**6):
        if count > most:
            break
        with context.Pool(1) as pool:
            found = pool.apply(measure_scale, (count,))
        table.add_row(
            f"{count:,}",
            f"{found.first:.1f}",
            f"{count / found.first:,.0f}",
            f"{found.plan:.2f}",
            f"{found.rebuild:.2f}",
            f"{found.peak / 2**20:.0f}",
        )
    console.print(table)


def calibrate() -> int:
    """Rounds of hashing that make ``UNIT_SECONDS`` of CPU here."""
    rounds = 200_000
    started = time.process_time()
    Burn(rounds=rounds).run(next(units(1)), {}, {})
    return int(rounds * UNIT_SECONDS / (time.process_time() - started))


def cpu_seconds() -> float:
    """CPU seconds of this process and all its children so far."""
    total = 0.0
    own = psutil.Process()
    for process in [own, *own.children(recursive=True)]:
        try:
            times = process.cpu_times()
            total += times.user + times.system
        except psutil.NoSuchProcess:
            continue
    return total


def measure_overhead(executor: Executor, count: int, rounds: int) -> tuple[float, float]:
    """(seconds by the clock, CPU seconds) of ``count`` units."""
    with tempfile.TemporaryDirectory() as folder:
        # Workers start, and import what they need, on a few units of another store.
        run(pipeline(rounds // 10), units(8), LocalStore(Path(folder) / "warm"), executor=executor)
        clock, cpu = time.perf_counter(), cpu_seconds()
        run(pipeline(rounds), units(count, UNIT_SECONDS), LocalStore(Path(folder) / "store"), executor=executor)
        return time.perf_counter() - clock, cpu_seconds() - cpu


def overhead(console: Console) -> None:
    """Print inline, one worker, two workers, and their ratios."""
    rounds = calibrate()
    count = max(8, int(float(os.environ.get("CONDVLN_BENCH_WORK_SECONDS", 60)) / UNIT_SECONDS))
    table = Table("way", "s", "CPU s", "CPU / inline", "speed / 1 worker", title=f"{count} units of {UNIT_SECONDS} s")
    inline = measure_overhead(InlineExecutor(), count, rounds)
    table.add_row("inline", f"{inline[0]:.1f}", f"{inline[1]:.1f}", "1.00", "")
    alone = 0.0
    for workers in (1, 2):
        with RayExecutor(workers=workers) as executor:
            clock, cpu = measure_overhead(executor, count, rounds)
        alone = alone or clock
        row = (f"{clock:.1f}", f"{cpu:.1f}", f"{cpu / inline[1]:.2f}", f"{alone / clock:.2f}")
        table.add_row(f"{workers} worker{'s' * (workers > 1)}", *row)
    console.print(table)


def main() -> None:
    """Print both tables."""
    console = Console()
    scale(console)
    overhead(console)


if __name__ == "__main__":
    main()
