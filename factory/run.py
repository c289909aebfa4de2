"""A run: plan, process what changed, compose a snapshot, publish it.

::

    units ──► compare with the published index ──► tasks, biggest first ──► executor ──► receipts
                        │ unchanged                                                         │
                        └────────────────► new index ◄──────────────────────────────────────┘
                                             │ same rows, same id
                                             ▼
                        parts (carried over or packed) ──► manifest ──► index ──► ref

Where an aggregate is not pinned, a first pass runs all units up to the stage it follows, then builds and pins it.
Everything between two commits may die; the next run finds what was committed and goes on.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Final

import pyarrow as pa

from factory.commits import Commits
from factory.deadline import terminable
from factory.executor import Executor, InlineExecutor, tasks
from factory.index import Index, IndexWriter, failed_keys
from factory.inventory import Inventory, missing_parts
from factory.packing import PART_BYTES
from factory.pins import Pins, build_aggregate, discard_damaged
from factory.pipeline import Pipeline, RunContext
from factory.planner import Plan, Planner
from factory.publish import Publisher, published_index
from factory.receipt import Receipt
from factory.report import ABORTED, WITH_QUARANTINE, Heartbeat, Progress, RunReport
from factory.snapshot import read_manifest, read_ref
from factory.stage import Aggregate, Unit, Work
from factory.store import Store
from schemas.errors import ClusterError, CorruptShardError, FailureBudgetError, StoreError
from schemas.standard_files import open_standard_files

__all__ = ["plan", "run"]

_COMMITTED: Final = "they and every finished stage of the others are committed, but nothing was published"

_REPAIRS: Final = 3
"""How often damaged files found while publishing are rebuilt before the run gives up."""


def plan(
    pipeline: Pipeline,
    units: Iterable[Unit],
    store: Store,
    ref: str = "main",
    *,
    retry_quarantined: bool = False,
    renew: Iterable[str] = (),
) -> Plan:
    """Return what ``run`` with the same arguments would do. Runs nothing and writes nothing.

    renew : names of aggregates to build again
    """
    commits = Commits(store)
    published, _ = read_ref(store, ref)
    manifest = read_manifest(store, published.snapshot_id) if published is not None else None
    index = published_index(pipeline, store, published)
    pins = Pins(pipeline.name, pipeline.aggregates, commits, ref, published=manifest)
    shared = pins.hashes(renew)
    quarantined = frozenset() if retry_quarantined else frozenset(commits.quarantined())
    inventory = Inventory(commits, index)
    planner = Planner(pipeline, commits, index, shared, quarantined, inventory=inventory)
    found = Plan()
    if published is not None:
        found.snapshot_id = published.snapshot_id
        found.damaged = (*missing_parts(store, published.snapshot_id), *pins.damaged)
        if index.damaged:
            found.damaged += (Index.path(published.index),)
    for unit, _, row, fresh in planner.compare(units):
        found.add(planner.entry(unit, row, fresh))
        found.carried += fresh
    found.removed = planner.removed()
    found.renewed = tuple(a.name for a in pipeline.aggregates if a.name not in shared)
    return found


def run(
    pipeline: Pipeline,
    units: Iterable[Unit],
    store: Store,
    ref: str = "main",
    executor: Executor | None = None,
    *,
    budget: float | None = None,
    progress: Progress | None = None,
    retry_quarantined: bool = False,
    renew: Iterable[str] = (),
    deadline: float | None = None,
    memory: int | None = None,
    verify: bool = False,
    revision: str = "",
    part_bytes: int = PART_BYTES,
) -> RunReport:
    """Bring ``ref`` up to date with ``units``.

    executor : who does the work; this process by default
    budget : number of quarantined units beyond which the run stops: a whole number counts units, a fraction is a share
        of all units; no limit by default
    retry_quarantined : try units again whose key is in quarantine
    renew : names of aggregates to build again
    deadline : seconds one unit may take
    memory : bytes that a process which works on units may hold; by default its share of the machine
    verify : read every file again that what is published rests on, and make those again that differ from their hash
    revision : recorded in every commit, never keyed
    part_bytes : canonical bytes of one published file, see ``factory.packing``

    When another run publishes under ``ref`` meanwhile, that one stands, and the report's message says so. Raises
    ``StoreError`` when the store refuses (what was committed stays), ``KeyboardInterrupt`` on Ctrl-C and on SIGTERM.
    """
    open_standard_files()
    with terminable() as stop:
        context = RunContext(
            pipeline=pipeline,
            store=store,
            retrying=retry_quarantined,
            revision=revision,
            deadline=deadline,
            memory=memory,
            name=ref,
            token=secrets.token_hex(8),
        )
        executor, progress = executor or InlineExecutor(), progress or Progress()
        found = _Run(context, executor, progress, stop, budget, frozenset(renew), part_bytes)
        return found.go(units, verify=verify)


@dataclass
class _Run:
    """One run. failed : receipts of the units that failed in it, by id; a later pass does not try them again"""

    context: RunContext
    executor: Executor
    progress: Progress
    stop: threading.Event
    budget: float | None
    renew: frozenset[str]
    part_bytes: int
    report: RunReport = field(default_factory=RunReport)
    failed: dict[str, Receipt] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.pipeline, self.store, self.commits = self.context.pipeline, self.context.store, Commits(self.context.store)
        self.publisher = Publisher(self.context, self.executor, self.progress, self.part_bytes)

    def go(self, units: Iterable[Unit], *, verify: bool) -> RunReport:
        started, started_at = time.perf_counter(), time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        self.index = published_index(self.pipeline, self.store, self.publisher.old)
        self.quarantined = frozenset() if self.context.retrying else frozenset(self.commits.quarantined())
        self.publisher.look()
        name, aggregates = self.pipeline.name, self.pipeline.aggregates
        pins = Pins(name, aggregates, self.commits, self.context.name, self.publisher.manifest)
        self.shared = pins.hashes(self.renew)
        for path in pins.restore():
            self.progress.note(f"{path} was missing or damaged: restored from the published snapshot")
        if verify:
            self.publisher.verify(self.commits, self.index)
        # After verifying, which removes what is damaged.
        self.inventory = Inventory(self.commits, self.index)
        try:
            with Heartbeat(self.executor.busy, self.progress.busy):
                self._bring_up_to_date([*units], pins)
            if self.report.counts["quarantined"]:
                self.report.exit_code = WITH_QUARANTINE
        except FailureBudgetError as error:
            self.report.exit_code = ABORTED
            self.report.message = str(error)
        self.report.seconds = time.perf_counter() - started
        tried = any(not failure.known for _, failure in self.report.failures)
        if self.report.published or self.report.exit_code == ABORTED or self.report.stages or tried:
            self.report.write(self.context, type(self.executor).__name__, started_at)
        return self.report

    def _bring_up_to_date(self, units: Sequence[Unit], pins: Pins) -> None:
        waiting = [a for a in self.pipeline.aggregates if a.name not in self.shared]
        for position in sorted({self.pipeline.position(a.after) for a in waiting}):
            due = [a for a in waiting if self.pipeline.position(a.after) == position]
            self._first_pass(units, position + 1, due, pins)
        damaged: set[str] = set()
        made = max((self.pipeline.position(a.after) + 1 for a in waiting), default=0)
        for _ in range(_REPAIRS):
            index = self._pass(units, frozenset(damaged), made)
            made = 0
            if index is None:
                return
            damaged = self.publisher.publish(index, self._context(), self.report, pins.pin.tables)
            if not damaged:
                # What was in quarantine and is no more: corrected, changed or gone.
                for stage, key in sorted(failed_keys(self.index) - failed_keys(index)):
                    self.commits.release(stage, key)
                return
            self.progress.note(f"committed files of {len(damaged)} units are damaged: they are rebuilt")
        raise StoreError("committed files keep getting damaged", where=self.store.url, remedy="Check the disk.")

    # ---- working off

    def _begin(self) -> None:
        """Reset the counts of units, so that the report counts only the units of the last pass. Stages are counted over
        all passes.
        """
        self.report.counts.clear()
        self.report.failures.clear()

    def _first_pass(self, units: Sequence[Unit], until: int, due: list[Aggregate], pins: Pins) -> None:
        for _ in range(_REPAIRS):
            self._begin()
            planner = Planner(self.pipeline, self.commits, self.index, self.shared, self.quarantined, stages=until)
            writer = IndexWriter(self.pipeline)
            work = [*planner.work(units)]
            if planner.seconds_behind >= 1:
                self.progress.note(
                    f"the first of two passes counts all scenes, for {', '.join(a.name for a in due)}; the second has "
                    f"about {planner.seconds_behind:.0f} CPU s of work"
                )
            for receipt in self._work(work, until, f"first pass, for {', '.join(a.name for a in due)}"):
                writer.add(receipt)
            index = writer.finish()  # whose receipts are in the order of their units' ids
            try:
                for aggregate in due:
                    table, count = build_aggregate(aggregate, self.commits, index.receipts(self.pipeline))
                    renew = aggregate.name in self.renew
                    self.shared[aggregate.name] = pins.set(aggregate, table, count, renew=renew)
                return
            except CorruptShardError as error:
                for aggregate in due:
                    discard_damaged(aggregate, self.commits, index.receipts(self.pipeline))
                self.progress.note(f"{error}: this commit and others like it are rebuilt")
        raise StoreError("committed files keep getting damaged", where=self.store.url, remedy="Check the disk.")

    def _pass(self, units: Sequence[Unit], again: frozenset[str], made: int) -> Index | None:
        """Run one pass over ``units``; return the new index, or None when nothing changed. Units in ``again`` are
        processed in any case.

        made : how many stages the first passes of this run made for every unit
        """
        report = self.report
        self._begin()
        planner = Planner(
            self.pipeline,
            self.commits,
            self.index,
            self.shared,
            self.quarantined,
            made=made,
            again=again,
            inventory=self.inventory,
        )
        writer = IndexWriter(self.pipeline)
        work = [*planner.work(units)]
        kept = int(planner.kept.sum())
        report.counts["fresh"] = kept
        report.counts["removed"] = int((~planner.present).sum())
        report.counts["total"] = len(work) + kept
        for receipt in self.index.receipts(self.pipeline, planner.kept_incomplete()):
            self._count(receipt, worked=False)
        report.counts["ok"] += kept - report.counts["skipped"] - report.counts["quarantined"]
        self._within_budget()
        known = len(self.index) > 0 and not self.index.damaged
        if not work and not report.counts["removed"] and known and self.publisher.sound():
            assert self.publisher.old is not None
            report.snapshot_id = self.publisher.old.snapshot_id
            return None
        for receipt in self._work(work, len(self.pipeline.stages), "units"):
            writer.add(receipt)
        return writer.finish(self.index.table.filter(pa.array(planner.kept)))

    def _work(self, work: Sequence[Work], until: int, phase: str) -> Iterator[Receipt]:
        """Yield the receipts of all units in ``work`` as they come, and count them."""
        self.report.counts["total"] = max(self.report.counts["total"], len(work))
        left = [item for item in work if item.unit.unit_id not in self.failed]
        failed = [self._failed_before(item) for item in work if item.unit.unit_id in self.failed]
        seconds = sum(item.seconds for item in left)
        workers = min(self.executor.begin(seconds), len(left)) if left else 1
        self.progress.phase(phase, len(work), seconds, workers)
        receipts = self.executor.run(self._context(), tasks(left, until, workers))
        done = 0
        try:
            for receipt in chain(failed, receipts):
                done += 1
                self._count(receipt)
                self.progress.unit(receipt)
                self._within_budget()
                if self.stop.is_set():
                    raise KeyboardInterrupt
                yield receipt
        except ClusterError as error:
            if self.stop.is_set():  # what stopped this process may have ended its workers first
                raise KeyboardInterrupt from error
            raise ClusterError(
                f"{error.what}. {done} of the {len(work)} units of this pass were done; {_COMMITTED}",
                remedy=error.remedy,
            ) from error
        finally:
            close = getattr(receipts, "close", None)
            if close is not None:
                close()

    def _failed_before(self, item: Work) -> Receipt:
        """Return the receipt of a unit that failed in an earlier pass of this run: no stage of it is run again."""
        receipt = self.failed[item.unit.unit_id]
        stages = tuple(replace(stage, made=False) for stage in receipt.stages)
        return replace(receipt, fingerprint=item.fingerprint, stages=stages, expected=0.0)

    def _context(self) -> RunContext:
        return replace(self.context, shared=self.shared, quarantined=self.quarantined)

    def _count(self, receipt: Receipt, *, worked: bool = True) -> None:
        report = self.report
        if receipt.failure is not None:
            report.fail(receipt.unit_id, receipt.failure)
            self.failed[receipt.unit_id] = receipt
        else:
            report.counts[receipt.status] += 1
        made = [stage for stage in receipt.stages if stage.made]
        if made:
            report.counts["made"] += 1
        elif worked and receipt.failure is None:
            report.counts["reused"] += 1
        for stage in made:
            report.stages[stage.stage] += 1
            report.stage_seconds[stage.stage] += stage.seconds  # type: ignore[assignment]
            report.peak_rss = max(report.peak_rss, stage.peak_rss)

    def _within_budget(self) -> None:
        failed, total = self.report.counts["quarantined"], self.report.counts["total"]
        most = self.budget * total if isinstance(self.budget, float) else self.budget
        if most is not None and failed > most:
            raise FailureBudgetError(
                f"{failed} of {total} units are quarantined, more than the budget allows",
                remedy="condvln status CONFIG shows the causes; what was committed stays, but nothing was published.",
            )
