"""Progress of a run: a bar on a terminal, occasional lines in a log, and the log file that is kept in the store."""

from __future__ import annotations

import os
import time
from collections import Counter
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from factory.receipt import Receipt
from factory.report import Busy, RunLog, RunReport
from factory.report import Progress as RunListener
from factory.store import Store
from schemas.errors import CondVLNError

__all__ = ["LOGS", "LoggedRun", "RunProgress", "readable"]

LOGS: Final = "logs"
"""Folder of the runs' logs in a store. Each log has the name of the run's record."""

LOG_STEPS: Final = 20
"""Approximate number of lines that a phase of a run writes to a log."""

ENOUGH: Final = 0.1
"""Share of the work still to do that must be measured before a time is said: a guess from less is far off."""


class RunProgress(RunListener):
    """Shows a factory run: one bar per phase on a terminal, about LOG_STEPS lines per phase elsewhere."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            TextColumn("{task.description:<12}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
            TextColumn("{task.fields[last]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self._task: TaskID | None = None
        self._phase, self._total, self._done = "", 0, 0
        self._expected, self._reached, self._took, self._workers = 0.0, 0.0, 0.0, 1
        self._outcomes: Counter[str] = Counter()
        self._causes: set[str] = set()

    def __enter__(self) -> RunProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        """Show that a phase begins."""
        self._phase, self._total, self._done = name, total, 0
        self._expected, self._reached, self._took, self._workers = seconds, 0.0, 0.0, workers
        self._task = self._bar.add_task(name, total=total, last="", left=self._left())
        if not self._console.is_terminal and total:
            said = f"{name}: {total} to do"
            if seconds >= 1:
                shared = f", shared by {workers} workers" if workers > 1 else ""
                said += f", about {seconds:.0f} CPU s{shared}"
            self._console.print(said, highlight=False)

    def unit(self, receipt: Receipt) -> None:
        """Show that a unit is finished, whether it succeeded or failed."""
        self._outcomes[receipt.status] += 1
        if receipt.failure is not None:
            cause = receipt.failure.message
            said = "for the same reason as one before" if cause in self._causes else cause
            self._causes.add(cause)
            self._console.print(f"quarantined {receipt.unit_id}: {said}", highlight=False, markup=False)
        self._expected -= receipt.expected
        if self._done >= self._workers:  # the first unit of each worker pays for imports and caches
            self._reached += receipt.expected
            self._took += receipt.seconds
        self._advance(receipt.unit_id)

    def step(self) -> None:
        """Show that a step of a phase without units is done."""
        self._advance("")

    def note(self, message: str) -> None:
        """Show a message."""
        self._console.print(message, highlight=False, markup=False)

    def busy(self, unit: Busy) -> None:
        """Show that a unit is taking unusually long."""
        self._console.print(unit.message, highlight=False, markup=False)

    def _left(self) -> str:
        """Return the time left in this phase by the clock, at the pace of the units that are done; nothing before
        enough of them are. (Other processes may share the machine.)
        """
        if self._reached <= 0 or self._reached < ENOUGH * self._expected:
            return ""
        seconds = self._expected * self._took / self._reached / max(self._workers, 1)
        return f"{readable(seconds)} left of this pass" if seconds >= 1 and self._done < self._total else ""

    def _advance(self, last: str) -> None:
        self._done += 1
        left = self._left()
        if self._task is not None:
            self._bar.update(self._task, advance=1, last=last, left=left)
        if not self._console.is_terminal and self._done % max(1, self._total // LOG_STEPS) == 0:
            words = (f"{self._phase}: {self._done}/{self._total}", last, f"(about {left})" if left else "")
            self._console.print(" ".join(word for word in words if word), highlight=False, markup=False)


def readable(seconds: float) -> str:
    """Format a duration: ``45 s``, ``12 min``, ``3 h 20 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


class LoggedRun(RunLog):
    """The structured log of one run, one JSON line per event and scene. The log is written on this machine, and stored
    beside the run's record when the run ends.

    While the run goes, and if it is killed, the log stands in ``logs/`` of the machine's local state under the time it
    began; when it ends, in ``logs/`` of the store under the name of the run's record.

    inner : progress that receives the same calls
    """

    def __init__(self, store: Store, state: Path, inner: RunListener) -> None:
        began = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        super().__init__(state / LOGS / f"{began}-{os.getpid()}.jsonl", inner)
        self._store = store
        self._done: RunReport | None = None

    def keep(self, done: RunReport) -> None:
        """Store the log beside the run's record when the run is over. A run that had nothing to do leaves neither
        record nor log.
        """
        self._done = done
        self.event(
            "end",
            exit_code=done.exit_code,
            published=done.published,
            snapshot_id=done.snapshot_id,
            counts=dict(done.counts),
            seconds=round(done.seconds, 3),
            message=done.message,
        )

    def __enter__(self) -> LoggedRun:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        super().__exit__(kind, error, trace)
        if self._done is None:
            return  # it was stopped: its log stays where it is
        try:
            if self._done.record:
                self._store.write(f"{LOGS}/{Path(self._done.record).stem}.jsonl", self.path.read_bytes())
            self.path.unlink()
        except (CondVLNError, OSError) as refused:
            self.inner.note(f"the log of this run stays in {self.path}: {refused}")
