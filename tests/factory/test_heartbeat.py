"""Word of long units, the time left, and who the workers are."""

from __future__ import annotations

import sys
import time
from functools import partial

import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st

from factory import InlineExecutor, LocalStore, run
from factory.heartbeat import BUSY_SECONDS, Busy, Heartbeat, busy_message
from factory.receipt import Receipt, StageReceipt
from factory.report import PRIOR_SECONDS, Remaining, Silence, readable


class Watch(Silence):
    """Keeps every message that it gets."""

    def __init__(self) -> None:
        self.busy_units: list[Busy] = []
        self.phases: list[tuple[str, int, float, int]] = []
        self.receipts: list[Receipt] = []

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        self.phases.append((name, total, seconds, workers))

    def unit(self, receipt: Receipt) -> None:
        self.receipts.append(receipt)

    def busy(self, unit: Busy, message: str) -> None:
        self.busy_units.append(unit)


def test_a_long_unit_is_mentioned_at_growing_intervals() -> None:
    said: list[float] = []
    under_way: list[Busy] = []
    heart = Heartbeat(lambda: under_way, lambda busy: said.append(busy.seconds))
    for second in range(4000):
        under_way[:] = [Busy("a/long", "count", float(second)), Busy("a/short", "count", float(second % 20))]
        heart.beat()
    assert said == [30, 60, 120, 240, 480, 960, 1560, 2160, 2760, 3360, 3960]
    # Its next stage is a matter of its own.
    under_way[:] = [Busy("a/long", "square", BUSY_SECONDS)]
    heart.beat()
    assert said[-1] == BUSY_SECONDS


def test_a_message_names_scene_stage_and_a_deadline_that_cannot_be_kept() -> None:
    busy = Busy("ithor/FloorPlan1", "episodes", 75.2)
    assert busy_message(busy) == busy_message(busy, 80.0) == "ithor/FloorPlan1: at stage episodes for 75 s"
    assert "deadline of 60 s is over" in busy_message(busy, 60.0)
    assert "can't be interrupted" in busy_message(busy, 60.0)
    # A worker of Ray's is ended; nothing needs to be said.
    assert busy_message(Busy("a", "b", 75.0, endable=True), 60.0) == "a: at stage b for 75 s"


def test_an_inline_run_says_where_it_is(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    # By the module: ``factory.run`` is the function.
    monkeypatch.setattr(sys.modules["factory.run"], "Heartbeat", partial(Heartbeat, after=0.2, pause=0.02))
    watch = Watch()
    units = [toys.unit("a/quick"), toys.unit("a/slow", seconds=1.0)]
    run(toys.pipeline(), units, store, progress=watch)
    assert {(busy.unit_id, busy.stage) for busy in watch.busy_units} == {("a/slow", "count")}
    assert all(0.2 <= busy.seconds <= 5.0 for busy in watch.busy_units)
    seconds = [busy.seconds for busy in watch.busy_units]
    assert seconds == sorted(seconds)


def test_nothing_is_under_way_after_a_run(store: LocalStore) -> None:
    executor = InlineExecutor()
    assert [*executor.busy()] == []
    run(toys.pipeline(), [*toys.units(3), toys.unit("a/broken", trouble="error")], store, executor=executor)
    assert [*executor.busy()] == []


def test_receipts_say_what_was_expected_and_phases_add_up(store: LocalStore) -> None:
    watch = Watch()
    units = toys.units(7)
    run(toys.pipeline(), units, store, progress=watch)
    first, second = [phase for phase in watch.phases if phase[1] == 7]
    halves = watch.receipts[:7], watch.receipts[7:]
    for (_, _, seconds, workers), receipts in zip((first, second), halves, strict=True):
        assert sum(receipt.expected for receipt in receipts) == pytest.approx(seconds)
        assert workers == 1
    # The first pass makes one of three stages of equal estimates.
    assert second[2] == pytest.approx(2 * first[2])


def receipt(expected: float, took: float) -> Receipt:
    key = b"k" * 16
    stage = StageReceipt("count", key, key, key, key, key, took, 10, True, False, ())
    return Receipt("a/x", "a", "ok", "", key, (stage,), expected=expected)


@given(st.lists(st.floats(0.01, 100), min_size=1, max_size=20), st.integers(1, 8), st.floats(0.1, 10))
def test_the_time_left_follows_the_model_at_the_pace_of_the_receipts(
    costs: list[float], workers: int, pace: float
) -> None:
    left = Remaining(sum(costs), workers)
    assert left.seconds == pytest.approx(sum(costs) / workers)
    for at, cost in enumerate(costs):
        left.unit(receipt(cost, pace * cost))
        done = sum(costs[: at + 1])
        known = (pace * done + PRIOR_SECONDS) / (done + PRIOR_SECONDS)
        assert left.seconds == pytest.approx((sum(costs) - done) * known / workers, abs=1e-6)


def test_durations_are_readable() -> None:
    said = [readable(s) for s in (0.4, 89.4, 90, 3000, 5400, 12_000)]
    assert said == ["0 s", "89 s", "2 min", "50 min", "1 h 30 min", "3 h 20 min"]


def test_a_heartbeat_ends_with_its_block() -> None:
    looks: list[float] = []

    def look() -> list[Busy]:
        looks.append(time.monotonic())
        return []

    with Heartbeat(look, lambda busy: None, pause=0.01):
        while not looks:
            time.sleep(0.01)
    count = len(looks)
    time.sleep(0.1)
    assert len(looks) == count
