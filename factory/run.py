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
from collections.abc import Collection, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Final

from factory.commits import Commits
from factory.context import RunContext
from factory.deadline import terminable
from factory.executor import Executor, InlineExecutor
from factory.faults import FaultPlan
from factory.garbage import exempt_what_is_loaded
from factory.heartbeat import Busy, Heartbeat, busy_message
from factory.index import Index, IndexWriter, failed_keys
from factory.inventory import Inventory, missing_parts
from factory.packing import PART_BYTES
from factory.pins import Pins, build_aggregate, discard_damaged
from factory.pipeline import Pipeline
from factory.plan import Plan
from factory.planner import Planner
from factory.publish import Publisher, published_index
from factory.queue import WorkSpool, tasks
from factory.ray_guard import COMMITTED
from factory.receipt import Receipt
from factory.report import ABORTED, WITH_QUARANTINE, FailureBudget, Progress, RunReport, Silence
from factory.scratch import BatchedTable
from factory.snapshot import read_manifest, read_ref
from factory.spool import Spool
from factory.stage import Aggregate
from factory.store import Store
from factory.unit import Unit
from schemas.errors import ClusterError, CorruptShardError, FailureBudgetError, StoreError
from schemas.standard_files import open_standard_files

__all__ = ["plan", "run"]

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
    found = Plan(Spool())
    if published is not None:
        found.snapshot_id = published.snapshot_id
        found.damaged = (*missing_parts(store, published.snapshot_id), *pins.damaged)
        if index.damaged:
            found.damaged += (Index.path(published.index),)
    missing: dict[bytes, str] = {}
    for unit, _, row, fresh in planner.compare(units):
        found.add(planner.entry(unit, row, fresh))
        found.carried += fresh
        if row < 0 and len(index) and unit.inputs:
            missing[planner.keyer.content(unit)] = unit.unit_id
    found.removed = planner.removed()
    found.renamed = planner.renamed(missing)
    found.renewed = tuple(a.name for a in pipeline.aggregates if a.name not in shared)
    return found


def run(
    pipeline: Pipeline,
    units: Iterable[Unit],
    store: Store,
    ref: str = "main",
    executor: Executor | None = None,
    *,
    budget: FailureBudget | float | None = None,
    progress: Progress | None = None,
    retry_quarantined: bool = False,
    renew: Iterable[str] = (),
    deadline: float | None = None,
    memory: int | None = None,
    verify: bool = False,
    revision: str = "",
    part_bytes: int = PART_BYTES,
    faults: str = "",
) -> RunReport:
    """Bring ``ref`` up to date with ``units``. Iterables that are no ``Collection`` are kept on disk; a collection is
    iterated over several times, and must not change meanwhile.

    executor : who does the work; this process by default
    budget : quarantined units that stop the run (a count, or a share of all units); no limit by default
    retry_quarantined : try units again whose key is in quarantine
    renew : names of aggregates to build again
    deadline : seconds one unit may take
    memory : bytes that a process which works on units may hold; by default its share of the machine
    verify : read every file again that what is published rests on, and make those again that differ from their hash
    revision : recorded in every commit, never keyed
    part_bytes : canonical bytes of one published file, see ``factory.packing``
    faults : a ``FaultPlan``, for tests

    When another run publishes under ``ref`` meanwhile, that one stands, and the report's message says so. Raises
    ``StoreError`` when the store refuses (what was committed stays), ``KeyboardInterrupt`` on Ctrl-C and on SIGTERM.
    """
    exempt_what_is_loaded()
    open_standard_files()
    with terminable() as stop:
        return _Run(
            pipeline=pipeline,
            store=store,
            ref=ref,
            executor=executor or InlineExecutor(),
            budget=FailureBudget.of(budget),
            progress=progress or Silence(),
            retry=retry_quarantined,
            renew=tuple(renew),
            deadline=deadline,
            memory=memory,
            verify=verify,
            revision=revision,
            part_bytes=part_bytes,
            faults=faults,
            stop=stop,
        ).go(units)


@dataclass
class _Run:
    pipeline: Pipeline
    store: Store
    ref: str
    executor: Executor
    budget: FailureBudget
    progress: Progress
    retry: bool
    renew: tuple[str, ...]
    deadline: float | None
    memory: int | None
    verify: bool
    revision: str
    part_bytes: int
    faults: str
    stop: threading.Event
    report: RunReport = field(default_factory=RunReport)
    failed: set[tuple[str, str]] = field(default_factory=set)
    """(stage, key) of what failed in this run; a later pass does not try it again."""
    token: str = field(default_factory=lambda: secrets.token_hex(8))

    def go(self, units: Iterable[Unit]) -> RunReport:
        started, started_at = time.perf_counter(), time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        self.plan_of_faults = FaultPlan.parse(self.faults) if self.faults else FaultPlan.from_environment()
        self.commits = Commits(self.store, self.plan_of_faults)
        self.publisher = Publisher(
            self.pipeline, self.store, self.ref, self.executor, self.progress, self.plan_of_faults, self.part_bytes
        )
        self.index = self.publisher.index()
        self.quarantined = frozenset() if self.retry else frozenset(self.commits.quarantined())
        self.publisher.look()
        pins = Pins(
            self.pipeline.name,
            self.pipeline.aggregates,
            self.commits,
            self.ref,
            self.plan_of_faults,
            self.publisher.manifest,
        )
        self.shared = pins.hashes(self.renew)
        for path in pins.restore():
            self.progress.note(f"{path} was missing or damaged: restored from the published snapshot")
        if self.verify:
            self.publisher.verify(self.commits, self.index)
        # After verifying, which removes what is damaged.
        self.inventory = Inventory(self.commits, self.index)
        try:
            with (
                nullcontext(units) if isinstance(units, Collection) else Spool(units) as listed,
                Heartbeat(self.executor.busy, self._busy),
            ):
                self._bring_up_to_date(listed, pins)
            if self.report.counts["quarantined"]:
                self.report.exit_code = WITH_QUARANTINE
        except FailureBudgetError as error:
            self.report.exit_code = ABORTED
            self.report.message = str(error)
        self.report.seconds = time.perf_counter() - started
        tried = any(not failure.known for _, failure in self.report.failures)
        if self.report.published or self.report.exit_code == ABORTED or self.report.stages or tried:
            self.report.write(
                self.store,
                token=self.token,
                pipeline=self.pipeline.name,
                ref=self.ref,
                executor=type(self.executor).__name__,
                started_at=started_at,
                revision=self.revision,
            )
        return self.report

    def _busy(self, unit: Busy) -> None:
        self.progress.busy(unit, busy_message(unit, self.deadline))

    def _bring_up_to_date(self, units: Iterable[Unit], pins: Pins) -> None:
        waiting = [a for a in self.pipeline.aggregates if a.name not in self.shared]
        for position in sorted({self.pipeline.position(a.after) for a in waiting}):
            due = [a for a in waiting if self.pipeline.position(a.after) == position]
            self._first_pass(units, position + 1, due, pins)
        damaged: set[str] = set()
        made = max((self.pipeline.position(a.after) + 1 for a in waiting), default=0)
        for _ in range(_REPAIRS):
            table = self._pass(units, frozenset(damaged), made)
            made = 0
            if table is None:
                return
            damaged = self.publisher.publish(table, self._context(), self.report, pins.pin.tables)
            if not damaged:
                # What was in quarantine and is no more: corrected, changed or gone.
                for stage, key in sorted(failed_keys(self.index.rows) - failed_keys(table)):
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

    def _first_pass(self, units: Iterable[Unit], until: int, due: list[Aggregate], pins: Pins) -> None:
        for _ in range(_REPAIRS):
            self._begin()
            planner = Planner(self.pipeline, self.commits, self.index, self.shared, self.quarantined, stages=until)
            writer = IndexWriter(self.pipeline)
            with WorkSpool(planner.work(units)) as spool:
                if planner.seconds_behind:
                    self.progress.note(
                        f"a first pass builds {', '.join(a.name for a in due)}; after it, about "
                        f"{planner.seconds_behind:.0f} CPU s of work remain"
                    )
                for receipt in self._work(spool, until, f"first pass, for {', '.join(a.name for a in due)}"):
                    writer.add(receipt)
            # By it the receipts are read in the order of their units' ids.
            index = Index(writer.finish(None))
            try:
                for aggregate in due:
                    table, count = build_aggregate(aggregate, self.commits, self._receipts(index))
                    renew = aggregate.name in self.renew
                    self.shared[aggregate.name] = pins.set(aggregate, table, count, renew=renew)
                return
            except CorruptShardError as error:
                for aggregate in due:
                    discard_damaged(aggregate, self.commits, self._receipts(index))
                self.progress.note(f"{error}: this commit and others like it are rebuilt")
        raise StoreError("committed files keep getting damaged", where=self.store.url, remedy="Check the disk.")

    def _receipts(self, index: Index) -> Iterator[Receipt]:
        return index.receipts(range(len(index)), self.pipeline)

    def _pass(self, units: Iterable[Unit], again: frozenset[str], made: int) -> BatchedTable | None:
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
        with WorkSpool(planner.work(units)) as spool:
            kept = planner.kept.count()
            report.counts["fresh"] = kept
            report.counts["removed"] = len(planner.present) - planner.present.count()
            report.counts["total"] = len(spool) + kept
            for receipt in self.index.receipts(planner.kept_incomplete(), self.pipeline):
                self._count(receipt, worked=False)
            report.counts["ok"] += kept - report.counts["skipped"] - report.counts["quarantined"]
            self._within_budget()
            if not len(spool) and not report.counts["removed"] and self._index_holds() and self.publisher.sound():
                assert self.publisher.old is not None
                report.snapshot_id = self.publisher.old.snapshot_id
                return None
            for receipt in self._work(spool, len(self.pipeline.stages), "units"):
                writer.add(receipt)
        return writer.finish(self.index.rows, planner.kept)

    def _index_holds(self) -> bool:
        return not self.index.damaged and len(self.index) > 0

    def _work(self, work: WorkSpool, until: int, phase: str) -> Iterator[Receipt]:
        """Yield the receipts of all units in ``work`` as they come, and count them."""
        self.report.counts["total"] = max(self.report.counts["total"], len(work))
        queue = tasks(work, until, self.executor.workers)
        if len(work):
            self.executor.prepare(queue.seconds)
        workers = min(self.executor.workers_for(queue.seconds), max(len(work), 1))
        self.progress.phase(phase, len(work), queue.seconds, workers)
        receipts = self.executor.run(self._context(), queue)
        done = 0
        try:
            for receipt in receipts:
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
                f"{error.what}. {done} of the {len(work)} units of this pass were done; {COMMITTED}",
                remedy=error.remedy,
            ) from error
        finally:
            close = getattr(receipts, "close", None)
            if close is not None:
                close()

    def _context(self) -> RunContext:
        return RunContext(
            pipeline=self.pipeline,
            store=self.store,
            shared=self.shared,
            quarantined=self.quarantined | self.failed,
            retrying=self.retry,
            revision=self.revision,
            deadline=self.deadline,
            memory=self.memory,
            faults=self.faults,
            token=self.token,
        )

    def _count(self, receipt: Receipt, *, worked: bool = True) -> None:
        report = self.report
        if receipt.failure is not None:
            report.fail(receipt.unit_id, receipt.failure)
            self.failed.add((receipt.failure.stage, receipt.failure.key.hex()))
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
        if self.budget.exceeded(failed, total):
            raise FailureBudgetError(
                f"{failed} of {total} units are quarantined, more than the budget allows",
                remedy="condvln status CONFIG shows the causes; what was committed stays, but nothing was published.",
            )
