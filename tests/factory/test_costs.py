"""What runs are expected to cost: estimates, receipts, and which stages are counted."""

from __future__ import annotations

from dataclasses import replace

import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st

from factory import LocalStore, plan, run
from factory.commits import Commits
from factory.costs import PRIOR_SECONDS, CostModel
from factory.index import Index, IndexWriter
from factory.machine import REFERENCE_PROBE_SECONDS, probe, slowness
from factory.planner import Planner
from factory.receipt import Receipt, StageReceipt
from factory.snapshot import Snapshot

SLOWNESS = 3.0


def made(unit_id: str, partition: str, spent: dict[str, float], estimate: float) -> Receipt:
    key = b"k" * 16
    stages = tuple(
        StageReceipt(stage, key, key, key, key, key, 99.0, 10, True, False, (), cpu, estimate)
        for stage, cpu in spent.items()
    )
    return Receipt(unit_id, partition, "ok", "", key, stages)


def model(*receipts: Receipt) -> CostModel:
    writer = IndexWriter(toys.pipeline())
    for receipt in receipts:
        writer.add(receipt)
    return CostModel(Index(writer.finish(None)), toys.pipeline(), lambda: SLOWNESS)


def test_a_first_run_goes_by_estimates_and_the_slowness_of_the_machine() -> None:
    unit = replace(toys.unit("a/x"), costs={"count": 1.0, "square": 2.0})
    found = model()
    assert [found.stage_seconds(unit, -1, s) for s in ("count", "square", "word")] == [SLOWNESS, 2 * SLOWNESS, 0.0]
    assert found.seconds(unit, -1) == 3 * SLOWNESS
    assert found.seconds(unit, -1, 1) == 2 * SLOWNESS
    assert found.seconds(unit, -1, 0, 1) == SLOWNESS


def test_a_published_stage_costs_what_it_took_scaled_with_its_estimate() -> None:
    found = model(made("a/x", "a", {"count": 4.0}, estimate=1.0))
    unit = toys.unit("a/x")
    assert found.stage_seconds(replace(unit, costs={"count": 1.0}), 0, "count") == 4.0
    assert found.stage_seconds(replace(unit, costs={"count": 2.5}), 0, "count") == 10.0
    # Without an estimate there is nothing to scale by.
    assert found.stage_seconds(replace(unit, costs={}), 0, "count") == 4.0


@given(st.lists(st.tuples(st.sampled_from("ab"), st.floats(0.25, 50), st.floats(0.25, 50)), min_size=1, max_size=9))
def test_scales_are_learned_by_stage_and_partition(rows: list[tuple[str, float, float]]) -> None:
    rows = [(partition, round(took * 4) / 4, round(said * 4) / 4) for partition, took, said in rows]
    found = model(*(made(f"{p}/{n}", p, {"count": took}, said) for n, (p, took, said) in enumerate(rows)))

    def scale(group: str, before: float) -> float:
        took = sum(t for p, t, _ in rows if group in ("", p))
        said = sum(s for p, _, s in rows if group in ("", p))
        return (took + PRIOR_SECONDS * before) / (said + PRIOR_SECONDS)

    overall = scale("", SLOWNESS)
    for partition in "abc":
        unit = replace(toys.unit("new", partition=partition), costs={"count": 2.0, "square": 2.0})
        assert found.stage_seconds(unit, -1, "count") == pytest.approx(2 * scale(partition, overall))
        # Nothing was learned of another stage.
        assert found.stage_seconds(unit, -1, "square") == 2 * SLOWNESS


def test_the_machine_is_not_probed_where_all_was_measured() -> None:
    writer = IndexWriter(toys.pipeline())
    writer.add(made("a/x", "a", {"count": 4.0}, estimate=1.0))
    found = CostModel(Index(writer.finish(None)), toys.pipeline(), lambda: pytest.fail("probed"))
    assert found.stage_seconds(toys.unit("a/x", cost=3.0), 0, "count") == 4.0


def test_receipts_hold_cpu_seconds_and_the_estimate(store: LocalStore) -> None:
    units = toys.units(6, seconds=0.05)
    run(toys.pipeline(), units, store)
    index = Snapshot.open(store).index()
    found = CostModel(index, toys.pipeline(), lambda: SLOWNESS)
    for unit in units:
        row = int(index.rows_of([unit.unit_id])[0])
        for stage in index.receipt(row, toys.pipeline()).stages:
            assert stage.estimate == pytest.approx(unit.costs[stage.stage])
            assert stage.cpu_seconds > 0
            assert found.stage_seconds(unit, row, stage.stage) == pytest.approx(stage.cpu_seconds, rel=1e-5)
        # It slept, and sleeping is no work.
        first = index.receipt(row, toys.pipeline()).stages[0]
        assert first.cpu_seconds < first.seconds
        assert first.seconds >= 0.05


def test_an_index_from_before_cpu_seconds_is_read(store: LocalStore) -> None:
    run(toys.pipeline(), toys.units(4), store)
    table = Snapshot.open(store).index().table
    table = table.select([n for n in table.column_names if not n.endswith((".cpu_seconds", ".estimate"))])
    index = Index(table)
    assert index.receipt(0, toys.pipeline()).stages[0].cpu_seconds == 0.0
    unit = toys.unit("a/new", cost=3.0)
    assert CostModel(index, toys.pipeline(), lambda: SLOWNESS).seconds(unit, -1) == pytest.approx(3 * SLOWNESS)


def test_every_stage_of_a_first_run_is_counted_once(store: LocalStore) -> None:
    """In the plan, and over the passes of a run: the pass that an aggregate waits for, and what is behind it."""
    units = [replace(toys.unit(f"a/{n}"), costs={"count": 1.0, "square": 2.0, "word": 4.0}) for n in range(3)]
    found = plan(toys.pipeline(), units, store)
    assert found.seconds + found.possible_seconds == pytest.approx(21 * slowness())

    def planner(**how: int) -> Planner:
        return Planner(toys.pipeline(), Commits(store), Index.empty(toys.pipeline()), {}, **how)

    first, second = planner(stages=1), planner(made=1)
    assert [w.seconds for w in first.work(units)] == [pytest.approx(slowness())] * 3
    assert first.seconds_behind == pytest.approx(18 * slowness())
    assert [w.seconds for w in second.work(units)] == [pytest.approx(6 * slowness())] * 3
    assert second.seconds_behind == 0


def test_the_probe_is_short_and_repeats() -> None:
    assert slowness() == slowness()
    found = probe()
    assert found > 0
    assert slowness() > 0
    assert REFERENCE_PROBE_SECONDS > 0
