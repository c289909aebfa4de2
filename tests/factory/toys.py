"""Toy pipelines of arithmetic: the factory knows nothing of scenes, and neither do its tests.

Imported by path (``toys`` is put on ``sys.path`` by conftest), so that Ray's workers can unpickle what is here.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from factory.pipeline import Pipeline, TableSpec
from factory.stage import Aggregate, InputFile, Stage, StageOutput, Unit
from factory.store import LocalStore
from schemas.canonical import JSON
from schemas.errors import FormatError, TransientIOError

NUMBERS = pa.schema([pa.field("unit", pa.string(), nullable=False), pa.field("n", pa.int64(), nullable=False)])
STATES = pa.schema(
    [pa.field("unit", pa.string(), nullable=False), pa.field("status", pa.string()), pa.field("reason", pa.string())]
)
SQUARES = pa.schema(
    [
        pa.field("unit", pa.string(), nullable=False),
        pa.field("n", pa.int64(), nullable=False),
        pa.field("square", pa.float64()),
        pa.field("tags", pa.list_(pa.string())),
    ]
)
TEXTS = pa.schema([pa.field("unit", pa.string(), nullable=False), pa.field("text", pa.string())])


def mark(unit: Unit, stage: str) -> None:
    """Leave a trace of a run outside the store: one line a run, so that tests can count what was redone."""
    folder = unit.payload.get("log")
    if folder:
        with open(Path(str(folder)) / f"{unit.unit_id.replace('/', '_')}.{stage}", "a") as handle:
            handle.write(f"{os.getpid()}\n")


def misbehave(unit: Unit) -> None:
    """What the payload asks for: errors, memory, hanging, dying."""
    what = unit.payload.get("trouble", "")
    if what == "format":
        raise FormatError("cut short", where=f"{unit.unit_id}.json", place="$.rooms", remedy="Fetch it again.")
    if what == "error":
        raise ZeroDivisionError("a bug of the stage")
    if what == "exit":
        raise SystemExit(7)
    if what == "memory":
        raise MemoryError
    if what == "hang":
        time.sleep(3600)
    if what in ("compiled-hang", "compiled-stop"):
        # As numba hands on what a signal's handler raised while compiled code ran.
        try:
            signal.raise_signal(signal.SIGTERM) if what == "compiled-stop" else time.sleep(3600)
        except BaseException as error:
            raise SystemError("<kernel> returned a result with an exception set") from error
    if what == "swallowed-stop":  # an exception in __del__ or in a callback of C code is printed and forgotten
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    if what == "lock":  # one call of compiled code that keeps the interpreter locked and never returns
        sum(itertools.repeat(0))
    if what == "hog":
        held = []
        while True:
            held.append(b"x" * (64 << 20))
            time.sleep(0.02)
    if what == "request":  # one request far beyond any machine
        np.zeros(1 << 44)
    if what == "die":
        os._exit(11)
    if what == "die-with-child":  # a child of its own holds all its files open
        if os.fork() == 0:
            time.sleep(600)
        os._exit(11)
    if what == "print-and-die":
        print("a word of Python")
        os._exit(11)
    if what == "signal-and-die":  # which has no name
        signal.raise_signal(signal.SIGRTMIN + 6)
    if what == "child":
        subprocess.Popen(["sleep", "600"])
    if what == "abort":  # as a failed assertion of C++ code does
        os.write(2, b"a word of compiled code\n")
        os.abort()
    if what == "full":
        raise OSError(28, "No space left on device")
    # Troubles that end: the named file counts how often they struck.
    kind, _, rest = str(what).partition(":")
    if kind in ("transient-once", "memory-once", "die-once", "terminate-once"):
        flag = Path(rest)
        if not flag.exists():
            flag.touch()
            if kind == "die-once":
                os._exit(11)
            if kind == "terminate-once":  # as Ray ends workers whose driver or node goes
                signal.raise_signal(signal.SIGTERM)
            raise TransientIOError("busy") if kind == "transient-once" else MemoryError
    if unit.payload.get("seconds"):
        time.sleep(float(str(unit.payload["seconds"])))


@dataclass(frozen=True)
class Count(Stage):
    """0 … size-1 of the unit's first input; skipped at size 0."""

    name: str = "count"
    version: int = 1
    tables: tuple[str, ...] = ("numbers", "states")
    modulus: int = 1000

    def parameters(self, unit: Unit) -> JSON:
        return {"modulus": self.modulus}

    def run(self, unit: Unit, upstream: Mapping[str, pa.Table], shared: Mapping[str, pa.Table]) -> StageOutput:
        mark(unit, self.name)
        misbehave(unit)
        size = unit.inputs[0].size
        state = {"unit": [unit.unit_id], "status": ["ok"], "reason": [None]}
        if size == 0:
            state |= {"status": ["skipped"], "reason": ["empty"]}
            return StageOutput({"states": pa.table(state, schema=STATES)}, outcome="skipped", reason="empty")
        numbers = [n % self.modulus for n in reversed(range(size))]
        table = pa.table({"unit": [unit.unit_id] * size, "n": numbers}, schema=NUMBERS)
        return StageOutput({"numbers": table, "states": pa.table(state, schema=STATES)}, measures={"size": float(size)})


@dataclass(frozen=True)
class Square(Stage):
    """Squares, weighted by the pinned total's parity (the one bit of it that is read)."""

    name: str = "square"
    version: int = 1
    tables: tuple[str, ...] = ("squares", "scratch")
    reads: tuple[str, ...] | None = ("numbers",)
    needs: tuple[str, ...] = ("total",)
    power: float = 2.0

    def parameters(self, unit: Unit) -> JSON:
        return {"power": self.power}

    def dependencies(self, unit: Unit, upstream: Mapping[str, pa.Table], shared: Mapping[str, pa.Table]) -> JSON:
        return {"odd": bool(shared["total"]["total"][0].as_py() % 2)}

    def run(self, unit: Unit, upstream: Mapping[str, pa.Table], shared: Mapping[str, pa.Table]) -> StageOutput:
        mark(unit, self.name)
        odd = bool(shared["total"]["total"][0].as_py() % 2)
        numbers = upstream["numbers"]["n"].to_pylist()
        squares = [float(n) ** self.power + odd for n in numbers]
        table = pa.table(
            {
                "unit": [unit.unit_id] * len(numbers),
                "n": numbers,
                "square": squares,
                "tags": [["a"] * (n % 3) for n in numbers],
            },
            schema=SQUARES,
        )
        scratch = pa.table({"sum": [sum(squares)]})
        return StageOutput({"squares": table, "scratch": scratch}, files={"blob.bin": bytes(len(numbers))})


@dataclass(frozen=True)
class Word(Stage):
    """A sentence on the sum."""

    name: str = "word"
    version: int = 1
    tables: tuple[str, ...] = ("texts",)
    reads: tuple[str, ...] | None = ("scratch",)
    phrase: str = "the sum is"

    def parameters(self, unit: Unit) -> JSON:
        return self.phrase

    def run(self, unit: Unit, upstream: Mapping[str, pa.Table], shared: Mapping[str, pa.Table]) -> StageOutput:
        mark(unit, self.name)
        text = f"{self.phrase} {upstream['scratch']['sum'][0].as_py():g}"
        return StageOutput({"texts": pa.table({"unit": [unit.unit_id], "text": [text]}, schema=TEXTS)})


@dataclass(frozen=True)
class Total(Aggregate):
    """How many numbers all units have together."""

    name: str = "total"
    version: int = 1
    after: str = "count"
    tables: tuple[str, ...] = ("numbers",)
    more: int = 0

    def parameters(self) -> JSON:
        return {"more": self.more}

    def build(self, tables: Iterator[tuple[str, Mapping[str, pa.Table]]]) -> pa.Table:
        return pa.table({"total": [self.more + sum(found["numbers"].num_rows for _, found in tables)]})


def pipeline(
    count: Stage | None = None, square: Stage | None = None, word: Stage | None = None, total: Aggregate | None = None
) -> Pipeline:
    """Three stages, one aggregate, four published tables and one that is not."""
    return Pipeline(
        name="toy",
        stages=(count or Count(), square or Square(), word or Word()),
        aggregates=(total or Total(),),
        tables={
            "numbers": TableSpec(NUMBERS, ("unit", "n")),
            "states": TableSpec(STATES, ("unit",)),
            "squares": TableSpec(SQUARES, ("unit", "n")),
            "texts": TableSpec(TEXTS, ("unit",)),
        },
    )


def unit(
    name: str, size: int = 5, *, partition: str = "a", cost: float = 1.0, content: str = "", **payload: JSON
) -> Unit:
    """A unit whose one input has ``size``; ``cost`` is shared evenly by its stages."""
    sha = hashlib.sha256(f"{name} {size} {content}".encode()).hexdigest()
    costs = dict.fromkeys(("count", "square", "word"), cost / 3)
    return Unit(name, partition, (InputFile(f"{name}.json", size, sha),), payload, costs, 1 << 20)


def units(count: int = 12, **payload: JSON) -> list[Unit]:
    """Units of several sizes in two partitions; one of them is empty and so skipped."""
    return [
        unit(f"{'ab'[n % 2]}/u{n:05d}", n % 7 + (n != 7), partition="ab"[n % 2], cost=1.0 + n % 5, **payload)
        for n in range(count)
    ]


def files(store: LocalStore, snapshot_id: str | None) -> dict[str, bytes]:
    """Every Parquet file of a snapshot."""
    folder = store.root / "snapshots" / str(snapshot_id)
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.parquet"))}


def counts(folder: Path) -> dict[str, int]:
    """How often each stage ran for each unit."""
    return {path.name: len(path.read_text().splitlines()) for path in folder.iterdir()}
