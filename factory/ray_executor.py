"""The Ray executor: one Ray Core task for a big unit or a handful of small ones; workers write, receipts come back.

Ray is imported only when this executor starts.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from types import TracebackType
from typing import Any, Final

from factory.context import RunContext
from factory.executor import Task
from factory.packing import Packed, PackJob
from factory.ray_dispatch import Dispatch, pack_task, work_task
from factory.receipt import Receipt

__all__ = ["RayExecutor"]

SINGLE_THREADED: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "ARROW_NUM_THREADS"), "1"
)
"""Workers share the CPUs by units; threads inside one would only fight."""


class RayExecutor:
    """Runs on the CPUs of this machine, or on a cluster.

    workers : CPUs to use here; with an address, all that the cluster has
    address : of a running cluster (``auto``, ``host:port``, ``ray://…``); None starts Ray here, ``close`` stops it
    init : further arguments of ``ray.init`` (``runtime_env``, ``namespace`` …)

    Use it as a context manager. A Ray that is up already is used as it is and left running.
    """

    def __init__(
        self, workers: int | None = None, address: str | None = None, init: Mapping[str, Any] | None = None
    ) -> None:
        self._cpus = workers or os.cpu_count() or 1
        self._address = address
        self._init = dict(init or {})
        self._owner = False

    @property
    def running(self) -> bool:
        """Whether using Ray costs no start: it is up, or it is a cluster to be joined."""
        if self._address is not None or self._owner:
            return True
        module = sys.modules.get("ray")
        return module is not None and bool(module.is_initialized())

    def start(self) -> None:
        """Start or join Ray; done by itself when the first task comes."""
        import ray

        if ray.is_initialized():
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

    def close(self) -> None:
        """Stop Ray if this executor started it."""
        if self._owner:
            import ray

            self._owner = False
            ray.shutdown()

    def __enter__(self) -> RayExecutor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def workers(self) -> int:
        """CPUs that work at once."""
        return self._cpus

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        self.start()
        yield from Dispatch(context, work_task, grows=self._address is not None).units(tasks)

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        self.start()
        yield from Dispatch(context, pack_task, grows=self._address is not None).packs(jobs)


@contextlib.contextmanager
def _own_signals() -> Iterator[None]:
    """Ray takes SIGTERM for itself and would end this process on the spot; what the run does about it stays."""
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
    """Ray's processes inherit these; this process keeps its own."""
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
