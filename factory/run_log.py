"""The structured log of a run: one JSON line per event and per unit, written as it happens."""

from __future__ import annotations

import json
import threading
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import Any

from factory.heartbeat import Busy
from factory.receipt import Receipt
from factory.report import Progress, Silence
from schemas.errors import StoreError

__all__ = ["RunLog"]


class RunLog:
    """A ``Progress`` that writes each event to a log file and passes it on. Every line has ``at`` (UTC) and ``event``.

    path : appended to; its folder is made
    inner : progress that receives the same calls (a bar)

    Raises ``StoreError`` where the file can't be written.
    """

    def __init__(self, path: Path, inner: Progress | None = None) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(path, "a", encoding="utf-8", buffering=1)  # noqa: SIM115 - closed by close()
        except OSError as error:
            raise StoreError(
                f"the log can't be written: {error.strerror}", where=path, remedy="Check disk and permissions."
            ) from error
        self._inner = inner or Silence()
        self._lock = threading.Lock()

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        """Log that a phase begins."""
        self._line("phase", name=name, total=total, estimated_cpu_seconds=round(seconds, 3), workers=workers)
        self._inner.phase(name, total, seconds, workers)

    def unit(self, receipt: Receipt) -> None:
        """Log a finished unit: the result of each stage, and the cause if it failed."""
        stages = [
            {
                "stage": stage.stage,
                "key": stage.key.hex(),
                "made": stage.made,
                "seconds": round(stage.seconds, 4),
                "cpu_seconds": round(stage.cpu_seconds, 4),
                "peak_rss": stage.peak_rss,
                "rows": {table.table: table.rows for table in stage.tables},
            }
            for stage in receipt.stages
        ]
        fields: dict[str, Any] = {
            "unit": receipt.unit_id,
            "partition": receipt.partition,
            "status": receipt.status,
            "attempts": receipt.attempts,
            "seconds": round(receipt.seconds, 4),
            "expected_cpu_seconds": round(receipt.expected, 4),
            "stages": stages,
        }
        if receipt.reason:
            fields["reason"] = receipt.reason
        if receipt.failure is not None:
            failure = receipt.failure
            fields["failure"] = {
                "stage": failure.stage,
                "key": failure.key.hex(),
                "cause": failure.cause,
                "exception": failure.exception,
                "message": failure.message,
                "known": failure.known,
                "attempts": failure.attempts,
            }
        self._line("unit", **fields)
        self._inner.unit(receipt)

    def step(self) -> None:
        """Log that a step of a phase without units is done."""
        self._inner.step()

    def note(self, message: str) -> None:
        """Log a message for the user."""
        self._line("note", message=message)
        self._inner.note(message)

    def busy(self, unit: Busy, message: str) -> None:
        """Log that a unit is taking unusually long."""
        self._line("busy", unit=unit.unit_id, stage=unit.stage, seconds=round(unit.seconds, 1))
        self._inner.busy(unit, message)

    def event(self, event: str, **fields: Any) -> None:
        """Log any other event."""
        self._line(event, **fields)

    def _line(self, event: str, **fields: Any) -> None:
        at = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        with self._lock:  # the heartbeat is a thread of its own
            self._file.write(json.dumps({"at": at, "event": event, **fields}) + "\n")

    def close(self) -> None:
        """End the log."""
        self._file.close()

    def __enter__(self) -> RunLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._line("end", error=f"{type(error).__name__}: {error}")
        self.close()
