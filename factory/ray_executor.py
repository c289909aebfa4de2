"""The executor of more than one worker: Ray tasks, on this machine or on a cluster.

Workers write results, and return receipts. Ray is imported only when this executor starts.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

from factory import machine
from factory.dispatch import RETRIES, Dispatch, answered, lost, seen_folders
from factory.executor import InlineExecutor, Task, Warm
from factory.packing import Packed, PackJob
from factory.pipeline import RunContext
from factory.ray_address import import_ray, join
from factory.receipt import Receipt
from factory.report import Busy
from schemas.errors import ClusterError, TransientIOError

__all__ = ["RayExecutor"]

SINGLE_THREADED: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "ARROW_NUM_THREADS"), "1"
)
"""Environment of workers: tasks already share the CPUs, so libraries must not start threads."""

LOCAL: Final = {**SINGLE_THREADED, "RAY_task_oom_retries": "0"}
"""Environment of a Ray on this machine. A task that Ray ends because memory ran out comes back, and is retried with
twice the memory; by default Ray would repeat it as it is."""

OBJECT_STORE_BYTES: Final = 128 * 1024 * 1024
"""Memory of a Ray on this machine for what tasks return. Receipts are small; rows never pass through Ray."""


class RayExecutor:
    """Runs tasks with Ray, on the CPUs of this machine or on a cluster.

    workers : tasks that work at once. Here, Ray is started with as many CPUs (all of the machine by default); on a
        cluster that is joined, at most as many tasks are in flight (as the cluster has room for by default)
    address : of a running cluster (``auto``, ``host:port``, ``ray://…``); None starts Ray here, ``close`` stops it
    place : where the address comes from, for errors
    init : further arguments of ``ray.init`` (``runtime_env``, ``namespace`` …)
    warm : called once before the first work, on this machine only
    folders : that every node of a cluster must see
    small : expected CPU seconds below which work is done in this process, because the start of Ray takes longer

    Use it as a context manager. A Ray that this process has started or joined before is used and left running.
    """

    def __init__(
        self,
        workers: int | None = None,
        address: str | None = None,
        *,
        place: str = "ray.address",
        init: Mapping[str, Any] | None = None,
        warm: Warm = lambda executor: None,
        folders: Iterable[str] = (),
        small: float = 0.0,
    ) -> None:
        self._asked = workers
        self._address = address
        self._place = place
        self._init = dict(init or {})
        self._warm = warm
        self._warmed = False
        self._folders = tuple(folders)
        self._small = small
        self._inline = InlineExecutor(warm)
        self._owner = False
        self._dispatch: Dispatch | None = None

    @property
    def running(self) -> bool:
        """Whether this process is connected to a Ray."""
        module = sys.modules.get("ray")
        return module is not None and bool(module.is_initialized())

    def start(self) -> None:
        """Start or join Ray, if this process is not connected yet."""
        if self.running:
            return
        settings: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR, **self._init}
        if self._address is not None:
            environment = dict(settings.pop("runtime_env", {}))
            environment["env_vars"] = {**SINGLE_THREADED, **environment.get("env_vars", {})}
            with _own_signals():
                join(self._address, {**settings, "runtime_env": environment}, self._place)
        else:
            ray = import_ray()
            # Not just any Ray that happens to run on this machine.
            own = {"address": "local", "num_cpus": self._cpus, "object_store_memory": OBJECT_STORE_BYTES}
            try:
                with _environment(LOCAL), _own_signals():
                    ray.init(**{**own, **settings})
            except Exception as error:
                raise ClusterError(
                    f"Ray can't be started on this machine: {' '.join(str(error).split())}",
                    remedy="Free memory and disk space (df /dev/shm /tmp), or work in one process (--inline).",
                ) from error
        self._owner = True

    def close(self) -> None:
        """Stop Ray if this executor started it, or leave the cluster."""
        self._dispatch = None
        if self._owner:
            import ray

            self._owner = False
            ray.shutdown()

    def __enter__(self) -> RayExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _cpus(self) -> int:
        return self._asked or machine.cores()

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

        with answered():
            return max(1, int(ray.cluster_resources().get("CPU", 0.0)))  # type: ignore[no-untyped-call]

    def begin(self, seconds: float) -> int:
        if self._address is None and seconds < self._small and not self.running:
            return self._inline.begin(seconds)
        self.start()
        if not self._warmed and self._address is None:  # nodes of a cluster have a cache each
            self._warm(self)
            self._warmed = True
        return self.workers

    def busy(self) -> Sequence[Busy]:
        return [*self._inline.busy(), *(() if self._dispatch is None else self._dispatch.busy())]

    def run(self, context: RunContext, tasks: Iterable[Task]) -> Iterator[Receipt]:
        if not self.running:
            return self._inline.run(context, tasks)
        return self._dispatched(context).units(tasks)

    def pack(self, context: RunContext, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        if not self.running:
            return self._inline.pack(context, jobs)
        return self._dispatched(context).packs(jobs)

    def _dispatched(self, context: RunContext) -> Dispatch:
        joined = self._address is not None
        # A Ray that was started here has as many CPUs as were asked for; on another the tasks are counted.
        self._dispatch = Dispatch(
            context,
            seen_folders(self._folders) if joined else (),
            grows=joined,
            most=self._asked if joined else None,
        )
        return self._dispatch

    def streams(self, function: Callable[[Any], Iterator[Any]], items: Sequence[Any], name: str) -> list[Iterator[Any]]:
        if not self.running:
            return self._inline.streams(function, items, name)
        import ray

        options = {"max_retries": RETRIES, "retry_exceptions": [TransientIOError], "num_returns": "streaming"}
        remote: Any = ray.remote(function)
        remote = remote.options(name=f"condvln:{name}", **options)
        return [map(_value, remote.remote(item)) for item in items]


def _value(reference: Any) -> Any:
    """Return the result of a task. Raises what the task raised; ``ClusterError`` if its worker died."""
    import ray

    try:
        with answered():
            return ray.get(reference)
    except ray.exceptions.RayError as error:
        end = lost(error)
        if end.kind == "raised":
            raise end.error from None
        raise ClusterError(
            f"the workers of a task died {RETRIES + 1} times ({' '.join(str(error).split())})",
            remedy="Use fewer workers if memory was short.",
        ) from error


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
