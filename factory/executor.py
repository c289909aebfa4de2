"""The interface of executors, and the executor that works in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from factory.context import RunContext
from factory.heartbeat import Busy
from factory.packing import Packed, PackJob, pack
from factory.preload import NOTHING, Preload
from factory.receipt import Receipt
from factory.unit import Work
from factory.worker import Worker

__all__ = ["Executor", "InlineExecutor", "Task"]


@dataclass(frozen=True, slots=True)
class Task:
    """Units that are handed out together.

    until : number of stages to make
    attempt : how many times these units were given out, this one included
    last_try : running out of memory quarantines
    memory : estimated bytes at the peak
    alone : nothing else of the run may be at work on its node, so that what happens there is its own doing
    """

    work: tuple[Work, ...]
    until: int
    attempt: int = 1
    last_try: bool = False
    memory: int = 0
    alone: bool = False

    @property
    def seconds(self) -> float:
        """Return the estimated seconds of all units."""
        return sum(item.seconds for item in self.work)


class Executor(Protocol):
    """Runs tasks in any order and yields one receipt per finished unit."""

    @property
    def workers(self) -> int:
        """Return how many units are processed at once."""
        ...

    def workers_for(self, seconds: float) -> int:
        """Return how many units would be processed at once in a run whose expected cost is ``seconds`` CPU seconds in
        total.
        """
        ...

    def prepare(self, seconds: float) -> None:
        """Get ready for tasks whose expected cost is ``seconds`` CPU seconds in total; called before the tasks are
        handed out, and not at all where there are none.
        """
        ...

    def busy(self) -> Sequence[Busy]:
        """Return the units that are known to be under way; called from another thread while ``run`` goes on."""
        ...

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        """Run ``tasks``. When the iterator is closed, no further task is started; commits stay.

        Each receipt holds what was expected of its unit. Raises ``ClusterError`` when Ray, or the process that starts
        workers, dies.
        """
        ...

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        """Write the files of a snapshot."""
        ...


class InlineExecutor:
    """Works in this process, one unit after the other, the smallest first: for small runs and debugging."""

    workers = 1

    def __init__(self, preload: Preload = NOTHING, note: Callable[[str], None] = lambda _: None) -> None:
        """Create the executor.

        preload : called before the first task
        note : shows what `preload` says
        """
        self._preload = preload
        self._note = note
        self._prepared = False
        self._worker: Worker | None = None

    def workers_for(self, seconds: float) -> int:
        return 1

    def prepare(self, seconds: float) -> None:
        if not self._prepared:
            self._preload.load(self._note)
            self._prepared = True

    def busy(self) -> Sequence[Busy]:
        found = None if self._worker is None else self._worker.place.busy()
        return [] if found is None else [found]

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        worker = self._worker = Worker(context)
        smallest_first = getattr(tasks, "smallest_first", None)
        for task in tasks if smallest_first is None else smallest_first():
            for item in task.work:
                receipt = self._one(worker, task, item, last_try=task.last_try)
                if receipt.status == "memory":
                    receipt = self._one(worker, task, item, last_try=True)
                yield replace(receipt, expected=item.seconds)

    def _one(self, worker: Worker, task: Task, item: Work, *, last_try: bool) -> Receipt:
        attempt = task.attempt + (last_try and not task.last_try)
        return worker.work(item.unit, task.until, item.fingerprint, attempt=attempt, last_try=last_try)

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        for job in jobs:
            yield pack(context.store, context.pipeline, job, context.faults)
