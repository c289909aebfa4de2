"""Dispatch of tasks to a crew of workers: how many are in flight, and what happens to a task that fails.

The crew (``RayCrew``, ``ProcessCrew``) runs tasks and tells how each ended; it retries nothing. A dead worker or node
gives its units back, one by one from then on, so that the one which kills workers is found; after ``SYSTEM_TRIES`` it
is quarantined. Running out of memory gives a unit one more try with twice the memory and a node to itself: whoever came
last may have been ended for what another holds.
"""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, Protocol

from factory.context import RunContext
from factory.executor import Task
from factory.heartbeat import Busy
from factory.packing import Packed, PackJob
from factory.receipt import Receipt
from factory.worker import Worker
from schemas.errors import StoreError, TransientIOError, WorkerError

__all__ = ["Crew", "Dispatch", "Job", "Lost", "Returned"]

SYSTEM_TRIES: Final = 3
"""Number of deaths of workers that a unit may cause before it is quarantined."""

LATE_TRIES: Final = 2
"""Number of deaths of workers past the deadline before a unit is quarantined. One may be by chance, since waiting
counts too."""

NODE_TRIES: Final = 10
"""Number of lost nodes after which a unit is quarantined: a lost spot node is not the unit's fault."""

TRANSIENT_TRIES: Final = 5
"""Number of tries of a task whose store did not answer."""

PACK_FACTOR: Final = 6
"""Memory for packing a part, as a multiple of its canonical bytes: rows read, sorted and written, with a margin."""

Job = Task | PackJob
"""What a worker is given."""


@dataclass(frozen=True, slots=True)
class Lost:
    """The end of a job that came back without a result.

    kind : ``raised``: the worker raised an error; ``memory``: the worker was ended because memory ran out; ``worker``:
        the worker died; ``node``: the machine that it ran on was lost
    peak_rss : bytes that its worker held when it was ended, where that is known
    message : Ray's account of a worker that it ended because memory ran out
    """

    error: BaseException
    kind: Literal["raised", "memory", "node", "worker"]
    message: str = ""
    peak_rss: int = 0


Returned = list[Receipt] | list[Packed] | Lost


class Crew(Protocol):
    """Workers that jobs are sent to, for one stream of jobs."""

    def room(self) -> int:
        """Return how many jobs may be in flight now."""
        ...

    def send(self, job: Job, memory: int, *, alone: bool) -> Any:
        """Hand out a job; return a hashable name of it.

        memory : bytes that it is expected to hold at most
        alone : nothing else may run on its machine meanwhile
        """
        ...

    def returned(self, flying: Sequence[Any]) -> list[tuple[Any, Returned]]:
        """Wait up to a second for one of the jobs; return (name, result) of those that came back, none if the time is
        over.

        Raises ``ClusterError`` when the crew can't go on.
        """
        ...

    def busy(self) -> list[Busy]:
        """Return the units that workers reported as taking long."""
        ...

    def left(self, flying: Sequence[Any]) -> None:
        """Take note that nobody waits for these jobs any more."""
        ...


class Watcher(Protocol):
    """Counts receipts and failures, for instance as metrics."""

    def unit(self, receipt: Receipt) -> None:
        """Count a finished unit."""
        ...

    def failed(self, kind: str) -> None:
        """Count a task that returned no receipts."""
        ...

    def in_flight(self, tasks: int) -> None:
        """Set the number of jobs in flight."""
        ...


@dataclass(frozen=True, slots=True)
class _Flight:
    """A job that was handed to the crew.

    tries : how often it was handed out, deaths of nodes not counted
    nodes : how many nodes were lost under it
    late : how many workers died under it when its deadline was over
    """

    item: Any
    tries: int = 1
    nodes: int = 0
    late: int = 0


class Dispatch:
    """Sends one stream of jobs through a crew, with a limited number in flight.

    watcher : told what comes back

    Raises ``ClusterError`` when the crew can't go on.
    """

    def __init__(self, context: RunContext, crew: Crew, watcher: Watcher | None = None) -> None:
        self._context = context
        self._crew = crew
        self._watcher = watcher
        self._flying: dict[Any, tuple[_Flight, float]] = {}
        self._again: deque[_Flight] = deque()
        # Only the driver's side of a worker: it never runs a stage.
        self._driver = Worker(context)

    def busy(self) -> list[Busy]:
        """Return the units that workers reported as taking long."""
        return self._crew.busy()

    # ---- flow

    def units(self, tasks: Iterable[Task]) -> Iterator[Receipt]:
        """Yield the receipts of all units."""
        with contextlib.closing(self._stream((_Flight(task) for task in tasks), _task_memory)) as stream:
            yield from self._receipts(stream)

    def _receipts(self, stream: Iterator[tuple[_Flight, Any]]) -> Iterator[Receipt]:
        for flight, result in stream:
            if isinstance(result, Lost):
                self._count_failed(result.kind)
                expected = {item.unit.unit_id: item.seconds for item in flight.item.work}
                for receipt in self._failed(flight, result):
                    self._count(receipt)
                    yield replace(receipt, expected=expected.get(receipt.unit_id, 0.0))
                continue
            for receipt, item in zip(result, flight.item.work, strict=True):
                if receipt.status == "memory":
                    self._count_failed("memory")
                    self._more_memory(flight, replace(flight.item, work=(item,)))
                else:
                    self._count(receipt)
                    yield replace(receipt, expected=item.seconds)

    def packs(self, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        """Yield the files that were written."""
        with contextlib.closing(self._stream((_Flight(job) for job in jobs), _pack_memory)) as stream:
            for flight, result in stream:
                if isinstance(result, Lost):
                    if flight.tries >= SYSTEM_TRIES or result.kind == "raised":
                        raise StoreError(f"{flight.item.path} could not be packed: {result.error}") from result.error
                    self._again.append(replace(flight, tries=flight.tries + 1))
                else:
                    yield from result

    def _stream(self, flights: Iterator[_Flight], memory: Callable[[Any], int]) -> Generator[tuple[_Flight, Any]]:
        """Yield (flight, what came back) of each flight. The caller may put failed flights into ``_again`` to repeat
        them.
        """
        more = True
        try:
            while True:
                while more and len(self._flying) + len(self._again) < self._crew.room():
                    flight = next(flights, None)
                    if flight is None:
                        more = False
                    else:
                        self._again.append(flight)
                while self._again and len(self._flying) < self._crew.room():
                    flight = self._again.popleft()
                    alone = isinstance(flight.item, Task) and flight.item.alone
                    name = self._crew.send(flight.item, memory(flight.item), alone=alone)
                    self._flying[name] = (flight, time.monotonic())
                self._fly(len(self._flying))
                if not self._flying:
                    return
                for name, result in self._crew.returned([*self._flying]):
                    flight, since = self._flying.pop(name)
                    limit = self._context.deadline
                    if isinstance(result, Lost) and limit is not None and time.monotonic() - since >= limit:
                        flight = replace(flight, late=flight.late + 1)
                    yield flight, result
        finally:
            self._crew.left([*self._flying])
            self._flying.clear()
            self._fly(0)

    def _count(self, receipt: Receipt) -> None:
        if self._watcher is not None:
            self._watcher.unit(receipt)

    def _count_failed(self, kind: str) -> None:
        if self._watcher is not None:
            self._watcher.failed(kind)

    def _fly(self, tasks: int) -> None:
        if self._watcher is not None:
            self._watcher.in_flight(tasks)

    # ---- failures

    def _failed(self, flight: _Flight, lost: Lost) -> Iterator[Receipt]:
        task: Task = flight.item
        error, kind = lost.error, lost.kind
        if kind == "raised":
            if isinstance(error, TransientIOError) and flight.tries < TRANSIENT_TRIES:
                time.sleep(min(0.2 * 4**flight.tries, 10.0))
                self._again.append(replace(flight, tries=flight.tries + 1))
                return
            raise error
        if kind == "memory":
            yield from self._out_of_memory(flight, lost)
            return
        tries, nodes = flight.tries + (kind == "worker"), flight.nodes + (kind == "node")
        attempts = tries + nodes - 1
        if len(task.work) == 1 and kind == "worker" and flight.late >= LATE_TRIES:
            message = (
                f"the unit ran longer than its deadline of {self._context.deadline:g} s in compiled code, which can't "
                "be interrupted, so its worker was ended"
            )
            message += f". {error}" if isinstance(error, WorkerError) else "; the worker's log shows where it was"
            yield self._driver.blame(task.work[0], task.until, "deadline", "DeadlineError", message, attempts=attempts)
            return
        if len(task.work) == 1 and (tries > SYSTEM_TRIES or nodes > NODE_TRIES):
            message = f"{attempts} workers died while they processed this unit. {error}"
            yield self._driver.blame(
                task.work[0], task.until, "worker", type(error).__name__, message, attempts=attempts
            )
            return
        # A task of many may have one that kills: from now on each goes alone, those that are committed just pass.
        for item in task.work:
            single = replace(task, work=(item,), attempt=task.attempt + 1, memory=item.memory)
            alone = len(task.work) == 1
            self._again.append(_Flight(single, tries if alone else 1, nodes, flight.late if alone else 0))

    def _out_of_memory(self, flight: _Flight, lost: Lost) -> Iterator[Receipt]:
        task: Task = flight.item
        for item in task.work:
            if task.last_try:
                message = f"out of memory with {task.memory / 2**20:.0f} MiB asked for. {lost.message}"
                yield self._driver.blame(
                    item,
                    task.until,
                    "memory",
                    type(lost.error).__name__,
                    message,
                    attempts=task.attempt,
                    peak_rss=lost.peak_rss,
                )
            else:
                self._more_memory(flight, replace(task, work=(item,), memory=item.memory))

    def _more_memory(self, flight: _Flight, task: Task) -> None:
        """Retry a task once, alone on a node, with twice the memory."""
        doubled = replace(task, attempt=task.attempt + 1, last_try=True, memory=2 * task.memory, alone=True)
        self._again.append(_Flight(doubled, flight.tries, flight.nodes))


def _task_memory(task: Task) -> int:
    return task.memory


def _pack_memory(job: PackJob) -> int:
    return PACK_FACTOR * job.logical_bytes + 64 * 1024 * 1024
