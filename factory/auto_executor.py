"""Executor for runs that do not configure a number of workers: a small run is done inline, and only a larger one uses
Ray.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from types import TracebackType
from typing import Final

from factory.context import RunContext
from factory.executor import Executor, InlineExecutor, Task
from factory.heartbeat import Busy
from factory.packing import Packed, PackJob
from factory.ray_executor import RayExecutor
from factory.receipt import Receipt

__all__ = ["SMALL_SECONDS", "AutoExecutor"]

SMALL_SECONDS: Final = 20.0
"""CPU seconds of estimated work below which Ray is not started: its start costs about nine CPU seconds (five by the
clock)."""


class AutoExecutor:
    """Works inline or with Ray, depending on the estimated cost of the work. If Ray is already running here, or a
    cluster is configured, Ray is always used.

    Only for who has configured neither workers nor an address: those are obeyed, see ``jobs.generate``.

    say : called with a line when a run goes inline
    small : expected CPU seconds below which a run goes inline
    """

    def __init__(
        self, ray: RayExecutor, say: Callable[[str], None] = lambda _: None, small: float = SMALL_SECONDS
    ) -> None:
        self._ray = ray
        self._inline = InlineExecutor()
        self._say = say
        self._small = small

    @property
    def workers(self) -> int:
        return self._ray.workers

    def workers_for(self, seconds: float) -> int:
        return 1 if self._is_small(seconds) else self._ray.workers

    def busy(self) -> Sequence[Busy]:
        return [*self._inline.busy(), *self._ray.busy()]

    def _is_small(self, seconds: float) -> bool:
        return seconds < self._small and not self._ray.running

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        seconds = float(getattr(tasks, "seconds", float("inf")))
        small = self._is_small(seconds)
        if small and seconds > 0:
            self._say(f"about {seconds:.0f} CPU s of work: done in this process, starting Ray would cost more")
        executor: Executor = self._inline if small else self._ray
        yield from executor.run(context, tasks)

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        executor: Executor = self._ray if self._ray.running else self._inline
        yield from executor.pack(context, jobs)

    def close(self) -> None:
        """Stop Ray if it was started here."""
        self._ray.close()

    def __enter__(self) -> AutoExecutor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
