"""The Ray executor: one Ray task per large unit or per few small ones. Workers write results, and return receipts.

Ray is imported only when this executor starts.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any

from factory.context import RunContext
from factory.dispatch import Dispatch
from factory.executor import Task
from factory.heartbeat import Busy
from factory.packing import Packed, PackJob
from factory.preload import NOTHING, Preload
from factory.process_executor import SINGLE_THREADED
from factory.ray_crew import RayCrew
from factory.ray_guard import Guard
from factory.ray_metrics import RunMetrics
from factory.ray_node import RayNode
from factory.receipt import Receipt

__all__ = ["RayExecutor"]


class RayExecutor:
    """Runs tasks with Ray, on the CPUs of this machine or on a cluster.

    workers : tasks that work at once. Here, Ray is started with as many CPUs (all of the machine by default); on a
        cluster that is joined, at most as many tasks are in flight (as the cluster has room for by default)
    address : of a running cluster (``auto``, ``host:port``, ``ray://…``); None starts Ray here, ``close`` stops it
    init : further arguments of ``ray.init`` (``runtime_env``, ``namespace`` …)
    preload : called in this process before the first task, so that not each worker compiles what no cache holds
    note : shows what `preload` says

    Use it as a context manager. A Ray that is up already is used as it is and left running.
    """

    def __init__(
        self,
        workers: int | None = None,
        address: str | None = None,
        init: Mapping[str, Any] | None = None,
        preload: Preload = NOTHING,
        note: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._asked = workers
        self._cpus = workers or os.cpu_count() or 1
        self._address = address
        self._init = dict(init or {})
        self._preload = preload
        self._note = note
        self._prepared = False
        self._owner = False
        self._node: RayNode | None = None
        self._guard: Guard | None = None
        self._dispatch: Dispatch | None = None

    @property
    def running(self) -> bool:
        """Whether Ray can be used without starting it: it already runs here, or an existing cluster is configured."""
        if self._address is not None or self._owner:
            return True
        module = sys.modules.get("ray")
        return module is not None and bool(module.is_initialized())

    def start(self) -> None:
        """Start or join Ray; called automatically when the first task comes."""
        import ray

        if ray.is_initialized():
            self._node = self._node or RayNode()
            return
        settings: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR, **self._init}
        if self._address is None:
            settings = {
                # Not just any Ray that happens to run on this machine.
                "address": "local",
                "num_cpus": self._cpus,
                "include_dashboard": False,
                # Receipts are small and rows never pass through Ray.
                "object_store_memory": 128 * 1024 * 1024,
                **settings,
            }
            with _environment(SINGLE_THREADED), _own_signals():
                ray.init(**settings)
        else:
            environment = dict(settings.pop("runtime_env", {}))
            environment["env_vars"] = {**SINGLE_THREADED, **environment.get("env_vars", {})}
            with _own_signals():
                ray.init(address=self._address, runtime_env=environment, **settings)
        self._owner = True
        self._node = RayNode()
        self._guard = Guard(self._node.logs)

    def close(self) -> None:
        """Stop Ray if this executor started it."""
        if self._owner:
            import ray

            self._owner, self._node = False, None
            ray.shutdown()
            if self._guard is not None:
                self._guard.end()
                self._guard = None

    def __enter__(self) -> RayExecutor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def workers(self) -> int:
        """Return the number of tasks that run at once: the requested number, else the number of CPUs of this machine or
        of the cluster as it is now.

        A cluster is joined to be asked.
        """
        if self._asked is not None or self._address is None:
            return self._cpus
        self.start()
        import ray

        with self._alive().answers():
            return max(1, int(ray.cluster_resources().get("CPU", 0.0)))  # type: ignore[no-untyped-call]

    def workers_for(self, seconds: float) -> int:
        return self.workers

    def busy(self) -> Sequence[Busy]:
        dispatch = self._dispatch
        return [] if dispatch is None else dispatch.busy()

    def prepare(self, seconds: float) -> None:
        if not self._prepared:
            self._preload.load(self._note)
            self._prepared = True

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        stream = iter(tasks)
        first = next(stream, None)
        if first is None:
            return  # Ray is not started for nothing
        for done, receipt in enumerate(self._dispatched(context).units(itertools.chain([first], stream)), 1):
            if self._guard is not None:
                self._guard.done(done)
            yield receipt

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        stream = iter(jobs)
        first = next(stream, None)
        if first is not None:
            yield from self._dispatched(context).packs(itertools.chain([first], stream))

    def _dispatched(self, context: RunContext) -> Dispatch:
        self.start()
        joined = self._address is not None
        with self._alive().answers():
            # A Ray that was started here has as many CPUs as were asked for; on another the tasks are counted.
            most = self._asked if joined else None
            crew = RayCrew(context, self._alive(), grows=joined, most=most)
            self._dispatch = Dispatch(context, crew, RunMetrics())
        return self._dispatch

    def _alive(self) -> RayNode:
        assert self._node is not None
        return self._node


@contextlib.contextmanager
def _own_signals() -> Iterator[None]:
    """Context in which Ray is started. At the end, this process gets its own handler of SIGTERM back; Ray replaces the
    handler with one that would end the process at once.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextlib.contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Context in which variables are set for Ray's processes to inherit. Afterwards, this process has its own values
    again.
    """
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
