"""A crew of worker processes, without Ray: which job goes to which process, and when."""

from __future__ import annotations

import pickle
import sys
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from typing import Final

from factory import machine
from factory.context import RunContext
from factory.dispatch import Job, Lost, Returned
from factory.heartbeat import Busy
from factory.memory import SHARE
from factory.processes import REMEDY, Processes, WorkerProcess
from schemas.errors import ClusterError, WorkerError

__all__ = ["ProcessCrew"]

STILLBORN: Final = 3
"""Number of workers that may die one after the other before they have loaded what the run is made of."""


@dataclass
class ProcessCrew:
    """The workers of one dispatch: at most `most` processes, which get the dispatch's context when they are first used.

    A job begins when a process and its memory are free, in the order in which jobs were sent.
    """

    context: RunContext
    processes: Processes
    most: int
    _waiting: deque[tuple[int, Job, int, bool]] = field(default_factory=deque)
    _stillborn: int = 0

    def __post_init__(self) -> None:
        self.left(())  # ends what an interrupted ``left`` of another crew has not
        self._number = next(self.processes.numbers)
        self._shipped = pickle.dumps((self.context, self.most))
        self._memory = int(SHARE * machine.memory_available()) or sys.maxsize

    def room(self) -> int:
        """Return how many jobs may be in flight."""
        return self.most

    def busy(self) -> list[Busy]:
        """Return the units that workers reported as taking long."""
        found = [process.busy for process in [*self.processes.all]]
        return [Busy(*busy, endable=True) for busy in found if busy is not None]

    def send(self, job: Job, memory: int, *, alone: bool) -> int:
        """Hand out a job; return its number."""
        number = next(self.processes.numbers)
        self._waiting.append((number, job, min(memory, self._memory), alone))
        self._begin()
        return number

    def _begin(self) -> None:
        """Begin those jobs for which there is room."""
        while self._waiting:
            working = [process.job for process in self.processes.all if process.job is not None]
            _, _, memory, alone = self._waiting[0]
            if working and (
                alone
                or len(working) >= self.most
                or working[0][3]
                or memory + sum(other[2] for other in working) > self._memory
            ):
                return
            self._give(self._waiting.popleft())

    def _give(self, item: tuple[int, Job, int, bool]) -> None:
        content = pickle.dumps(item[1])
        while True:
            idle = [p for p in self.processes.all if p.job is None and not self.processes.dead(p)]
            process = idle[0] if idle else self.processes.fork()
            process.job = item  # before anything is sent: if this is interrupted, ``left`` ends the process
            began = process.ready  # with this run, or with one before it
            try:
                if process.serves != self._number:
                    process.ready = False
                    process.connection.send(("context", 0, self._shipped))
                    process.serves = self._number
                process.log.truncate(0)  # what was printed for other jobs
                process.connection.send(("job", item[0], content))
            except OSError:
                process.job = None
                error = self.processes.bury(process)
                if not began:
                    self._count_stillborn(error)
                continue
            return

    def _count_stillborn(self, error: WorkerError) -> None:
        """Raise ``ClusterError`` if too many workers died before they could begin."""
        self._stillborn += 1
        if self._stillborn >= STILLBORN:
            raise ClusterError(f"workers end before they begin to work: {error}", remedy=REMEDY) from error

    def returned(self, flying: Sequence[int]) -> list[tuple[int, Returned]]:
        """Wait up to a second; return (number, result) of the jobs that came back."""
        self.processes.check()
        by_connection = {process.connection: process for process in self.processes.all}
        found: list[tuple[int, Returned]] = []
        for connection in wait([*by_connection], 1.0):
            process = by_connection[connection]  # type: ignore[index]
            item = process.job
            result = self._read(process)
            if item is not None and result is not None:
                found.append((item[0], result))
        for process in [p for p in self.processes.all if self.processes.dead(p) and not p.connection.poll()]:
            item, result = process.job, self._dead(process)
            if item is not None and result is not None:
                found.append((item[0], result))
        self._begin()
        return found

    def _read(self, process: WorkerProcess) -> Returned | None:
        """Read one message of a worker; None if no job came back with it."""
        try:
            kind, number, content = process.connection.recv()
        except (EOFError, OSError):
            return self._dead(process)
        found = pickle.loads(content)
        if kind == "ready":  # the context is loaded; or it could not be, and each job is answered with that error
            process.ready, self._stillborn = True, 0
            return None
        if kind == "busy":
            process.busy = found if process.job is not None else None
            return None
        if process.job is None or process.job[0] != number:
            raise ClusterError("a worker answered for a job that it does not have", remedy=REMEDY)
        process.job = process.busy = None
        if kind == "raised":
            return Lost(found, "raised")
        done: Returned = found
        return done

    def _dead(self, process: WorkerProcess) -> Lost | None:
        """Take note that a worker has died; None if no job of its is lost."""
        item, ready = process.job, process.ready
        error = self.processes.bury(process)
        if item is not None and not ready:  # the unit is not at fault: it goes to another worker
            self._count_stillborn(error)
            self._waiting.appendleft(item)
            return None
        return Lost(error, "worker")

    def left(self, flying: Sequence[int]) -> None:
        """End the workers that still have a job in hand: nobody waits for it. What they committed stays."""
        self._waiting.clear()
        for process in [*self.processes.all]:
            if process.job is not None:
                self.processes.kill(process)
