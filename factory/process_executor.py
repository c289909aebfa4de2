"""The executor of one machine: worker processes that share what they have loaded, without Ray."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from types import TracebackType
from typing import Final

from factory import machine
from factory.context import RunContext
from factory.dispatch import Dispatch
from factory.executor import Task
from factory.heartbeat import Busy
from factory.packing import Packed, PackJob
from factory.preload import NOTHING, Preload
from factory.process_crew import ProcessCrew
from factory.processes import Processes
from factory.receipt import Receipt
from schemas.errors import UsageError

__all__ = ["SINGLE_THREADED", "ProcessExecutor"]

SINGLE_THREADED: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "ARROW_NUM_THREADS"), "1"
)
"""Environment of workers: units already share the CPUs, so libraries must not start threads."""


class ProcessExecutor:
    """Runs tasks in worker processes of this machine.

    workers : number of processes; by default as many as this process may use CPUs
    preload : called once, before the first worker starts, in the process that workers are forked from
    note : shows what `preload` says

    Use it as a context manager: processes start before the first task, and end when it is left. A forked process that
    has used Apple's frameworks may crash, so on macOS Ray (``RayExecutor``) is the safer choice.
    """

    def __init__(
        self,
        workers: int | None = None,
        preload: Preload = NOTHING,
        note: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._workers = workers or machine.cores()
        self._preload = preload
        self._note = note
        self._processes: Processes | None = None
        self._dispatch: Dispatch | None = None
        self._at_work = False

    @property
    def workers(self) -> int:
        """Return the number of processes."""
        return self._workers

    def workers_for(self, seconds: float) -> int:
        return self._workers

    @property
    def running(self) -> bool:
        """Whether the processes have been started."""
        return self._processes is not None

    def busy(self) -> Sequence[Busy]:
        dispatch = self._dispatch
        return [] if dispatch is None else dispatch.busy()

    def start(self) -> Processes:
        """Start the template, if it is not running; called before the first task."""
        if self._processes is None:
            self._processes = Processes(self._preload, self._note, SINGLE_THREADED)
        return self._processes

    def prepare(self, seconds: float) -> None:
        self.start()

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        stream = iter(tasks)
        first = next(stream, None)
        if first is not None:  # else nothing is started
            with self._alone():
                yield from self._dispatched(context).units(itertools.chain([first], stream))

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        stream = iter(jobs)
        first = next(stream, None)
        if first is not None:
            with self._alone():
                yield from self._dispatched(context).packs(itertools.chain([first], stream))

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """Context of one stream of jobs. Two at once would read each other's answers."""
        if self._at_work:
            raise UsageError("this executor is at work for another run", remedy="Give each run an executor of its own.")
        self._at_work = True
        try:
            yield
        finally:
            self._at_work = False

    def _dispatched(self, context: RunContext) -> Dispatch:
        crew = ProcessCrew(context, self.start(), self._workers)
        self._dispatch = Dispatch(context, crew)
        return self._dispatch

    def close(self) -> None:
        """End the processes."""
        self._dispatch = None
        processes, self._processes = self._processes, None
        if processes is not None:
            processes.end()

    def __enter__(self) -> ProcessExecutor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
