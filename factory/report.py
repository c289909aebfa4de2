"""Reports of a run: while it goes on (``Progress``, which ``RunLog`` writes to a file and ``Heartbeat`` tells of units
that take long), and when it is done (``RunReport``).
"""

from __future__ import annotations

import json
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

from factory import machine
from factory.pipeline import RunContext
from factory.receipt import Failure, Receipt
from schemas.errors import StoreError
from schemas.snapshot import RunFailure, RunRecord

__all__ = ["ABORTED", "BUSY_SECONDS", "DONE", "WITH_QUARANTINE", "Busy", "Heartbeat", "Progress", "RunLog", "RunReport"]


BUSY_SECONDS: Final = 30.0
"""Seconds at one stage of one unit before the first message; the next comes after twice as many, and so on."""

LONGEST_SILENCE: Final = 600.0
"""Longest time in seconds between two messages about a unit that is still at the same stage."""

_PAUSE: Final = 1.0
"""Seconds between two checks."""


@dataclass(frozen=True, slots=True)
class Busy:
    """A unit under way, the stage that the unit is at, and the seconds since this stage began.

    stage : empty for a task of Ray's: its seconds count from when it was handed out
    """

    unit_id: str
    stage: str
    seconds: float

    @property
    def message(self) -> str:
        """Return one line about a unit that takes long."""
        at = f"at stage {self.stage}" if self.stage else "in a task of Ray"
        return f"{self.unit_id}: {at} for {self.seconds:.0f} s"


class Heartbeat:
    """A thread that checks which units are under way and calls `say` for those that take long; a context manager.

    look : the units under way
    say : called from the thread
    """

    def __init__(
        self,
        look: Callable[[], Iterable[Busy]],
        say: Callable[[Busy], None],
        *,
        after: float = BUSY_SECONDS,
        pause: float = _PAUSE,
    ) -> None:
        self._look = look
        self._say = say
        self._after = after
        self._pause = pause
        self._due: dict[tuple[str, str], float] = {}
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)

    def _run(self) -> None:
        while not self._end.wait(self._pause):
            self.beat()

    def beat(self) -> None:
        """Check once."""
        due = {}
        for busy in self._look():
            name = (busy.unit_id, busy.stage)
            next_one = self._due.get(name, self._after)
            if busy.seconds >= next_one:
                self._say(busy)
                next_one = busy.seconds + min(busy.seconds, LONGEST_SILENCE)
            due[name] = next_one
        self._due = due

    def __enter__(self) -> Heartbeat:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join(timeout=5.0)


DONE: Final = 0
WITH_QUARANTINE: Final = 3
ABORTED: Final = 4

LISTED_FAILURES: Final = 1000
"""Number of failures that a report and a run's record list; the index and the quarantine have all of them."""


class Progress:
    """Receives the events of a run, to draw, log or measure them; this one shows nothing. Called from the driver's
    thread, except ``busy``.
    """

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        """Called when a phase begins, with its name, number of steps, expected CPU seconds, and number of workers."""

    def unit(self, receipt: Receipt) -> None:
        """Called when a unit is finished, whether it succeeded or failed."""

    def step(self) -> None:
        """Called when a step of a phase without units is done (a file is packed)."""

    def note(self, message: str) -> None:
        """Called with a message for the user."""

    def busy(self, unit: Busy) -> None:
        """Called when a unit is taking unusually long, from another thread than the other calls."""


@dataclass
class RunReport:
    """The result of a run.

    exit_code : 0 done, 3 done with quarantined units, 4 stopped over the failure budget
    snapshot_id : what is published at the end; None when the run was stopped
    published : the ref was moved
    counts : units: total, ok, skipped, quarantined; fresh (unchanged, not looked at), made, reused (looked at, and all
        was committed already); removed
    failures : (unit id, failure), at most ``LISTED_FAILURES``
    stages : stages made just now, by name
    seconds : the run, by the clock
    message : why it was stopped, or why nothing was published (another run was faster)
    record : path in the store of the run's record; empty when there was nothing to do
    """

    exit_code: int = DONE
    snapshot_id: str | None = None
    published: bool = False
    counts: Counter[str] = field(default_factory=Counter)
    failures: list[tuple[str, Failure]] = field(default_factory=list)
    stages: Counter[str] = field(default_factory=Counter)
    stage_seconds: Counter[str] = field(default_factory=Counter)
    peak_rss: int = 0
    seconds: float = 0.0
    message: str = ""
    record: str = ""

    def fail(self, unit_id: str, failure: Failure) -> None:
        """Count a quarantined unit."""
        self.counts["quarantined"] += 1
        if len(self.failures) < LISTED_FAILURES:
            self.failures.append((unit_id, failure))

    def write(self, context: RunContext, executor: str, started_at: str) -> None:
        """Leave a record of the run in the store: ``runs/<started_at>-<token>.json``."""
        failures = []
        for unit_id, failure in self.failures:
            fields = {name: getattr(failure, name) for name in ("stage", "cause", "exception", "message", "attempts")}
            failures.append(RunFailure(unit_id=unit_id, key=failure.key.hex(), **fields))
        record = RunRecord(
            token=context.token,
            pipeline=context.pipeline.name,
            ref=context.name,
            executor=executor,
            started_at=started_at,
            seconds=round(self.seconds, 3),
            counts=dict(self.counts),
            stages=dict(self.stages),
            **{name: getattr(self, name) for name in ("exit_code", "snapshot_id", "published", "peak_rss", "message")},
            stage_seconds={name: round(seconds, 3) for name, seconds in self.stage_seconds.items()},
            failures=failures,
            host=machine.host(),
            revision=context.revision,
        )
        self.record = f"runs/{started_at}-{context.token}.json"
        context.store.write(self.record, record.model_dump_json(indent=1).encode())


class RunLog(Progress):
    """A ``Progress`` that writes each event to a log file and passes it on. Every line has ``at`` (UTC) and ``event``.

    path : appended to; its folder is made
    inner : progress that receives the same calls (a bar)

    Raises ``StoreError`` where the file can't be written.
    """

    def __init__(self, path: Path, inner: Progress | None = None) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(path, "a", encoding="utf-8", buffering=1)  # noqa: SIM115 - closed by __exit__
        except OSError as error:
            raise StoreError(
                f"the log can't be written: {error.strerror}", where=path, remedy="Check disk and permissions."
            ) from error
        self.path, self.inner = path, inner or Progress()
        self._lock = threading.Lock()

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        """Log that a phase begins."""
        self.event("phase", name=name, total=total, estimated_cpu_seconds=round(seconds, 3), workers=workers)
        self.inner.phase(name, total, seconds, workers)

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
            fields["failure"] = {**asdict(receipt.failure), "key": receipt.failure.key.hex()}
        self.event("unit", **fields)
        self.inner.unit(receipt)

    def step(self) -> None:
        """Log that a step of a phase without units is done."""
        self.inner.step()

    def note(self, message: str) -> None:
        """Log a message for the user."""
        self.event("note", message=message)
        self.inner.note(message)

    def busy(self, unit: Busy) -> None:
        """Log that a unit is taking unusually long."""
        self.event("busy", unit=unit.unit_id, stage=unit.stage, seconds=round(unit.seconds, 1))
        self.inner.busy(unit)

    def event(self, event: str, **fields: Any) -> None:
        """Log any event."""
        at = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        with self._lock:  # the heartbeat is a thread of its own
            self._file.write(json.dumps({"at": at, "event": event, **fields}) + "\n")

    def __enter__(self) -> RunLog:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if error is not None:
            self.event("end", error=f"{type(error).__name__}: {error}")
        self._file.close()
