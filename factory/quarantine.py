"""Quarantine as a worker uses it: classify an error, store a record of the failure, and shorten the record for a
receipt.
"""

from __future__ import annotations

import traceback
from datetime import datetime, timezone
from typing import Final

from factory import machine
from factory.commits import LISTING, Commits
from factory.context import RunContext
from factory.deadline import Terminated
from factory.receipt import Failure
from factory.unit import Unit
from schemas.canonical import digest
from schemas.errors import DeadlineError, InputError
from schemas.unit import Cause, QuarantineRecord

__all__ = ["Failed", "Quarantine", "failed_by"]

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
        return self.record(
            unit,
            stage,
            key or digest([unit.unit_id, stage, str(failed)])[:32],
            failed.cause,
            type(failed.error).__name__,
            str(failed.error),
            trace="".join(traceback.format_exception(failed.error)),
            attempts=max(failed.attempts, attempt),
            peak_rss=machine.peak_rss(),
        )

    def refuse(self, unit: Unit, fault: Exception) -> Failure:
        """Quarantine a unit that could not be listed, and return the short form of the record."""
        name = type(fault).__name__
        key = digest([unit.unit_id, name, str(fault)])[:32]
        trace = "".join(traceback.format_exception(fault))
        return self.record(unit, LISTING, key, _cause(fault), name, str(fault), trace=trace)

    def record(
        self,
        unit: Unit,
        stage: str,
        key: str,
        cause: Cause,
        exception: str,
        message: str,
        *,
        trace: str = "",
        attempts: int = 1,
        peak_rss: int = 0,
    ) -> Failure:
        """Write a record, and return its short form."""
        record = QuarantineRecord(
            unit_id=unit.unit_id,
            partition=unit.partition,
            stage=stage,
            key=key,
            cause=cause,
            exception=exception,
            message=message,
            traceback=trace,
            attempts=attempts,
            peak_rss=peak_rss,
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
