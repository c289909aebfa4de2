"""Progress of a run on a terminal (a bar) or in a log (a line now and then)."""

from __future__ import annotations

from collections import Counter
from types import TracebackType
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from factory.receipt import Receipt

__all__ = ["RunProgress"]

LOG_STEPS: Final = 20
"""Lines that a phase of a run leaves in a log, about."""


class RunProgress:
    """Draws a factory run: one bar a phase on a terminal, about LOG_STEPS lines a phase elsewhere."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            TextColumn("{task.description:<12}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[last]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self._task: TaskID | None = None
        self._phase, self._total, self._done = "", 0, 0
        self._outcomes: Counter[str] = Counter()

    def __enter__(self) -> RunProgress:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def phase(self, name: str, total: int, seconds: float) -> None:
        """A phase begins."""
        self._phase, self._total, self._done = name, total, 0
        self._task = self._bar.add_task(name, total=total, last="")
        if not self._console.is_terminal and total:
            self._console.print(f"{name}: {total} to do, about {seconds:.0f} s of one worker", highlight=False)

    def unit(self, receipt: Receipt) -> None:
        """A unit is done, well or not."""
        self._outcomes[receipt.status] += 1
        if receipt.failure is not None:
            self._console.print(
                f"quarantined {receipt.unit_id}: {receipt.failure.message}", highlight=False, markup=False
            )
        self._advance(receipt.unit_id)

    def step(self) -> None:
        """A step of a phase without units is done."""
        self._advance("")

    def note(self, message: str) -> None:
        """Something a person should know."""
        self._console.print(message, highlight=False, markup=False)

    def _advance(self, last: str) -> None:
        self._done += 1
        if self._task is not None:
            self._bar.update(self._task, advance=1, last=last)
        if not self._console.is_terminal and self._done % max(1, self._total // LOG_STEPS) == 0:
            self._console.print(f"{self._phase}: {self._done}/{self._total} {last}", highlight=False, markup=False)
