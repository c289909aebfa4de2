"""Dispatch of tasks to Ray: what a task does, how many are in flight, and what happens to one that fails.

Ray retries a task of one unit whose worker or node died, or whose store did not answer (``max_retries``,
``retry_exceptions``). Units that share a task are handed out one by one after such a failure, so that the one which
kills workers is found; when Ray's retries are used up, it is quarantined. A unit that ran out of memory is retried
once with twice the memory.

A worker first looks whether its node sees the folders that the driver sees. A node without them would otherwise put
scene after scene in quarantine, or write to a store that nobody reads.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import sys
import time
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, Final, Literal

from factory import machine
from factory.deadline import terminated_by_signal
from factory.executor import Task
from factory.packing import Packed, PackJob, pack
from factory.pipeline import RunContext
from factory.receipt import Receipt
from factory.report import Busy
from factory.worker import Worker
from schemas.errors import ClusterError, StoreError, TransientIOError, UsageError

__all__ = [
    "METRICS",
    "Dispatch",
    "Folder",
    "Lost",
    "Quarantined",
    "RunMetrics",
    "Shipped",
    "answered",
    "check_folders",
    "lost",
    "process_units",
    "seen_folders",
    "write_part",
]


NAMES: Final = 5
"""Number of names in a folder that every node must see."""


@dataclass(frozen=True, slots=True)
class Folder:
    """A folder that every node must see, and the first names in it."""

    path: str
    names: tuple[str, ...]


def seen_folders(paths: Iterable[str]) -> tuple[Folder, ...]:
    """Return the folders as the driver sees them. Those that it does not see itself are left out."""
    found = []
    for path in paths:
        try:
            with os.scandir(path) as entries:
                found.append(Folder(path, tuple(entry.name for entry in islice(entries, NAMES))))
        except OSError:
            continue
    return tuple(found)


def check_folders(folders: Iterable[Folder]) -> None:
    """Raise ``ClusterError`` if this node does not see a folder, or sees another one at its path."""
    for folder in folders:
        missing = [name for name in folder.names if not os.path.lexists(os.path.join(folder.path, name))]
        if os.path.isdir(folder.path) and not missing:
            continue
        what = f"has another folder at {folder.path}" if os.path.isdir(folder.path) else f"does not see {folder.path}"
        lacks = f" ({missing[0]} is not there)" if os.path.isdir(folder.path) else ""
        raise ClusterError(
            f"worker node {_node()} {what}{lacks}",
            remedy="Every node needs the same files at the same path: use shared storage or copy them. Nothing was "
            "quarantined for this.",
        )


def _node() -> str:
    return f"{machine.host()} ({_own_node().get('NodeManagerAddress', 'outside of Ray')})"


def _own_node() -> dict[str, Any]:
    """Return what Ray says of this node; nothing where this process is not connected."""
    import ray

    if not ray.is_initialized():
        return {}
    own = ray.get_runtime_context().get_node_id()
    nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
    return next((node for node in nodes if node["NodeID"] == own), {})


@dataclass(frozen=True, slots=True)
class Shipped:
    """What all tasks of one dispatch share; a run has several, one for each pass."""

    context: RunContext
    folders: tuple[Folder, ...]


_worker: list[tuple[str, Worker]] = []
"""In a worker process: the name of the dispatch that it serves, and its worker."""


def _served(name: str, shipped: Sequence[Any]) -> Worker:
    """Return the worker of this process for a dispatch.

    name : of the dispatch
    shipped : reference of its ``Shipped``, in a list, so that Ray does not fetch it for each task
    """
    if not _worker or _worker[0][0] != name:
        _worker.clear()
        terminated_by_signal()
        found = _loaded(shipped[0])
        check_folders(found.folders)
        slots = int(_own_node().get("Resources", {}).get("CPU", 1))  # tasks that may run here at once
        _worker.append((name, Worker(found.context, may_exit=True, slots=max(slots, 1))))
    return _worker[0][1]


def _loaded(reference: Any) -> Shipped:
    """Return what the driver shipped. Raises ``UsageError`` when this worker lacks a module that it is made of."""
    import ray

    try:
        found: Shipped = ray.get(reference)
        return found
    except ray.exceptions.RayError as error:
        why = next((line for line in reversed(str(error).strip().splitlines())), type(error).__name__)
        raise UsageError(
            f"worker node {_node()} can't load what the run is made of ({why}); its Python is {sys.executable}",
            remedy="Install the same condvln on every node, or ship it by ray.runtime_env (working_dir, py_modules).",
        ) from error


class Quarantined(Exception):
    """Raised at the end of a task that put units into quarantine, so that Ray lists it as failed.

    receipts : of all units of the task
    """

    def __init__(self, message: str, receipts: list[Receipt]) -> None:
        super().__init__(message, receipts)
        self.receipts = receipts

    def __str__(self) -> str:
        return str(self.args[0])


def process_units(name: str, shipped: Sequence[Any], task: Task) -> list[Receipt]:
    """Process the units of a task. Ray runs this again when its worker or node dies."""
    worker = _served(name, shipped)
    receipts = [
        worker.work(item.unit, task.until, item.fingerprint, attempt=task.attempt, last_try=task.last_try)
        for item in task.work
    ]
    failed = [(receipt.unit_id, receipt.failure) for receipt in receipts if receipt.failure is not None]
    if failed:
        raise Quarantined(
            "\n".join(f"{unit}: stage {f.stage}: {f.exception}: {f.message}" for unit, f in failed), receipts
        )
    return receipts


def write_part(name: str, shipped: Sequence[Any], job: PackJob) -> list[Packed]:
    """Write one file of a snapshot."""
    run = _served(name, shipped).context
    return [pack(run.store, run.pipeline, job)]


RETRIES: Final = 2
"""Number of times that Ray runs a task again whose worker or node died, or that raised ``TransientIOError``."""

NODE_TRIES: Final = 3
"""Number of times that a unit is handed out whose nodes die each time: a lost spot node is not the unit's fault."""

TASKS_PER_CPU: Final = 2
"""Tasks in flight for each CPU: one runs and one waits, so that no worker idles."""

LEAST_IN_FLIGHT: Final = 8
"""Tasks in flight on a cluster that has no CPUs yet, so that an autoscaler sees demand."""

LOOK_SECONDS: Final = 5.0
"""Seconds between two looks at the resources of the cluster."""

PACK_FACTOR: Final = 6
"""Memory for packing a part, as a multiple of its canonical bytes: rows read, sorted and written, with a margin."""

METRICS: Final = {
    "factory_units_total": "Finished units, by status",
    "factory_stages_total": "Stages run, by stage",
    "factory_rows_total": "Rows written, by table",
    "factory_stage_seconds": "Seconds that a stage took for one unit, by stage",
    "factory_unit_peak_rss_bytes": "Peak memory of the latest unit, in bytes",
    "factory_tasks_in_flight": "Tasks in flight on Ray",
    "factory_task_failures_total": "Tasks that came back without receipts, by kind (worker, node, memory, raised)",
}
"""Metrics of a run at Ray's Prometheus endpoint, a part of ``ray[default]``, which puts ``ray_`` before the names."""

BUCKETS: Final = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0]
"""Bounds of the histogram of seconds: half-decades from a text stage to the largest building."""

Job = Task | PackJob


@dataclass(frozen=True, slots=True)
class Lost:
    """The end of a task that came back without a result.

    kind : ``raised``: the worker raised an error; ``memory``: Ray ended the worker because memory ran out; ``worker``:
        the worker died; ``node``: the machine that it ran on was lost
    """

    error: BaseException
    kind: Literal["raised", "memory", "node", "worker"]


@dataclass(frozen=True, slots=True)
class _Flight:
    job: Any
    since: float


class Dispatch:
    """Sends one stream of tasks to Ray, with a limited number in flight. Ray must be running.

    folders : that every node must see
    grows : the cluster may gain CPUs when tasks wait for them
    most : tasks in flight at most; None for as many as the cluster has room for

    Raises ``ClusterError`` when Ray does not answer any more.
    """

    def __init__(
        self, context: RunContext, folders: tuple[Folder, ...] = (), *, grows: bool = False, most: int | None = None
    ) -> None:
        import ray

        self._ray: Any = ray
        self._context = context
        self._metrics = RunMetrics()
        self._least = LEAST_IN_FLIGHT if grows else 2
        self._most = most
        self._name = secrets.token_hex(8)
        self._functions: dict[type, Any] = {Task: ray.remote(process_units), PackJob: ray.remote(write_part)}
        self._flying: dict[Any, _Flight] = {}
        self._again: deque[Job] = deque()
        self._cpus, self._memory, self._looked = 0.0, 0.0, -1e9
        with answered():
            self._shipped = [ray.put(Shipped(context, folders))]
        # Only the driver's side of a worker: it never runs a stage.
        self._driver = Worker(context)

    def busy(self) -> list[Busy]:
        """Return the units of the tasks that were handed out first, as many as the cluster has CPUs."""
        flights = [flight for flight in [*self._flying.values()] if isinstance(flight.job, Task)]
        now = time.monotonic()
        return [Busy(_units(f.job), "", now - f.since) for f in flights[: max(int(self._cpus), 1)]]

    # ---- flow

    def units(self, tasks: Iterable[Task]) -> Iterator[Receipt]:
        """Yield the receipts of all units."""
        with contextlib.closing(self._stream(iter(tasks))) as stream:
            for flight, result in stream:
                task: Task = flight.job
                expected = {item.unit.unit_id: item.seconds for item in task.work}
                for receipt in self._failed(flight, result) if isinstance(result, Lost) else self._done(task, result):
                    self._metrics.unit(receipt)
                    yield replace(receipt, expected=expected.get(receipt.unit_id, 0.0))

    def _done(self, task: Task, receipts: list[Receipt]) -> Iterator[Receipt]:
        for receipt, item in zip(receipts, task.work, strict=True):
            if receipt.status == "memory":
                self._metrics.failed("memory")
                self._more_memory(replace(task, work=(item,)))
            else:
                yield receipt

    def packs(self, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        """Yield the files that were written."""
        with contextlib.closing(self._stream(iter(jobs))) as stream:
            for flight, result in stream:
                if isinstance(result, Lost):
                    if isinstance(result.error, (StoreError, ClusterError)):
                        raise result.error
                    raise StoreError(f"{flight.job.path} could not be packed: {result.error}") from result.error
                yield from result

    def _stream(self, jobs: Iterator[Job]) -> Generator[tuple[_Flight, Any]]:
        """Yield (flight, result) of each task. The caller may put tasks into ``_again`` to have them run."""
        more = True
        try:
            while True:
                room = self._room()
                while more and len(self._flying) + len(self._again) < room:
                    job = next(jobs, None)
                    more = job is not None
                    if job is not None:
                        self._again.append(job)
                while self._again and len(self._flying) < room:
                    job = self._again.popleft()
                    self._flying[self._send(job)] = _Flight(job, time.monotonic())
                self._metrics.in_flight(len(self._flying))
                if not self._flying:
                    return
                # Returns at least once a second, so that signals come through and growth is seen.
                with answered():
                    done, _ = self._ray.wait([*self._flying], num_returns=1, timeout=1.0)
                for reference in done:
                    yield self._flying.pop(reference), self._result(reference)
        finally:
            # Tasks in flight are not cancelled: Ray 2.60 aborts this process when one comes back meanwhile.
            self._flying.clear()
            self._metrics.in_flight(0)

    def _send(self, job: Job) -> Any:
        """Hand out a task; return the reference of its result."""
        single = not isinstance(job, Task) or len(job.work) == 1
        memory = job.memory if isinstance(job, Task) else PACK_FACTOR * job.logical_bytes + 64 * 1024 * 1024
        function = self._functions[type(job)].options(
            name=f"condvln:{self._context.name}:{_units(job) if isinstance(job, Task) else job.path}",
            num_cpus=1,
            memory=self._bounded(memory),
            max_retries=RETRIES if single else 0,
            retry_exceptions=[TransientIOError],
        )
        with answered():
            return function.remote(self._name, self._shipped, job)

    def _result(self, reference: Any) -> Any:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            end = lost(error)
            return end.error.receipts if isinstance(end.error, Quarantined) else end

    def _room(self) -> int:
        """Return the number of tasks that may be in flight now."""
        now = time.monotonic()
        if now - self._looked > LOOK_SECONDS:
            self._looked = now
            with answered():
                self._cpus = self._ray.cluster_resources().get("CPU", 0.0)
                nodes = [node for node in self._ray.nodes() if node["Alive"]]
            self._memory = max((node["Resources"].get("memory", 0.0) for node in nodes), default=0.0)
        room = max(int(self._cpus * TASKS_PER_CPU), self._least)
        return room if self._most is None else min(room, self._most)

    def _bounded(self, memory: int) -> int:
        """Return ``memory`` in whole bytes, but at most what some node can provide. If asked for more, Ray would wait
        forever.
        """
        return int(min(memory, self._memory * 0.9)) if self._memory else memory

    # ---- failures

    def _failed(self, flight: _Flight, end: Lost) -> Iterator[Receipt]:
        """Hand units out again, or yield the receipts of those that are quarantined."""
        task: Task = flight.job
        self._metrics.failed(end.kind)
        single = len(task.work) == 1
        if end.kind == "raised" and (single or not isinstance(end.error, TransientIOError)):
            raise end.error
        if end.kind == "memory" and task.last_try:
            what = f"out of memory with {task.memory / 2**20:.0f} MiB asked for; Ray ended its worker"
            yield from (self._blame(task, item, "memory", end, what) for item in task.work)
        elif end.kind == "memory" and single:
            self._more_memory(task)
        elif not single or (end.kind == "node" and task.attempt < NODE_TRIES):
            for item in task.work:
                self._again.append(replace(task, work=(item,), attempt=task.attempt + 1, memory=item.memory))
        else:
            yield self._blame(task, task.work[0], *self._why(flight, end))

    def _why(self, flight: _Flight, end: Lost) -> tuple[Literal["deadline", "worker"], Lost, str]:
        """Return the cause of the deaths of a unit's workers, and a message."""
        tries, limit = RETRIES + 1, self._context.deadline
        if end.kind == "worker" and limit is not None and time.monotonic() - flight.since >= tries * limit:
            message = (
                f"the unit ran longer than its deadline of {limit:g} s in compiled code, which can't be interrupted, "
                "so its worker was ended; the worker's log shows where it was"
            )
            return "deadline", replace(end, error=TimeoutError(message)), message
        return "worker", end, f"{tries} workers died while they processed this unit. {end.error}"

    def _blame(
        self, task: Task, item: Any, cause: Literal["deadline", "memory", "worker"], end: Lost, message: str
    ) -> Receipt:
        attempts = task.attempt + (0 if cause == "memory" else RETRIES)
        name = "DeadlineError" if cause == "deadline" else type(end.error).__name__
        return self._driver.blame(item, task.until, cause, name, message, attempts=attempts)

    def _more_memory(self, task: Task) -> None:
        """Retry a task once, with twice the memory."""
        (item,) = task.work
        self._again.append(replace(task, attempt=task.attempt + 1, last_try=True, memory=2 * item.memory))


class RunMetrics:
    """Counts results of tasks. Ray must be running."""

    def __init__(self) -> None:
        from ray.util.metrics import Counter, Gauge, Histogram

        def counter(name: str, tag: str) -> Counter:
            return Counter(name, description=METRICS[name], tag_keys=(tag,))

        self._units = counter("factory_units_total", "status")
        self._stages = counter("factory_stages_total", "stage")
        self._rows = counter("factory_rows_total", "table")
        self._failures = counter("factory_task_failures_total", "kind")
        seconds = "factory_stage_seconds"
        self._seconds = Histogram(seconds, description=METRICS[seconds], boundaries=BUCKETS, tag_keys=("stage",))
        self._rss = Gauge("factory_unit_peak_rss_bytes", description=METRICS["factory_unit_peak_rss_bytes"])
        self._flying = Gauge("factory_tasks_in_flight", description=METRICS["factory_tasks_in_flight"])

    def unit(self, receipt: Receipt) -> None:
        """Count a finished unit."""
        self._units.inc(1, {"status": receipt.status})
        for stage in receipt.stages:
            if not stage.made:
                continue
            self._stages.inc(1, {"stage": stage.stage})
            self._seconds.observe(stage.seconds, {"stage": stage.stage})
            self._rss.set(stage.peak_rss)
            for table in stage.tables:
                if table.rows:
                    self._rows.inc(table.rows, {"table": table.table})

    def failed(self, kind: str) -> None:
        """Count a task that failed and returned no receipts."""
        self._failures.inc(1, {"kind": kind})

    def in_flight(self, tasks: int) -> None:
        """Set the number of tasks that are in flight in Ray."""
        self._flying.set(tasks)


def _units(task: Task) -> str:
    """Return the name of a task's unit; of several, the first one's and how many more there are."""
    first = task.work[0].unit.unit_id
    return first if len(task.work) == 1 else f"{first} and {len(task.work) - 1} more"


@contextlib.contextmanager
def answered() -> Iterator[None]:
    """Context in which this process calls Ray. It raises ``ClusterError`` if Ray no longer answers."""
    import ray

    try:
        yield
    except (ConnectionError, ray.exceptions.RaySystemError, ray.exceptions.RpcError) as error:
        first = next(iter(str(error).strip().splitlines()), type(error).__name__)
        raise ClusterError(
            f"Ray does not answer any more ({first})",
            remedy="Run the same command again: it goes on from what is committed. If this happens again, look into "
            "Ray's logs and the system's log (out of memory, a full disk), or set fewer ray.workers.",
        ) from error


def lost(error: BaseException) -> Lost:
    """Return what an error of Ray's tells of a task."""
    import ray

    if isinstance(error, ray.exceptions.RayTaskError):
        return Lost(error.cause if isinstance(error.cause, BaseException) else error, "raised")
    if isinstance(error, ray.exceptions.OutOfMemoryError):
        return Lost(error, "memory")
    if isinstance(
        error, (ray.exceptions.NodeDiedError, ray.exceptions.LocalRayletDiedError, ray.exceptions.ObjectLostError)
    ):
        return Lost(error, "node")
    if isinstance(error, ray.exceptions.WorkerCrashedError):
        return Lost(error, "worker")
    return Lost(error, "raised")
