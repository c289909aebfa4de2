"""What a worker process of this machine does: it takes jobs from its driver, one after the other, and answers each."""

from __future__ import annotations

import contextlib
import faulthandler
import pickle
import threading
from multiprocessing.connection import Connection
from typing import Any, Final

from factory.context import RunContext
from factory.deadline import Terminated, terminated_by_signal
from factory.executor import Task
from factory.heartbeat import Place
from factory.packing import pack
from factory.worker import Worker
from schemas.errors import CondVLNError, UsageError

__all__ = ["pickled_error", "serve"]

PAUSE: Final = 1.0
"""Seconds between two reports of a worker about a unit that takes long."""


class _Jobs:
    """A worker's side of its connection to the driver."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self._over = threading.Event()

    def receive(self) -> Any:
        return self._connection.recv()

    def send(self, kind: str, content: bytes, number: int = 0) -> None:
        with self._lock:
            self._connection.send((kind, number, content))

    def report(self, place: Place, after: float) -> None:
        """Report from now on, from a thread, the unit at `place` when it is at one stage for `after` seconds."""

        self._over.set()
        over = self._over = threading.Event()

        def watch() -> None:
            said = False
            while not over.wait(PAUSE):
                busy = place.busy()
                if busy is not None and busy.seconds >= after:
                    self.send("busy", pickle.dumps((busy.unit_id, busy.stage, busy.seconds)))
                    said = True
                elif said:
                    self.send("busy", pickle.dumps(None))
                    said = False

        def quietly() -> None:
            with contextlib.suppress(OSError):  # the driver is gone, which the main thread learns too
                watch()

        threading.Thread(target=quietly, name="reports", daemon=True).start()


def serve(connection: Connection) -> int:
    """Serve the driver until it closes the connection; return the exit code."""
    faulthandler.enable()
    terminated_by_signal()
    jobs = _Jobs(connection)
    worker: Worker | None = None
    fault = UsageError("a worker was given a job before the run")
    try:
        while True:
            kind, number, content = jobs.receive()
            if kind == "context":
                worker = None
                try:
                    context, slots = pickle.loads(content)
                    worker = _new_worker(context, slots, jobs)
                except Exception as error:  # told to each job: one job, one answer
                    fault = UsageError(
                        f"a worker can't load what the run is made of: {type(error).__name__}: {error}",
                        remedy="Define stages in a module that can be imported, not in the script that is run.",
                    )
                jobs.send("ready", pickle.dumps(None))
                continue
            try:
                if worker is None:
                    raise fault
                result = pickle.dumps(_done(worker, pickle.loads(content)))
            except Exception as error:
                jobs.send("raised", pickled_error(error), number)
            else:
                jobs.send("done", result, number)
    except (EOFError, ConnectionResetError, BrokenPipeError):
        return 0  # the driver needs this worker no more
    except (Terminated, KeyboardInterrupt):
        return 1


def _new_worker(context: RunContext, slots: int, jobs: _Jobs) -> Worker:
    worker = Worker(context, may_exit=True, slots=slots)
    jobs.report(worker.place, context.busy_seconds)
    return worker


def _done(worker: Worker, job: Any) -> list[Any]:
    if not isinstance(job, Task):
        run = worker.context
        return [pack(run.store, run.pipeline, job, run.faults)]
    return [
        worker.work(item.unit, job.until, item.fingerprint, attempt=job.attempt, last_try=job.last_try)
        for item in job.work
    ]


def pickled_error(error: BaseException) -> bytes:
    """Return an error in a form that the driver can read, whatever it is."""
    try:
        found = pickle.dumps(error)
        pickle.loads(found)
        return found
    except Exception:
        try:
            text = str(error)
        except Exception:
            text = "(its message can't be shown)"
        ours = next((kind for kind in type(error).__mro__ if kind.__module__ == CondVLNError.__module__), None)
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {text}") if ours is None else ours(text))
