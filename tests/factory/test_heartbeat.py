"""Messages about units that take long, and what was expected of units."""

from __future__ import annotations

import sys
from functools import partial

import pytest
import toys

from factory.receipt import Receipt
from factory.report import BUSY_SECONDS, Busy, Heartbeat, Progress
from factory.run import run
from factory.store import LocalStore


class Watch(Progress):
    """Keeps every message that it gets."""

    def __init__(self) -> None:
        self.busy_units: list[Busy] = []
        self.phases: list[tuple[str, int, float, int]] = []
        self.receipts: list[Receipt] = []

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        self.phases.append((name, total, seconds, workers))

    def unit(self, receipt: Receipt) -> None:
        self.receipts.append(receipt)

    def busy(self, unit: Busy) -> None:
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
