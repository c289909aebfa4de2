"""The worker: runs those stages of a unit that are not done, and commits each stage.

The same code runs inline, in a worker process and inside a Ray task. What happens to an error:

* ``TransientIOError`` from a stage: tried again, with growing pauses, then quarantined;
* a stop (``KeyboardInterrupt``, or ``Terminated`` in a worker that receives SIGTERM), though compiled code handed it on
  as another error: no fault of the unit, raised;
* ``MemoryError``, also because a request exceeds the limit of the process (``factory.machine``): handed back once where
  another try may have more memory; then quarantined;
* the store refusing (``StoreError``, no space left): no fault of the unit, so it is raised and ends the run;
* anything else from a stage: quarantined at once with its traceback.
"""

from __future__ import annotations

import errno
import time
import traceback
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime, timezone
from typing import Any, Final

import pyarrow as pa

from factory import machine
from factory.chain import Chain, Keyer, SharedTables, StageKey, receipt_of
from factory.commits import LISTING, UNIT_FILE, Commits, Committed, table_file
from factory.deadline import Deadline, Terminated
from factory.machine import limited_memory, named, share
from factory.pipeline import RunContext, plain_name
from factory.receipt import Failure, Receipt, Status
from factory.report import Busy
from factory.rows import canonical_table, logical_hash
from factory.stage import Stage, StageOutput, Unit, Work
from schemas.canonical import digest
from schemas.errors import (
    CorruptShardError,
    DeadlineError,
    InputError,
    StageError,
    StoreError,
    TransientIOError,
)
from schemas.unit import Cause, KeyParts, QuarantineRecord, TableRecord, UnitCommit

__all__ = ["Failed", "Quarantine", "Worker", "failed_by"]


MESSAGE_LENGTH: Final = 300
"""Longest message in a receipt, characters; the record has the whole message."""


class Failed(Exception):
    """Raised when a stage failed and its unit must go to quarantine."""

    def __init__(self, cause: Cause, error: BaseException, attempts: int) -> None:
        super().__init__(str(error))
        self.cause = cause
        self.error = error
        self.attempts = attempts


def failed_by(error: BaseException, attempts: int) -> Failed:
    """Return ``error`` wrapped in a ``Failed`` that names the cause of the failure.

    What a signal's handler raised while compiled code ran is handed on by numba's dispatcher as the cause of a
    ``SystemError``. Raises ``KeyboardInterrupt`` and ``Terminated`` again: a process was stopped, the unit is sound.
    """
    while isinstance(error, SystemError) and error.__cause__ is not None:
        error = error.__cause__
    if isinstance(error, (KeyboardInterrupt, Terminated)):
        raise error
    return Failed(_cause(error), error, attempts)


class Quarantine:
    """Reads and writes records of failures for one run."""

    def __init__(self, context: RunContext, commits: Commits) -> None:
        self._context = context
        self._commits = commits

    def known(self, stage: str, key: str, attempt: int) -> Failure | None:
        """Return the recorded failure that keeps the stage from being tried again, or None if the stage may run. The
        record is from an earlier run, or from an earlier attempt of this run.
        """
        listed = (stage, key) in self._context.quarantined
        if not listed and attempt == 1:
            return None
        record = self._commits.quarantine_record(stage, key)
        if record is None or not (listed or record.run == self._context.token):
            return None
        return _failure(record, known=True)

    def put(self, unit: Unit, stage: str, key: str | None, failed: Failed, attempt: int) -> Failure:
        """Record the error that a stage of the unit raised.

        key : None where it could not even be computed: it is stood in for by what is known
        """
        name, message = type(failed.error).__name__, str(failed.error)
        trace = "".join(traceback.format_exception(failed.error))
        attempts = max(failed.attempts, attempt)
        key = key or digest([unit.unit_id, stage, name, message])[:32]
        peak = 0 if unit.fault is not None else machine.peak_rss()
        said = {"cause": failed.cause, "exception": name, "message": message, "traceback": trace}
        return self.record(unit, stage, key, **said, attempts=attempts, peak_rss=peak)

    def record(self, unit: Unit, stage: str, key: str, **what: Any) -> Failure:
        """Write a record of `what` happened, by the names of its fields, and return its short form."""
        record = QuarantineRecord(
            unit_id=unit.unit_id,
            partition=unit.partition,
            stage=stage,
            key=key,
            **what,
            host=machine.host(),
            revision=self._context.revision,
            run=self._context.token,
            recorded_at=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        )
        self._commits.quarantine(record)
        return _failure(record)


def _failure(record: QuarantineRecord, known: bool = False) -> Failure:
    return Failure(
        stage=record.stage,
        key=bytes.fromhex(record.key),
        cause=record.cause,
        exception=record.exception,
        message=record.message[:MESSAGE_LENGTH],
        known=known,
        attempts=record.attempts,
    )


def _cause(error: BaseException) -> Cause:
    if isinstance(error, MemoryError):
        return "memory"
    if isinstance(error, DeadlineError):
        return "deadline"
    return "input" if isinstance(error, InputError) else "error"


TRANSIENT_TRIES: Final = 3
"""How often a stage may raise ``TransientIOError`` before its unit is quarantined."""

PENDING: Final = "0" * 64
"""Placeholder of a file's hash until the file is written."""


class Worker:
    """Processes units, one at a time."""

    def __init__(self, context: RunContext, *, may_exit: bool = False, slots: int = 1) -> None:
        """Create the worker of this process.

        may_exit : this process may be ended when a unit hangs in compiled code
        slots : how many workers share this machine's memory; on its last try a unit may take twice its share of it
        """
        self.context = context
        self._ceiling = context.memory or share(slots)
        self._last_ceiling = self._ceiling
        if context.memory is None and self._ceiling is not None and slots > 1:
            self._last_ceiling = max(min(2 * self._ceiling, share(1) or 0), self._ceiling)
        self._may_exit = may_exit
        self._deadline = Deadline(None)
        self._at: tuple[str, str, float] | None = None
        self.pipeline = context.pipeline
        self.commits = Commits(context.store)
        self.quarantine = Quarantine(context, self.commits)
        self.keyer = Keyer(context.pipeline)
        self.shared = SharedTables(self.commits, context.shared)

    def work(self, unit: Unit, until: int, fingerprint: bytes, *, attempt: int = 1, last_try: bool = False) -> Receipt:
        """Run those stages before position ``until`` that are not committed yet; return the receipt of the unit.

        attempt : how many times the unit was given to a worker, this one included
        last_try : running out of memory quarantines it, rather than handing it back
        """
        if unit.fault is not None:
            failure = self.quarantine.put(unit, LISTING, None, failed_by(unit.fault, 1), 1)
            return Receipt(unit.unit_id, unit.partition, "quarantined", "", fingerprint, (), failure)
        self._deadline = Deadline(self.context.deadline, may_exit=self._may_exit)
        ceiling = self._last_ceiling if last_try else self._ceiling
        # Where the last try would have no more, this is the last one.
        last_try = last_try or ceiling == self._last_ceiling
        try:
            return self._tried(unit, until, fingerprint, attempt, last_try, ceiling)
        finally:
            self._at = None

    def busy(self) -> list[Busy]:
        """Return the unit and stage under way, if any; called from another thread."""
        at = self._at
        return [] if at is None else [Busy(at[0], at[1], time.monotonic() - at[2])]

    def _tried(
        self, unit: Unit, until: int, fingerprint: bytes, attempt: int, last_try: bool, ceiling: int | None
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
        ceiling: int | None,
    ) -> Receipt:
        status: Status = "ok" if until == len(self.pipeline.stages) else "partial"
        reason = ""
        failure = None
        while chain.at < until:
            stage = self.pipeline.stages[chain.at]
            key: StageKey | None = None
            try:
                with limited_memory(ceiling):
                    key = self._key(chain)
                    found = self.commits.find(stage.name, key.hex)
                    if found is None:
                        failure = self.quarantine.known(stage.name, key.hex, attempt)
                        if failure is not None:
                            status = "quarantined"
                            break
                        found, tables = self._make(unit, chain, stage, key)
                        chain.add(receipt_of(found, made=True), tables)
                    else:
                        chain.add(receipt_of(found, made=False))
            except (Failed, MemoryError) as error:
                failed = error if isinstance(error, Failed) else failed_by(error, 1)
                raised = failed.error
                if failed.cause == "memory" and not last_try:
                    status = "memory"
                else:
                    failed = Failed(failed.cause, named(failed.error, ceiling), failed.attempts)
                    status = "quarantined"
                    failure = self.quarantine.put(unit, stage.name, None if key is None else key.hex, failed, attempt)
                # The error refers to the frames of the stage; what these held is freed here.
                traceback.clear_frames(raised.__traceback__)
                break
            if found.commit.outcome == "skipped":
                status, reason = "skipped", found.commit.reason
                break
        return _receipt(unit, chain, fingerprint, status, attempt, reason, failure)

    def _key(self, chain: Chain) -> StageKey:
        try:
            with self._deadline.watch():
                return chain.key()
        except (StoreError, TransientIOError):
            raise
        except Exception as error:
            raise failed_by(error, 1) from error

    def _make(self, unit: Unit, chain: Chain, stage: Stage, key: StageKey) -> tuple[Committed, Mapping[str, pa.Table]]:
        machine.reset_peak_rss()
        started, cpu = time.perf_counter(), time.process_time()
        self._at = (unit.unit_id, stage.name, time.monotonic())
        output, tables = self._run(unit, chain, stage)
        records = {}
        for name, table in tables.items():
            found, size = logical_hash(table)
            rows = table.num_rows
            records[name] = TableRecord(sha256=PENDING, bytes=0, logical_hash=found, rows=rows, logical_bytes=size)
        commit = UnitCommit(
            unit_id=unit.unit_id,
            partition=unit.partition,
            stage=stage.name,
            stage_version=stage.version,
            key=key.hex,
            key_parts=KeyParts(**{part: getattr(key, part).hex() for part in KeyParts.model_fields}),
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
        for attempt in range(1, TRANSIENT_TRIES + 1):
            try:
                with self._deadline.watch():
                    output = stage.run(unit, chain.upstream(), chain.shared())
                return output, self._checked(stage, output)
            except StoreError:
                raise
            except TransientIOError as error:
                if attempt == TRANSIENT_TRIES:
                    raise Failed("input", error, attempt) from error
                time.sleep(0.2 * 4 ** (attempt - 1))
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
            if name == UNIT_FILE or name in map(table_file, tables):
                raise StageError(f"stage {stage.name!r} wrote a file under the reserved name {name!r}")
        return tables

    def blame(self, work: Work, until: int, cause: Cause, exception: str, message: str, attempts: int) -> Receipt:
        """Quarantine a unit that killed its workers. The record names the first stage of the unit that is not
        committed.

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
        said = {"cause": cause, "exception": exception, "message": message}
        failure = self.quarantine.record(unit, stage, key, **said, attempts=attempts)
        return _receipt(unit, chain, work.fingerprint, "quarantined", attempts, failure=failure)


def _receipt(
    unit: Unit,
    chain: Chain,
    fingerprint: bytes,
    status: Status,
    attempts: int,
    reason: str = "",
    failure: Failure | None = None,
) -> Receipt:
    """Return the receipt of a unit: what was done for the unit, and how the work ended."""
    stages = tuple(replace(made, estimate=unit.costs.get(made.stage, 0.0)) for made in chain.done)
    return Receipt(unit.unit_id, unit.partition, status, reason, fingerprint, stages, failure, attempts)
