"""What the driver holds at once does not depend on the number of units."""

from __future__ import annotations

import gc
import tempfile
import tracemalloc
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

import pytest

from benchmarks import factory_overhead
from benchmarks.factory_overhead import Simulated, changed_units, units
from factory import LocalStore, inventory, local_store, packing, plan, planner, queue, run, scratch, sorting, spool
from factory import index as index_module
from factory.commits import Commits
from factory.index import Index
from factory.snapshot import read_ref

pipeline = partial(factory_overhead.pipeline, first_pass=True)

FEW, MANY = 1000, 5000

BYTES_A_UNIT: Final = 12
"""Most growth for each unit. 2 to 7 are measured: the first id of each batch, since batches are a sixteenth as long
here, what grows with the changed units, and chance. Sorted numbers in memory take 54, an index of hashes 8 more."""

SMALL: Final = {
    (scratch, "BATCH_ROWS"): 128,
    (index_module, "BATCH_ROWS"): 128,
    (index_module, "_BATCH"): 16,
    (index_module, "_RUN_ROWS"): 256,
    (index_module, "_PIECE"): 128,
    (index_module, "_STEP"): 32,
    (index_module, "_FAN_IN"): 4,
    (index_module, "_CHUNK"): 1024,
    (local_store, "_CHUNK"): 1024,
    (inventory, "_BATCH"): 64,
    (inventory, "SHARES"): 4,
    (packing, "_BATCH"): 64,
    (planner, "_BATCH"): 64,
    (queue, "SORTED_AT_ONCE"): 64,
    (sorting, "SORTED_AT_ONCE"): 64,
    (spool, "_AT_ONCE"): 16,
}
"""Batches so small that even a few units are many of them."""


def peaks(store: LocalStore, count: int) -> list[int]:
    """Return the most bytes of Python and NumPy that each of three jobs of the driver held beyond what it began with:
    a first run, a plan without a change, a run with 1 % changed.
    """

    def fill() -> None:
        ref, _ = read_ref(store, "main")
        assert ref is not None
        for receipt in (index := Index.read(store, ref.index)).receipts(range(len(index)), pipeline()):
            store.write(f"{Commits.folder('burn', receipt.stages[0].key.hex())}/unit.json", b"1")

    def first() -> None:
        assert run(pipeline(), units(count), store, executor=Simulated()).published

    def planned() -> None:
        assert plan(pipeline(), units(count), store).counts["FRESH"] == count

    def changed() -> None:
        assert run(pipeline(), changed_units(count), store, executor=Simulated()).counts["made"] == count // 100

    found = []
    jobs: list[Callable[[], None]] = [first, planned, changed]
    for job in jobs:
        gc.collect()
        tracemalloc.start()
        try:
            job()
            found.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
        if job is first:
            fill()
    return found


def test_the_driver_holds_no_more_for_more_units(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for (module, name), value in SMALL.items():
        monkeypatch.setattr(module, name, value)
    file = tempfile.SpooledTemporaryFile
    monkeypatch.setattr(tempfile, "SpooledTemporaryFile", lambda max_size: file(max_size=1024))
    peaks(LocalStore(tmp_path / "warm", durable=False), 100)  # what is loaded once
    few, many = (peaks(LocalStore(tmp_path / str(count), durable=False), count) for count in (FEW, MANY))
    growth = [(after - before) / (MANY - FEW) for before, after in zip(few, many, strict=True)]
    assert max(growth) < BYTES_A_UNIT, (few, many, growth)
