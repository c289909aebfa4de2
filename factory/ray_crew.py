"""Workers of Ray: what a worker process does with a job, and which of Ray's errors mean which end of a job."""

from __future__ import annotations

import re
import secrets
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

from factory.context import RunContext
from factory.deadline import terminated_by_signal
from factory.dispatch import Job, Lost, Returned
from factory.executor import Task
from factory.heartbeat import Busy
from factory.packing import Packed, PackJob, pack
from factory.ray_board import read_board, report_to_board
from factory.ray_node import RayNode
from factory.receipt import Receipt
from factory.worker import Worker

__all__ = ["RayCrew"]

TASKS_PER_CPU: Final = 2
"""Tasks in flight for each CPU: one runs and one waits, so that no worker idles."""

LEAST_IN_FLIGHT: Final = 8
"""Tasks in flight on a cluster that has no CPUs yet, so that an autoscaler sees demand."""

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


class RayCrew:
    """The workers of a running Ray, on this machine or a cluster.

    node : asked whether Ray still lives
    grows : the cluster may gain CPUs when tasks wait for them
    most : tasks in flight at most; None for as many as the cluster has room for
    """

    def __init__(self, context: RunContext, node: RayNode, *, grows: bool, most: int | None = None) -> None:
        import ray

        self._ray = ray
        self._node = node
        self._most = most
        self._least = LEAST_IN_FLIGHT if grows else 2
        self._shipped = [ray.put(context)]
        # A run has several contexts, one for each pass.
        self._name = secrets.token_hex(8)
        self._remote: dict[type, Any] = {Task: ray.remote(work_task), PackJob: ray.remote(pack_task)}
        self._cpus, self._memory, self._node_cpus = 0.0, 0.0, 1
        self._looked = -1e9

    def busy(self) -> list[Busy]:
        """Return the units that workers reported as taking long."""
        return read_board(self._name)

    def send(self, job: Job, memory: int, *, alone: bool) -> Any:
        """Hand out a job; return the reference of its result."""
        self._node.check()
        cpus = self._node_cpus if alone else 1
        remote = self._remote[type(job)].options(num_cpus=cpus, memory=self._bounded(memory), max_retries=0)
        with self._node.answers():
            return remote.remote(self._name, self._shipped, job)

    def returned(self, flying: Sequence[Any]) -> list[tuple[Any, Returned]]:
        """Return (reference, result) of a job that came back, or nothing after a second: so signals come through and
        the cluster's growth is seen.
        """
        with self._node.answers():
            done, _ = self._ray.wait([*flying], num_returns=1, timeout=1.0)
        self._node.check()
        return [(reference, self._result(reference)) for reference in done]

    def _result(self, reference: Any) -> Returned:
        try:
            found: list[Receipt] | list[Packed] = self._ray.get(reference)
            return found
        except self._ray.exceptions.RayError as error:
            self._node.check()  # a task that is lost with this node is lost with all the others
            return _lost(error)

    def left(self, flying: Sequence[Any]) -> None:
        """Do nothing: Ray aborts this whole process when a task comes back while it is being cancelled (seen with 2.60,
        one stop in thirteen on a busy machine). Its workers end with this job; until then they may commit what they
        have in hand, which does no harm.
        """

    def room(self) -> int:
        """Return the number of tasks that may be in flight now."""
        self._node.check()
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

    def _bounded(self, memory: int) -> int:
        """Return ``memory`` in whole bytes, but at most what some node can provide. If asked for more, Ray would wait
        forever.
        """
        return int(min(memory, self._memory * 0.9)) if self._memory else memory


def _lost(error: BaseException) -> Lost:
    """Return what an error of Ray's tells of a job."""
    import ray

    if isinstance(error, ray.exceptions.RayTaskError):
        return Lost(error.cause if isinstance(error.cause, BaseException) else error, "raised")
    if isinstance(error, ray.exceptions.OutOfMemoryError):
        return Lost(error, "memory", str(error).split(_DETAILS)[0].strip(), _killed_rss(error))
    if isinstance(
        error, (ray.exceptions.NodeDiedError, ray.exceptions.LocalRayletDiedError, ray.exceptions.ObjectLostError)
    ):
        return Lost(error, "node")
    if isinstance(error, ray.exceptions.WorkerCrashedError):
        return Lost(error, "worker")
    return Lost(error, "raised")


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
