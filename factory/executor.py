"""Tasks and their order, the interface of executors, and the executor that works in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol, TypeVar

from factory.packing import Packed, PackJob, pack
from factory.pipeline import RunContext
from factory.receipt import Receipt
from factory.report import Busy
from factory.stage import Work
from factory.worker import Worker

__all__ = ["Executor", "InlineExecutor", "Task", "Warm", "tasks"]

TASK_SECONDS: Final = 2.0
"""Expected CPU seconds up to which units share a task, so that handing out a task costs below 1 %."""

TASK_UNITS: Final = 64
"""Most units of a task, so that their receipts (2 kB each at most) can be returned directly."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Task:
    """Units that are handed out together.

    until : number of stages to make
    attempt : how many times these units were given out, this one included
    last_try : running out of memory quarantines
    memory : estimated bytes at the peak
    """

    work: tuple[Work, ...]
    until: int
    attempt: int = 1
    last_try: bool = False
    memory: int = 0


def tasks(work: Sequence[Work], until: int, workers: int) -> Iterator[Task]:
    """Yield the tasks of a pass, the largest units first, so that no large unit is left to run alone at the end; tiny
    units share a task. One worker alone takes the smallest first, so that a unit that never ends keeps no other from
    being committed. Units of equal cost keep the order that they came in.

    until : number of stages to make
    workers : how many share the work
    """
    # Towards the end all workers should stay busy, so no task takes more than a small part of one worker's share.
    target = min(TASK_SECONDS, sum(item.seconds for item in work) / (4 * workers))
    ordered = sorted(work, key=lambda item: item.seconds if workers == 1 else -item.seconds)
    held: list[Work] = []
    for at, item in enumerate(ordered, 1):
        held.append(item)
        if at == len(ordered) or len(held) >= TASK_UNITS or sum(item.seconds for item in held) >= target:
            yield Task(tuple(held), until, memory=max(item.memory for item in held))
            held = []


class Executor(Protocol):
    """Runs tasks in any order and yields one receipt per finished unit."""

    @property
    def workers(self) -> int:
        """Return the largest number of units that are processed at once."""
        ...

    def begin(self, seconds: float) -> int:
        """Get ready for work of so many CPU seconds in total; return how many units will be processed at once. Called
        before work is handed out, and not at all where there is none.

        Raises ``UsageError`` and ``ClusterError`` when Ray can't be used.
        """
        ...

    def busy(self) -> Sequence[Busy]:
        """Return the units that are known to be under way; called from another thread while ``run`` goes on."""
        ...

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        """Run ``tasks``. When the iterator is closed, no further task is started; commits stay.

        Each receipt holds what was expected of its unit. Raises ``ClusterError`` when Ray does not answer any more.
        """
        ...

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        """Write the files of a snapshot."""
        ...

    def streams(
        self, function: Callable[[Item], Iterator[Result]], items: Sequence[Item], name: str
    ) -> list[Iterator[Result]]:
        """Start a generator for each item, all at once where there are workers; return what each yields."""
        ...


Warm = Callable[[Executor], None]
"""Called once, before the first work, with the executor that does it."""


class InlineExecutor:
    """Works in this process, one unit after the other: for small runs and debugging."""

    workers = 1

    def __init__(self, warm: Warm = lambda executor: None) -> None:
        self._warm = warm
        self._begun = False
        self._worker: Worker | None = None

    def begin(self, seconds: float) -> int:
        if not self._begun:
            self._warm(self)
            self._begun = True
        return 1

    def busy(self) -> Sequence[Busy]:
        return [] if self._worker is None else self._worker.busy()

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        worker = self._worker = Worker(context)
        for task in tasks:
            for item in task.work:
                # Another try would have no more memory.
                receipt = worker.work(item.unit, task.until, item.fingerprint, last_try=True)
                yield replace(receipt, expected=item.seconds)

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        for job in jobs:
            yield pack(context.store, context.pipeline, job)

    def streams(self, function: Callable[[Any], Iterator[Any]], items: Sequence[Any], name: str) -> list[Iterator[Any]]:
        return [function(item) for item in items]
