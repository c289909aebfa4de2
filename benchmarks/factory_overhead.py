"""Overhead of the factory: planning and publishing for 10^3 to 10^5 units, and handing work to workers.

Scale is simulated: the driver plans, queues, takes receipts in, composes and publishes as ever, on a real store, while
an executor makes up the receipts; so the numbers are the driver's own. Each size runs in a fresh process, for its
memory. CONDVLN_BENCH_UNITS caps the sizes (10^5 by default). CPU seconds stand beside the clock's, since they hold on a
busy machine too. The same is measured once on an object store on loopback (moto, a process of its own), at 10^4.

Overhead is measured on real work: units that hash for a fixed number of rounds (CONDVLN_BENCH_WORK_SECONDS of them, 60
by default), after Ray is up and its workers have loaded the code. CPU seconds are those of the driver and all of Ray's
processes, so they hold on a busy machine too; the speed-up is by the clock and needs idle CPUs.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import psutil
import pyarrow as pa
from rich.console import Console
from rich.table import Table

from factory.commits import Commits
from factory.executor import Executor, InlineExecutor, Task
from factory.inventory import glance
from factory.packing import Packed, PackJob
from factory.pipeline import Pipeline, RunContext, TableSpec
from factory.ray_executor import RayExecutor
from factory.receipt import Receipt, StageReceipt, TableReceipt
from factory.run import plan, run
from factory.snapshot import Snapshot
from factory.stage import Aggregate, InputFile, Stage, StageOutput, Unit
from factory.store import LocalStore, Store, open_store
from schemas.canonical import JSON
from schemas.snapshot import PartRecord

ROWS: Final = pa.schema([pa.field("unit", pa.string(), nullable=False), pa.field("digest", pa.string())])

UNIT_SECONDS: Final = 0.25
"""CPU seconds of work per unit of the overhead measurement, about those of a small room."""


@dataclass(frozen=True)
class Burn(Stage):
    """A stage that hashes for a number of rounds and gives one row."""

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


@dataclass(frozen=True)
class Units(Aggregate):
    """How many units there are: the first pass of a pipeline, without the cost of reading any table."""

    name: str = "units"
    version: int = 1
    after: str = "burn"
    tables: tuple[str, ...] = ("rows",)

    def build(self, tables: Iterator[tuple[str, Mapping[str, pa.Table]]]) -> pa.Table:
        return pa.table({"units": [sum(1 for _ in tables)]})


class Simulated(InlineExecutor):
    """An executor that makes up the receipts that workers would return."""

    workers = 2

    def begin(self, seconds: float) -> int:
        return self.workers

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        for task in tasks:
            for item in task.work:
                made = _made(item.unit)
                key, rows = made[:16], (TableReceipt("rows", made[16:], 3, 60),)
                stage = StageReceipt(
                    "burn", key, key, key, key, key, 0.001, 1 << 20, True, False, rows, 0.001, item.unit.cost, 1
                )
                yield Receipt(
                    item.unit.unit_id,
                    item.unit.partition,
                    "ok",
                    "",
                    item.fingerprint,
                    (stage,),
                )

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        for job in jobs:
            part = PartRecord(path=job.path.split("/", 2)[2], rows=1, bytes=1, sha256="0" * 64, content=job.content)
            yield Packed(job.table, job.partition, part)


def _made(unit: Unit) -> bytes:
    """Return 32 bytes that stand for the key of a unit and the hash of its rows."""
    return hashlib.sha256(f"{unit.unit_id} {unit.inputs[0].sha256}".encode()).digest()


def pipeline(rounds: int = 0, *, first_pass: bool = False) -> Pipeline:
    """Build a pipeline with one stage and one table, and with an aggregate if there is to be a first pass."""
    return Pipeline(
        "bench",
        (Burn(rounds=rounds),),
        {"rows": TableSpec(ROWS, ("unit",))},
        aggregates=(Units(),) if first_pass else (),
    )


def units(count: int, cost: float = 0.001) -> Iterator[Unit]:
    """Yield units as a corpus lists them: one file each, a payload, varying costs."""
    for at in range(count):
        name = f"{at:08d}"
        file = InputFile(f"scenes/{name}.json", 1000 + at % 77, f"{at:064x}")
        yield Unit(
            f"corpus/{name}", "corpus", (file,), {"root": "/data", "scene": name}, {"burn": cost * (1 + at % 5 / 10)}
        )


def changed_units(count: int) -> Iterator[Unit]:
    """Yield the same units, of which each hundredth has another file."""
    for at, unit in enumerate(units(count)):
        file = unit.inputs[0]
        yield replace(unit, inputs=(replace(file, sha256=f"{count + at:064x}"),)) if at % 100 == 7 else unit


@dataclass(frozen=True)
class Scale:
    """(seconds by the clock, CPU seconds) of the jobs at one size, and the process's peak memory in bytes."""

    first: tuple[float, float]
    plan: tuple[float, float]
    rebuild: tuple[float, float]
    glance: tuple[float, float]
    changed: tuple[float, float]
    peak: int


def measure_scale(count: int, store: Store | None = None) -> Scale:
    """Measure a first run, in two passes; a plan, a rebuild and a glance (``rebuild --if-changed``) of the unchanged
    corpus; and a rebuild where 1 % of the units changed.
    """
    with tempfile.TemporaryDirectory() as folder:
        kept = store or LocalStore(folder)
        first = _timed(lambda: run(pipeline(first_pass=True), units(count), kept, executor=Simulated()))
        _fill(kept, count)
        planned = _timed(lambda: plan(pipeline(first_pass=True), units(count), kept).empty or _refuse())
        rebuilt = _timed(
            lambda: run(pipeline(first_pass=True), units(count), kept, executor=Simulated()).published and _refuse()
        )
        glanced = _timed(lambda: glance(kept, "main"))
        changed = _timed(lambda: _rebuild_changed(count, kept))
    # Of this process alone: ru_maxrss of a started process counts the memory of the one that started it.
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    peak = int(status["VmHWM"].split()[0]) * 1024
    return Scale(first, planned, rebuilt, glanced, changed, peak)


def _rebuild_changed(count: int, store: Store) -> None:
    report = run(pipeline(first_pass=True), changed_units(count), store, executor=Simulated())
    assert report.published
    assert report.counts["made"] == count // 100


def _refuse() -> bool:
    raise AssertionError("an unchanged corpus was not found unchanged")


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    """Return (wall-clock seconds, CPU seconds) of a call."""
    began, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - began, time.process_time() - cpu


def _fill(store: Store, count: int) -> None:
    """Write the files that the made-up receipts name, since a plan checks that they exist."""
    snapshot = Snapshot.open(store)
    for path in snapshot.paths("rows"):
        store.write(path, b"1")
    for unit in units(count):
        path = f"{Commits.folder('burn', _made(unit)[:16].hex())}/unit.json"
        place = store.local_path(path)
        if place is None:
            store.write(path, b"1")
        else:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(b"1")


AWAY: Final = 10**4
"""Number of units of the measurement on an object store."""


def scale(console: Console) -> None:
    """Print the table of sizes and times."""
    most = int(os.environ.get("CONDVLN_BENCH_UNITS", 10**5))
    columns = (
        "store",
        "units",
        "first run s (CPU)",
        "units/s (CPU)",
        "plan s (CPU)",
        "rebuild s (CPU)",
        "glance s (CPU)",
        "1 % changed s (CPU)",
        "driver MiB",
    )
    table = Table(*columns, title="Driver alone, simulated work")
    context = multiprocessing.get_context("spawn")
    for count in (10**3, 12_000, 10**5):
        if count > most:
            break
        with context.Pool(1) as pool:
            table.add_row("disk", *_row(count, pool.apply(measure_scale, (count,))))
    if most >= AWAY and importlib.util.find_spec("moto") is not None:
        with object_store() as store, context.Pool(1) as pool:
            table.add_row("S3", *_row(AWAY, pool.apply(measure_scale, (AWAY, store))))
    console.print(table)


def _row(count: int, found: Scale) -> tuple[str, ...]:
    return (
        f"{count:,}",
        f"{found.first[0]:.1f} ({found.first[1]:.1f})",
        f"{count / found.first[0]:,.0f} ({count / found.first[1]:,.0f})",
        f"{found.plan[0]:.2f} ({found.plan[1]:.2f})",
        f"{found.rebuild[0]:.2f} ({found.rebuild[1]:.2f})",
        f"{found.glance[0]:.2f} ({found.glance[1]:.2f})",
        f"{found.changed[0]:.2f} ({found.changed[1]:.2f})",
        f"{found.peak / 2**20:.0f}",
    )


@contextlib.contextmanager
def object_store() -> Iterator[Store]:
    """Yield an empty store on a server in its own process that speaks the S3 protocol."""
    for name, value in {"ACCESS_KEY_ID": "test", "SECRET_ACCESS_KEY": "test", "DEFAULT_REGION": "us-east-1"}.items():
        os.environ.setdefault(f"AWS_{name}", value)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            import boto3

            address = f"http://127.0.0.1:{port}"
            client = boto3.client("s3", endpoint_url=address)
            for _ in range(100):
                try:
                    client.create_bucket(Bucket="bench")
                    break
                except Exception:
                    time.sleep(0.2)
            yield open_store(f"s3://bench/store?endpoint={address}")
        finally:
            server.terminate()


def calibrate() -> int:
    """Return the rounds of hashing that take ``UNIT_SECONDS`` of CPU on this machine."""
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
    """Return (wall-clock seconds, CPU seconds) of ``count`` units."""
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
        table.add_row(f"{workers} Ray workers", *row)
    console.print(table)


def main() -> None:
    """Print both tables."""
    console = Console()
    scale(console)
    overhead(console)


if __name__ == "__main__":
    main()
