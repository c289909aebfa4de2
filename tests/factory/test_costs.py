"""What runs are expected to cost: estimates, receipts, and which stages are counted."""

from __future__ import annotations

from dataclasses import replace

import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st

from factory.commits import Commits
from factory.index import Index, IndexWriter
from factory.planner import CostModel, Planner
from factory.receipt import Receipt, StageReceipt
from factory.run import plan, run
from factory.snapshot import Snapshot
from factory.store import LocalStore


def made(unit_id: str, spent: dict[str, float], estimate: float) -> Receipt:
    key = b"k" * 16
    stages = tuple(
        StageReceipt(stage, key, key, key, key, key, 99.0, 10, True, False, (), cpu, estimate)
        for stage, cpu in spent.items()
    )
    return Receipt(unit_id, "a", "ok", "", key, stages)


def model(*receipts: Receipt) -> CostModel:
    writer = IndexWriter(toys.pipeline())
    for receipt in receipts:
        writer.add(receipt)
    return CostModel(writer.finish(), toys.pipeline())


def test_a_published_stage_costs_what_it_took_scaled_with_its_estimate() -> None:
    found = model(made("a/x", {"count": 4.0}, estimate=1.0))
    unit = toys.unit("a/x")
    assert found.stage_seconds(replace(unit, costs={"count": 1.0}), 0, "count") == 4.0
    assert found.stage_seconds(replace(unit, costs={"count": 2.5}), 0, "count") == 10.0
    # Without an estimate there is nothing to scale by.
    assert found.stage_seconds(replace(unit, costs={}), 0, "count") == 4.0


@given(st.lists(st.tuples(st.floats(0.25, 50), st.floats(0.25, 50)), max_size=9))
def test_scales_are_learned_by_stage(rows: list[tuple[float, float]]) -> None:
    rows = [(round(took * 4) / 4, round(said * 4) / 4) for took, said in rows]
    found = model(*(made(f"a/{n}", {"count": took}, said) for n, (took, said) in enumerate(rows)))
    scale = sum(took for took, _ in rows) / sum(said for _, said in rows) if rows else 1.0
    unit = replace(toys.unit("new"), costs={"count": 2.0, "square": 2.0})
    assert found.stage_seconds(unit, -1, "count") == pytest.approx(2 * scale)
    assert found.stage_seconds(unit, -1, "square") == 2.0, "nothing was learned of another stage"


def test_receipts_hold_cpu_seconds_and_the_estimate(store: LocalStore) -> None:
    units = toys.units(6, seconds=0.05)
    run(toys.pipeline(), units, store)
    index = Snapshot.open(store).index
    found = CostModel(index, toys.pipeline())
    for unit in units:
        row = index.row_of(unit.unit_id)
        for stage in index.receipt(row, toys.pipeline()).stages:
            assert stage.estimate == pytest.approx(unit.costs[stage.stage])
            assert stage.cpu_seconds > 0
            assert found.stage_seconds(unit, row, stage.stage) == pytest.approx(stage.cpu_seconds, rel=1e-5)
        # It slept, and sleeping is no work.
        first = index.receipt(row, toys.pipeline()).stages[0]
        assert first.cpu_seconds < first.seconds
        assert first.seconds >= 0.05


def test_every_stage_of_a_first_run_is_counted_once(store: LocalStore) -> None:
    """In the plan, and over the passes of a run: the pass that an aggregate waits for, and what is behind it."""
    units = [replace(toys.unit(f"a/{n}"), costs={"count": 1.0, "square": 2.0, "word": 4.0}) for n in range(3)]
    found = plan(toys.pipeline(), units, store)
    assert found.seconds + found.possible_seconds == pytest.approx(21)

    def planner(**how: int) -> Planner:
        return Planner(toys.pipeline(), Commits(store), Index.empty(toys.pipeline()), {}, **how)

    first, second = planner(stages=1), planner(made=1)
    assert [w.seconds for w in first.work(units)] == [1.0] * 3
    assert first.seconds_behind == pytest.approx(18)
    assert [w.seconds for w in second.work(units)] == [pytest.approx(6)] * 3
    assert second.seconds_behind == 0
