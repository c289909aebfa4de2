"""Dispatch of tasks through Ray: how many are in flight, and how a task that fails is classified.

Ray itself retries nothing here. A dead worker or node gives its units back, one by one from then on, so that the one
which kills workers is found; after ``SYSTEM_TRIES`` it is quarantined. Running out of memory gives a unit one more try
with twice the memory and a node to itself: Ray may end whoever came last for what another holds.
"""

from __future__ import annotations

import re
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from factory.context import RunContext
from factory.deadline import terminated_by_signal
from factory.executor import Task
from factory.heartbeat import Busy
from factory.packing import Packed, PackJob, pack
from factory.ray_board import read_board, report_to_board
from factory.ray_guard import Guard
from factory.ray_metrics import RunMetrics
from factory.ray_node import RayNode
from factory.receipt import Receipt
from factory.worker import Worker
from schemas.errors import StoreError, TransientIOError

__all__ = ["Dispatch", "pack_task", "work_task"]

SYSTEM_TRIES: Final = 3
"""Number of deaths of workers that a unit may cause before it is quarantined."""

LATE_TRIES: Final = 2
"""Number of deaths of workers past the deadline before a unit is quarantined. One may be by chance, since waiting
counts too."""

NODE_TRIES: Final = 10
"""Number of lost nodes after which a unit is quarantined: a lost spot node is not the unit's fault."""

TRANSIENT_TRIES: Final = 5
"""Number of tries of a task whose store did not answer."""

TASKS_PER_CPU: Final = 2
"""Tasks in flight for each CPU: one runs and one waits, so that no worker idles."""

LEAST_IN_FLIGHT: Final = 8
"""Tasks in flight on a cluster that has no CPUs yet, so that an autoscaler sees demand."""

PACK_FACTOR: Final = 6
"""Memory for packing a part, as a multiple of its canonical bytes: rows read, sorted and written, with a margin."""

_workers: dict[str, Worker] = {}
"""In a worker process: the worker of the dispatch that it serves, by name."""


_reports: list[Callable[[], None]] = []
"""In a worker process: function that stops the reports of long units."""


def _worker(name: str, context: Sequence[Any]) -> Worker:
    import ray

    if name not in _workers:
        _workers.clear()
        terminated_by_signal()
        for end in _reports:
            end()
        worker = _workers[name] = Worker(ray.get(context[0]), may_exit=True, slots=_slots())
        _reports[:] = [report_to_board(name, worker.place, worker.context.busy_seconds)]
    return _workers[name]


def _slots() -> int:
    """Return the number of tasks that may run on this node at once."""
    import ray

    own = ray.get_runtime_context().get_node_id()
    nodes = ray.nodes()  # type: ignore[no-untyped-call]
    return max([1, *(int(node["Resources"].get("CPU", 1)) for node in nodes if node["NodeID"] == own)])


def work_task(name: str, context: Sequence[Any], task: Task) -> list[Receipt]:
    """Process the units of a task. This runs in a worker process."""
    worker = _worker(name, context)
    return [
        worker.work(item.unit, task.until, item.fingerprint, attempt=task.attempt, last_try=task.last_try)
        for item in task.work
    ]


def pack_task(name: str, context: Sequence[Any], job: PackJob) -> list[Packed]:
    """Write one file of a snapshot. This runs in a worker process."""
    run = _worker(name, context).context
    return [pack(run.store, run.pipeline, job, run.faults)]


@dataclass(frozen=True, slots=True)
class _Flight:
    """A task or pack job that was handed to Ray.

    tries : how often it was handed out, deaths of nodes not counted
    nodes : how many nodes were lost under it
    late : how many workers died under it when its deadline was over
    """

    item: Any
    tries: int = 1
    nodes: int = 0
    late: int = 0


class Dispatch:
    """Sends one stream of tasks through Ray, with a limited number in flight. Ray must be running.

    function : ``work_task`` or ``pack_task``
    node : asked whether Ray still lives
    guard : kept up to date on how many units are done
    grows : the cluster may gain CPUs when tasks wait for them
    most : tasks in flight at most; None for as many as the cluster has room for

    Raises ``ClusterError`` when Ray dies.
    """

    def __init__(
        self,
        context: RunContext,
        function: Any,
        node: RayNode,
        guard: Guard | None = None,
        *,
        grows: bool,
        most: int | None = None,
    ) -> None:
        import ray

        self._ray = ray
        self._node = node
        self._guard = guard
        self._most = most
        self._least = LEAST_IN_FLIGHT if grows else 2
        self._context = context
        self._shipped = [ray.put(context)]
        # A run has several contexts, one for each pass.
        self._name = secrets.token_hex(8)
        self._remote = ray.remote(function)
        self._flying: dict[Any, tuple[_Flight, float]] = {}
        self._metrics = RunMetrics()
        self._again: deque[_Flight] = deque()
        self._cpus, self._memory, self._node_cpus = 0.0, 0.0, 1
        self._looked = -1e9
        # Only the driver's side of a worker: it never runs a stage.
        self._driver = Worker(context)

    def busy(self) -> list[Busy]:
        """Return the units that workers reported as taking long."""
        return read_board(self._name)

    # ---- flow

    def units(self, tasks: Iterable[Task]) -> Iterator[Receipt]:
        for done, receipt in enumerate(self._receipts(tasks), 1):
            if self._guard is not None:
                self._guard.done(done)
            yield receipt

    def _receipts(self, tasks: Iterable[Task]) -> Iterator[Receipt]:
        for flight, result in self._stream((_Flight(task) for task in tasks), _task_memory):
            if isinstance(result, BaseException):
                error, kind = _unwrapped(result)
                self._metrics.failed(kind)
                expected = {item.unit.unit_id: item.seconds for item in flight.item.work}
                for receipt in self._failed(flight, error, kind):
                    self._metrics.unit(receipt)
                    yield replace(receipt, expected=expected.get(receipt.unit_id, 0.0))
                continue
            for receipt, item in zip(result, flight.item.work, strict=True):
                if receipt.status == "memory":
                    self._metrics.failed("memory")
                    self._more_memory(flight, replace(flight.item, work=(item,)))
                else:
                    self._metrics.unit(receipt)
                    yield replace(receipt, expected=item.seconds)

    def packs(self, jobs: Iterable[PackJob]) -> Iterator[Packed]:
        for flight, result in self._stream((_Flight(job) for job in jobs), _pack_memory):
            if isinstance(result, BaseException):
                error, _ = _unwrapped(result)
                if flight.tries >= SYSTEM_TRIES or not _is_system(self._ray, result):
                    raise StoreError(f"{flight.item.path} could not be packed: {error}") from error
                self._again.append(replace(flight, tries=flight.tries + 1))
            else:
                yield from result

    def _stream(self, flights: Iterator[_Flight], memory: Any) -> Iterator[tuple[_Flight, Any]]:
        """Yield (flight, list of results or exception) of each flight as it comes back. The caller may put failed
        flights into ``_again`` to repeat them.
        """
        more = True
        try:
            while True:
                self._node.check()
                while more and len(self._flying) + len(self._again) < self._room():
                    flight = next(flights, None)
                    if flight is None:
                        more = False
                    else:
                        self._again.append(flight)
                while self._again and len(self._flying) < self._room():
                    flight = self._again.popleft()
                    asked = self._bounded(memory(flight.item))
                    cpus = self._node_cpus if isinstance(flight.item, Task) and flight.item.alone else 1
                    remote = self._remote.options(num_cpus=cpus, memory=asked, max_retries=0)
                    with self._node.answers():
                        reference = remote.remote(self._name, self._shipped, flight.item)
                    self._flying[reference] = (flight, time.monotonic())
                self._metrics.in_flight(len(self._flying))
                if not self._flying:
                    return
                # The timeout lets signals through and the cluster's growth be seen.
                with self._node.answers():
                    done, _ = self._ray.wait([*self._flying], num_returns=1, timeout=1.0)
                self._node.check()
                for reference in done:
                    flight, since = self._flying.pop(reference)
                    try:
                        result: Any = self._ray.get(reference)
                    except self._ray.exceptions.RayError as error:
                        self._node.check()  # a task that is lost with this node is lost with all the others
                        result = error
                        limit = self._context.deadline
                        if limit is not None and time.monotonic() - since >= limit:
                            flight = replace(flight, late=flight.late + 1)
                    yield flight, result
        finally:
            # Not cancelled: Ray aborts this whole process when a task comes back while it is being cancelled (seen with
            # 2.60, one stop in thirteen on a busy machine). Its workers end with this job; until then they may
            # commit what they have in hand, which does no harm.
            self._flying.clear()
            self._metrics.in_flight(0)

    def _room(self) -> int:
        """Return the number of tasks that may be in flight now."""
        now = time.monotonic()
        if now - self._looked > 5.0:
            self._looked = now
            with self._node.answers():
                self._cpus = self._ray.cluster_resources().get("CPU", 0.0)  # type: ignore[no-untyped-call]
                nodes = [node for node in self._ray.nodes() if node["Alive"]]  # type: ignore[no-untyped-call]
            self._memory = max((node["Resources"].get("memory", 0.0) for node in nodes), default=0.0)
            cpus = [int(node["Resources"].get("CPU", 0.0)) for node in nodes]
            # The smallest node's, which every node can give.
            self._node_cpus = min((count for count in cpus if count), default=1)
        room = max(int(self._cpus * TASKS_PER_CPU), self._least)
        return room if self._most is None else min(room, self._most)

    def _bounded(self, memory: float) -> int:
        """Return ``memory`` in whole bytes, but at most what some node can provide. If asked for more, Ray would wait
        forever.
        """
        return int(min(memory, self._memory * 0.9)) if self._memory else int(memory)

    # ---- failures

    def _failed(self, flight: _Flight, error: BaseException, kind: str) -> Iterator[Receipt]:
        task: Task = flight.item
        if kind == "raised":
            if isinstance(error, TransientIOError) and flight.tries < TRANSIENT_TRIES:
                time.sleep(min(0.2 * 4**flight.tries, 10.0))
                self._again.append(replace(flight, tries=flight.tries + 1))
                return
            raise error
        if kind == "memory":
            yield from self._out_of_memory(flight, error)
            return
        tries, nodes = flight.tries + (kind == "worker"), flight.nodes + (kind == "node")
        attempts = tries + nodes - 1
        if len(task.work) == 1 and kind == "worker" and flight.late >= LATE_TRIES:
            message = (
                f"the unit ran longer than its deadline of {self._context.deadline:g} s in compiled code, which can't "
                "be interrupted, so its worker was ended; the worker's log shows where it was"
            )
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

    def _out_of_memory(self, flight: _Flight, error: BaseException) -> Iterator[Receipt]:
        task: Task = flight.item
        for item in task.work:
            if task.last_try:
                told = str(error).split(_DETAILS)[0].strip()
                message = f"out of memory with {task.memory / 2**20:.0f} MiB asked for. {told}"
                yield self._driver.blame(
                    item,
                    task.until,
                    "memory",
                    type(error).__name__,
                    message,
                    attempts=task.attempt,
                    peak_rss=_killed_rss(error),
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


def _unwrapped(error: BaseException) -> tuple[BaseException, str]:
    """Return the cause of an error that Ray raised, and the kind of failure: raised, memory, node or worker."""
    import ray

    if isinstance(error, ray.exceptions.RayTaskError):
        return (error.cause if isinstance(error.cause, BaseException) else error), "raised"
    if isinstance(error, ray.exceptions.OutOfMemoryError):
        return error, "memory"
    if isinstance(
        error, (ray.exceptions.NodeDiedError, ray.exceptions.LocalRayletDiedError, ray.exceptions.ObjectLostError)
    ):
        return error, "node"
    if isinstance(error, ray.exceptions.WorkerCrashedError):
        return error, "worker"
    return error, "raised"


_KILLED: Final = re.compile(r"\btask\b.*memory used[=:] ?([0-9.]+) ?Gi?B", re.IGNORECASE)
"""Pattern of the lines in which Ray reports the memory of the workers that it killed; its GB are 2^30 bytes."""

_DETAILS: Final = "Object store memory usage"
"""Marker in Ray's message; what follows is about the whole machine, including other people's command lines."""


def _killed_rss(error: BaseException) -> int:
    """Return the maximum number of bytes that a worker held when Ray killed workers to free memory; 0 if Ray does not
    say.
    """
    found = [float(gigabytes) for gigabytes in _KILLED.findall(str(error))]
    return int(max(found, default=0.0) * 2**30)


def _is_system(ray: Any, error: BaseException) -> bool:
    return not isinstance(error, ray.exceptions.RayTaskError)
