"""What a process made in the first pass of a run, it does not read in the next pass; another run reads the store."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pyarrow as pa
import pytest
import toys

from factory import LocalStore, run
from factory.kept_tables import KeptTables, kept_tables
from factory.receipt import Receipt
from factory.report import Silence
from factory.shard import SHARD_FILE


class Read(LocalStore):
    """A store that counts which files are read."""

    reads: Counter[str]

    def __init__(self, root: Path) -> None:
        super().__init__(root, durable=False)
        self.reads = Counter()

    def read(self, path: str) -> bytes:
        self.reads[path] += 1
        return super().read(path)

    def tables(self, stage: str) -> Counter[str]:
        """How often the tables of each commit of a stage were read."""
        return Counter(
            {p: n for p, n in self.reads.items() if p.startswith(f"units/{stage}/") and p.endswith(SHARD_FILE)}
        )


def test_a_run_reads_no_table_that_it_made_in_its_first_pass(tmp_path: Path) -> None:
    kept, again = Read(tmp_path / "kept"), Read(tmp_path / "again")
    units = toys.units(6)
    after: dict[str, int] = {}

    class Listener(Silence):
        def unit(self, receipt: Receipt) -> None:
            after[receipt.unit_id] = sum(kept.tables("count").values())

    first = run(toys.pipeline(), units, kept, progress=Listener())
    # The aggregate counts the numbers of each unit, in one reading; no stage reads them a second time.
    assert set(after.values()) == {len([unit for unit in units if unit.inputs[0].size])}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(KeptTables.__init__, "__defaults__", (0,))
        assert run(toys.pipeline(), units, again).snapshot_id == first.snapshot_id
    assert sum(again.tables("count").values()) > sum(kept.tables("count").values())


def test_another_run_reads_what_is_stored(tmp_path: Path) -> None:
    store, units = Read(tmp_path / "store"), toys.units(6)
    run(toys.pipeline(), units, store)
    store.reads.clear()
    run(toys.pipeline(square=toys.Square(power=3.0)), units, store, ref="other")
    assert sum(store.tables("count").values()) >= len([unit for unit in units if unit.inputs[0].size])


def test_tables_are_kept_up_to_a_limit_and_until_they_are_taken() -> None:
    table = pa.table({"n": pa.array(range(100), pa.int64())})
    kept = KeptTables(2 * table.nbytes)
    for name in "abc":
        kept.put(name, "hash", table)
    assert kept.take("c", "hash") is None, "there was no room"
    assert kept.take("a", "other") is None, "other rows than those that are asked for"
    assert kept.take("a", "hash") is table
    assert kept.take("a", "hash") is None
    kept.put("a", "hash", table)
    kept.put("c", "hash", table)
    assert (kept.take("a", "hash"), kept.take("c", "hash")) == (table, None)


def test_what_is_kept_belongs_to_one_run() -> None:
    table = pa.table({"n": [1]})
    kept_tables("one").put("path", "hash", table)
    assert kept_tables("one") is kept_tables("one")
    assert kept_tables("two").take("path", "hash") is None
    assert kept_tables("one").take("path", "hash") is None, "forgotten when the other run began"
    kept_tables("").put("path", "hash", table)
    assert kept_tables("").take("path", "hash") is None
