"""Reports of a run: while it goes on (``Progress``, time left), and when it is done (``RunReport``)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Final, Protocol

from factory import machine
from factory.heartbeat import Busy
from factory.receipt import Failure, Receipt
from factory.store import Store
from schemas.snapshot import RunFailure, RunRecord

__all__ = [
    "ABORTED",
    "DONE",
    "WITH_QUARANTINE",
    "FailureBudget",
    "Progress",
    "Remaining",
    "RunReport",
    "Silence",
    "readable",
]

DONE: Final = 0
WITH_QUARANTINE: Final = 3
ABORTED: Final = 4

LISTED_FAILURES: Final = 1000
"""Number of failures that a report lists; the index and the quarantine have all of them."""


RECORDED_FAILURES: Final = 100
"""Number of failures that a run's record lists."""


@dataclass(frozen=True)
class FailureBudget:
    """The maximum number of units that may be quarantined before a run stops: a number, or a share of all units."""

    units: int | None = None
    share: float | None = None

    @classmethod
    def of(cls, value: FailureBudget | float | None) -> FailureBudget:
        """Parse a budget: a whole number counts units, a fraction is a share, None means no limit."""
        if isinstance(value, FailureBudget):
            return value
        if value is None:
            return cls()
        return cls(share=value) if isinstance(value, float) else cls(units=int(value))

    def exceeded(self, failed: int, units: int) -> bool:
        """Whether ``failed`` quarantined units out of ``units`` exceed this budget."""
        if self.units is not None and failed > self.units:
            return True
        return self.share is not None and failed > self.share * units


class Progress(Protocol):
    """Receives the events of a run, to draw, log or measure them. Called from the driver's thread, except ``busy``."""

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        """Called when a phase begins, with its name, number of steps, expected CPU seconds, and number of workers."""
        ...

    def unit(self, receipt: Receipt) -> None:
        """Called when a unit is finished, whether it succeeded or failed."""
        ...

    def step(self) -> None:
        """Called when a step of a phase without units is done (a file is packed)."""
        ...

    def note(self, message: str) -> None:
        """Called with a message for the user."""
        ...

    def busy(self, unit: Busy, message: str) -> None:
        """Called when a unit is taking unusually long, from another thread than the other calls."""
        ...


class Silence:
    """Progress that shows nothing."""

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None: ...

    def unit(self, receipt: Receipt) -> None: ...

    def step(self) -> None: ...

    def note(self, message: str) -> None: ...

    def busy(self, unit: Busy, message: str) -> None: ...


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

    def write(
        self, store: Store, *, token: str, pipeline: str, ref: str, executor: str, started_at: str, revision: str
    ) -> None:
        """Leave a record of the run in the store: ``runs/<started_at>-<token>.json``."""
        failures = [
            RunFailure(
                unit_id=unit_id,
                stage=failure.stage,
                key=failure.key.hex(),
                cause=failure.cause,
                exception=failure.exception,
                message=failure.message,
                attempts=failure.attempts,
            )
            for unit_id, failure in self.failures[:RECORDED_FAILURES]
        ]
        record = RunRecord(
            token=token,
            pipeline=pipeline,
            ref=ref,
            executor=executor,
            started_at=started_at,
            seconds=round(self.seconds, 3),
            exit_code=self.exit_code,
            snapshot_id=self.snapshot_id,
            published=self.published,
            counts=dict(self.counts),
            stages=dict(self.stages),
            stage_seconds={name: round(seconds, 3) for name, seconds in self.stage_seconds.items()},
            peak_rss=self.peak_rss,
            failures=failures,
            message=self.message,
            host=machine.host(),
            revision=revision,
        )
        self.record = f"runs/{started_at}-{token}.json"
        store.write(self.record, record.model_dump_json(indent=1).encode())


PRIOR_SECONDS: Final = 5.0
"""Weight of the model's own estimate, in CPU seconds of done work, so that the first receipt, which pays for imports
and caches, does not decide alone."""


class Remaining:
    """Estimates the wall-clock seconds that are left in a phase.

    seconds : CPU seconds expected of the whole phase
    workers : how many share them
    """

    def __init__(self, seconds: float, workers: int = 1) -> None:
        self._expected = seconds
        self._workers = max(workers, 1)
        self._done = 0.0
        self._took = 0.0

    def unit(self, receipt: Receipt) -> None:
        """Count a finished unit. Its wall-clock time, rather than its CPU time, sets the pace, since other processes
        may share the machine.
        """
        self._done += receipt.expected
        self._took += receipt.seconds

    @property
    def seconds(self) -> float:
        """Return the expected wall-clock seconds left: the CPU seconds left ÷ workers × the pace so far. The pace is
        the number of wall-clock seconds per expected CPU second.
        """
        pace = (self._took + PRIOR_SECONDS) / (self._done + PRIOR_SECONDS)
        return max(self._expected - self._done, 0.0) * pace / self._workers


def readable(seconds: float) -> str:
    """Format a duration: ``45 s``, ``12 min``, ``3 h 20 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
