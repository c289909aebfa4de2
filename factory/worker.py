"""The worker: runs those stages of a unit that are not done, and commits each stage.

The same code runs inline, in a worker process and inside a Ray task. What happens to an error:

* ``TransientIOError`` from a stage: tried again, with growing pauses, then quarantined;
* a stop (``KeyboardInterrupt``, or ``Terminated`` in a worker that receives SIGTERM), though compiled code handed it on
  as another error: no fault of the unit, raised;
* ``MemoryError``, or the process outgrew its ceiling (``factory.memory``): handed back once where another try may have
  more memory, so that the driver tries again with the unit alone on a node; then quarantined;
* the store refusing (``StoreError``, no space left): no fault of the unit, so it is raised and ends the run;
* anything else from a stage: quarantined at once with its traceback.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import pyarrow as pa

from factory import machine
from factory.chain import Chain, SharedTables, receipt_of
from factory.commits import UNIT_FILE, Commits, Committed
from factory.context import RunContext
from factory.deadline import Deadline
from factory.faults import FaultPlan
from factory.garbage import collected_between_units, exempt_what_is_loaded
from factory.heartbeat import Place
from factory.kept_tables import kept_tables
from factory.key import Keyer, StageKey
from factory.memory import MemoryCeiling, release, share
from factory.pipeline import plain_name
from factory.quarantine import Failed, Quarantine, failed_by
from factory.receipt import Failure, Receipt, Status
from factory.rows import canonical_table, logical_hash
from factory.shard import SHARD_FILE
from factory.stage import Stage, StageOutput
from factory.unit import Unit, Work
from schemas.canonical import digest
from schemas.errors import (
    CorruptShardError,
    StageError,
    StoreError,
    TransientIOError,
)
from schemas.unit import Cause, KeyParts, TableRecord, UnitCommit

__all__ = ["Worker"]

PENDING: Final = "0" * 64
"""Placeholder of a file's hash until the file is written."""


class Worker:
    """Processes units, one at a time."""

    def __init__(self, context: RunContext, *, may_exit: bool = False, slots: int = 1) -> None:
        """Create the worker of this process.

        may_exit : this process may be ended when a unit hangs in compiled code
        slots : how many workers share this machine's memory; on its last try a unit has the machine to itself
        """
        exempt_what_is_loaded()
        self.context = context
        self._ceiling = MemoryCeiling(context.memory or share(slots))
        self._last_ceiling = MemoryCeiling(context.memory or share(1)) if slots > 1 else self._ceiling
        self._may_exit = may_exit
        self._deadline = Deadline(None)
        self.place = Place()
        self.pipeline = context.pipeline
        self.faults = FaultPlan.parse(context.faults) if context.faults else FaultPlan.from_environment()
        self.commits = Commits(context.store, self.faults, kept_tables(context.token))
        self.quarantine = Quarantine(context, self.commits)
        self.keyer = Keyer(context.pipeline)
        self.shared = SharedTables(self.commits, context.shared)

    def work(self, unit: Unit, until: int, fingerprint: bytes, *, attempt: int = 1, last_try: bool = False) -> Receipt:
        """Run those stages before position ``until`` that are not committed yet; return the receipt of the unit.

        attempt : how many times the unit was given to a worker, this one included
        last_try : running out of memory quarantines it, rather than handing it back
        """
        try:
            return self._work(unit, until, fingerprint, attempt, last_try)
        finally:
            self.place.leave()

    def _work(self, unit: Unit, until: int, fingerprint: bytes, attempt: int, last_try: bool) -> Receipt:
        if unit.fault is not None:
            failure = self.quarantine.refuse(unit, unit.fault)
            return Receipt(unit.unit_id, unit.partition, "quarantined", "", fingerprint, (), failure)
        self._deadline = Deadline(self.context.deadline, may_exit=self._may_exit)
        ceiling = self._last_ceiling if last_try else self._ceiling
        # Where the last try would have no more, this is the last one.
        last_try = last_try or ceiling.ceiling == self._last_ceiling.ceiling
        with collected_between_units(), ceiling.watch():
            receipt = self._tried(unit, until, fingerprint, attempt, last_try, ceiling)
        if receipt.status == "memory" or (receipt.failure is not None and receipt.failure.cause == "memory"):
            release()
        return receipt

    def _tried(
        self, unit: Unit, until: int, fingerprint: bytes, attempt: int, last_try: bool, ceiling: MemoryCeiling
    ) -> Receipt:
        for _ in range(len(self.pipeline.stages) + 1):
            chain = Chain(self.pipeline, self.keyer, self.commits, self.shared, unit)
            try:
                return self._walk(unit, chain, until, fingerprint, attempt, last_try, ceiling)
            except CorruptShardError:
                continue  # the damaged commit was removed: its stage is run again
        raise StoreError(
            f"files of {unit.unit_id} are damaged again right after they are written",
            where=self.context.store.url,
            remedy="Check the disk.",
        )

    def _walk(
        self,
        unit: Unit,
        chain: Chain,
        until: int,
        fingerprint: bytes,
        attempt: int,
        last_try: bool,
        ceiling: MemoryCeiling,
    ) -> Receipt:
        status: Status = "ok" if until == len(self.pipeline.stages) else "partial"
        reason = ""
        failure = None
        while chain.at < until:
            stage = self.pipeline.stages[chain.at]
            key: StageKey | None = None
            try:
                with ceiling.armed():
                    key = self._key(chain)
                    found = self.commits.find(stage.name, key.hex)
                    if found is None:
                        failure = self.quarantine.known(stage.name, key.hex, attempt)
                        if failure is not None:
                            status = "quarantined"
                            break
                        found, tables = self._make(unit, chain, stage, key)
                        self._keep(chain.at, until, found, tables)
                        chain.add(receipt_of(found, made=True), tables)
                    else:
                        chain.add(receipt_of(found, made=False))
            except (Failed, MemoryError) as error:
                failed = error if isinstance(error, Failed) else failed_by(error, 1)
                if failed.cause == "memory" and not last_try:
                    status = "memory"
                else:
                    failed = Failed(failed.cause, ceiling.named(failed.error), failed.attempts)
                    status = "quarantined"
                    failure = self.quarantine.put(unit, stage.name, None if key is None else key.hex, failed, attempt)
                break
            if found.commit.outcome == "skipped":
                status, reason = "skipped", found.commit.reason
                break
        return self._receipt(unit, chain, fingerprint, status, attempt, reason, failure)

    def _keep(self, at: int, until: int, made: Committed, tables: Mapping[str, pa.Table]) -> None:
        """Keep the tables of the stage at position ``at`` that stages of a later pass read."""
        read = {table for later in range(until, len(self.pipeline.stages)) for table in self.pipeline.visible(later)}
        for name in sorted(name for name, position in read if position == at):
            self.commits.keep(made.commit, name, tables[name])

    def _receipt(
        self,
        unit: Unit,
        chain: Chain,
        fingerprint: bytes,
        status: Status,
        attempts: int,
        reason: str = "",
        failure: Failure | None = None,
    ) -> Receipt:
        """Return the receipt of a unit: what was done for the unit, and how the work ended."""
        return Receipt(
            unit_id=unit.unit_id,
            partition=unit.partition,
            status=status,
            reason=reason,
            fingerprint=fingerprint,
            stages=tuple(replace(s, estimate=unit.costs.get(s.stage, 0.0)) for s in chain.done),
            failure=failure,
            attempts=attempts,
            content=self.keyer.content(unit),
        )

    def _key(self, chain: Chain) -> StageKey:
        try:
            with self._deadline.watch():
                return chain.key()
        except (StoreError, TransientIOError):
            raise
        except Exception as error:
            raise failed_by(error, 1) from error

    def _make(self, unit: Unit, chain: Chain, stage: Stage, key: StageKey) -> tuple[Committed, Mapping[str, pa.Table]]:
        self.faults.reach("unit-before-run")
        machine.reset_peak_rss()
        started, cpu = time.perf_counter(), time.process_time()
        self.place.enter(unit.unit_id, stage.name)
        output, tables = self._run(unit, chain, stage)
        records = {}
        for name, table in tables.items():
            found, size = logical_hash(table)
            records[name] = TableRecord(
                sha256=PENDING,
                bytes=0,
                logical_hash=found,
                rows=table.num_rows,
                logical_bytes=size,
            )
        commit = UnitCommit(
            unit_id=unit.unit_id,
            partition=unit.partition,
            stage=stage.name,
            stage_version=stage.version,
            key=key.hex,
            key_parts=KeyParts(
                code=key.code.hex(),
                inputs=key.inputs.hex(),
                parameters=key.parameters.hex(),
                dependencies=key.dependencies.hex(),
            ),
            outcome=output.outcome,
            reason=output.reason,
            tables=records,
            files={},
            measures=output.measures,
            seconds=time.perf_counter() - started,
            cpu_seconds=time.process_time() - cpu,
            peak_rss=machine.peak_rss(),
            host=machine.host(),
            libraries=machine.library_versions(),
            revision=self.context.revision,
        )
        committed = self.commits.save(commit, tables, output.files)
        if self.context.retrying:
            self.commits.release(stage.name, key.hex)
        return committed, tables

    def _run(self, unit: Unit, chain: Chain, stage: Stage) -> tuple[StageOutput, dict[str, pa.Table]]:
        """Run the stage, with retries on transient faults, and convert its tables to canonical form."""
        pause = self.context.transient_pause
        for attempt in range(1, self.context.transient_tries + 1):
            try:
                with self._deadline.watch():
                    output = stage.run(unit, chain.upstream(), chain.shared())
                return output, self._checked(stage, output)
            except StoreError:
                raise
            except TransientIOError as error:
                if attempt == self.context.transient_tries:
                    raise Failed("input", error, attempt) from error
                time.sleep(pause)
                pause *= 4
            except OSError as error:
                if error.errno in (errno.ENOSPC, errno.EDQUOT):
                    raise StoreError(
                        f"no space left while {stage.name} ran for {unit.unit_id}",
                        remedy="Free some space and run again; what was committed stays.",
                    ) from error
                raise Failed("error", error, attempt) from error
            except (Exception, SystemExit) as error:
                raise failed_by(error, attempt) from error
        raise AssertionError("unreachable")

    def _checked(self, stage: Stage, output: StageOutput) -> dict[str, pa.Table]:
        undeclared = set(output.tables) - set(stage.tables)
        if undeclared:
            raise StageError(f"stage {stage.name!r} wrote tables it does not declare: {sorted(undeclared)}")
        tables = {}
        for name, spec in self.pipeline.stage_tables(stage):
            if name in output.tables:
                tables[name] = canonical_table(output.tables[name], spec, name)
            elif output.outcome != "skipped":
                raise StageError(f"stage {stage.name!r} declares table {name!r} and did not write it")
            elif spec is not None:
                tables[name] = canonical_table(spec.schema.empty_table(), spec, name)
        for name in output.files:
            if not plain_name(name):
                raise StageError(f"stage {stage.name!r} wrote a file under {name!r}, which is not a plain file name")
            if name in (UNIT_FILE, SHARD_FILE):
                raise StageError(f"stage {stage.name!r} wrote a file under the reserved name {name!r}")
        return tables

    def blame(
        self, work: Work, until: int, cause: Cause, exception: str, message: str, attempts: int, peak_rss: int = 0
    ) -> Receipt:
        """Quarantine a unit that killed its workers. The record names the first stage of the unit that is not
        committed.

        peak_rss : bytes that its worker held when it was ended, where that is known

        Called by the driver, which runs no stage: it walks over what is committed.
        """
        unit = work.unit
        chain = Chain(self.pipeline, self.keyer, self.commits, self.shared, unit)
        stage, key = self.pipeline.stages[0].name, digest([unit.unit_id, message])[:32]
        while chain.at < until:
            stage = self.pipeline.stages[chain.at].name
            try:
                key = chain.key().hex
            except (StoreError, TransientIOError):
                raise
            except Exception:
                break
            found = self.commits.find(stage, key)
            if found is None:
                break
            chain.add(receipt_of(found, made=False))
        failure = self.quarantine.record(
            unit, stage, key, cause, exception, message, attempts=attempts, peak_rss=peak_rss
        )
        return self._receipt(unit, chain, work.fingerprint, "quarantined", attempts, failure=failure)
