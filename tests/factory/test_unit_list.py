"""Units on disk are in the order of their ids, and take no memory each."""

from __future__ import annotations

import gc
import tracemalloc
from dataclasses import replace

import pyarrow as pa
import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.factory_overhead import units
from factory import LocalStore, Unit, run, unit_list
from factory.executor import InlineExecutor
from factory.unit_list import UnitList
from schemas.errors import InputError

ids = st.text(max_size=3)


@given(st.lists(ids, max_size=12), st.integers(1, 4))
def test_units_are_in_the_order_of_their_ids(names: list[str], piece: int) -> None:
    given_ = [Unit(name, "p") for name in names]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(unit_list, "_PIECE", piece)
        found = UnitList(given_)
    assert len(found) == len(names)
    for _ in range(2):
        assert [unit.unit_id for unit in found] == sorted(names)
    assert (found.twice is not None) == (len({*names}) < len(names))
    assert found.twice is None or names.count(found.twice) > 1
    assert not found.faulty
    assert all(unit in found for unit in given_)
    assert Unit("long", "p") not in found


def test_an_id_that_is_no_text_is_kept() -> None:
    found = UnitList([Unit("b\ud800", "p"), Unit("a", "p"), Unit("b\ud800", "p")])
    assert [unit.unit_id for unit in found] == ["a", "b\ud800", "b\ud800"]
    assert found.twice == "b\ud800"


def test_a_fault_is_known() -> None:
    assert UnitList([Unit("a", "p"), Unit("b", "p", fault=InputError("no scene"))]).faulty


def test_a_run_takes_them_as_it_takes_a_list(tmp_path) -> None:
    listed = list(toys.units(5))
    reports = [
        run(toys.pipeline(), given_, LocalStore(tmp_path / str(at)), executor=InlineExecutor())
        for at, given_ in enumerate([listed, UnitList(reversed(listed)), iter(listed)])
    ]
    assert len({report.snapshot_id for report in reports}) == 1
    assert all(report.counts["ok"] == 5 for report in reports)


def test_they_take_no_memory_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unit_list, "_PIECE", 64)

    def held(count: int) -> int:
        """Return the bytes of Python, NumPy and Arrow."""
        gc.collect()
        of_arrow = pa.total_allocated_bytes()
        tracemalloc.start()
        try:
            found = UnitList(replace(unit, inputs=unit.inputs * 20) for unit in units(count))
            assert len(found) == count
            return tracemalloc.get_traced_memory()[0] + pa.total_allocated_bytes() - of_arrow
        finally:
            tracemalloc.stop()

    held(500)
    grown = held(26_000) - held(10_000)  # of so many, no part of the spool is in memory but a buffer of 64 KiB
    assert grown < 16_000 * 8 + (1 << 16), "the order alone is in memory"
