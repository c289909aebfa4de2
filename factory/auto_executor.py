"""Executor for runs that do not configure a number of workers: a small run is done in this process, and only a larger
one starts worker processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from types import TracebackType
from typing import Final

from factory.context import RunContext
from factory.executor import Executor, InlineExecutor, Task
from factory.heartbeat import Busy
from factory.packing import Packed, PackJob
from factory.process_executor import ProcessExecutor
from factory.receipt import Receipt

__all__ = ["SMALL_SECONDS", "AutoExecutor"]

SMALL_SECONDS: Final = 10.0
"""CPU seconds of estimated work below which no processes are started: their start takes two or three seconds."""


class AutoExecutor:
    """Works in this process or in several, depending on the estimated cost of the work. Processes that run already are
    always used.

    inline, processes : what works
    say : called with a line when a run stays in this process
    small : expected CPU seconds below which it does
    """

    def __init__(
        self,
        inline: InlineExecutor,
        processes: ProcessExecutor,
        say: Callable[[str], None] = lambda _: None,
        small: float = SMALL_SECONDS,
    ) -> None:
        self._inline = inline
        self._processes = processes
        self._say = say
        self._small = small

    @property
    def workers(self) -> int:
        return self._processes.workers

    def workers_for(self, seconds: float) -> int:
        return 1 if self._is_small(seconds) else self._processes.workers

    def busy(self) -> Sequence[Busy]:
        return [*self._inline.busy(), *self._processes.busy()]

    def _is_small(self, seconds: float) -> bool:
        return not self._processes.running and (seconds < self._small or self._processes.workers == 1)

    def _chosen(self, seconds: float) -> Executor:
        return self._inline if self._is_small(seconds) else self._processes

    def prepare(self, seconds: float) -> None:
        self._chosen(seconds).prepare(seconds)

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        seconds = float(getattr(tasks, "seconds", float("inf")))
        executor = self._chosen(seconds)
        if executor is self._inline and seconds > 0:
            self._say(f"about {seconds:.0f} CPU s of work: done in this process, starting others would take longer")
        yield from executor.run(context, tasks)

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        executor: Executor = self._processes if self._processes.running else self._inline
        yield from executor.pack(context, jobs)

    def close(self) -> None:
        """End the processes."""
        self._processes.close()

    def __enter__(self) -> AutoExecutor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
