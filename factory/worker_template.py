"""The process that worker processes of this machine are forked from, and the loop of a worker.

The template loads once what every worker needs (modules, compiled kernels) and then forks workers, which share that
memory with it and begin to work within milliseconds. It has one thread, so that forking it is safe; a driver, which has
several, is never forked.

The driver sends one byte with two open files for each worker: a socket for jobs and a file for whatever the worker
prints. The template writes lines of JSON: ``note`` (a message for the user), ``ready``, ``failed`` (the loading), and
for each worker ``began`` (its number) and ``ended`` (its number, and that of the signal that ended it, or 0). It ends,
and its workers with it, as soon as the driver closes the control socket or is gone.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import json
import os
import pickle
import select
import signal
import socket
import threading
import time
from multiprocessing.connection import Connection
from typing import Any, Final

from factory.context import RunContext
from factory.deadline import Terminated, terminated_by_signal
from factory.executor import Task
from factory.heartbeat import Place
from factory.packing import pack
from factory.preload import Preload
from factory.worker import Worker

__all__ = ["FORK", "run_template"]

FORK: Final = b"f"
"""The byte that asks for one more worker."""

GRACE: Final = 5.0
"""Seconds that workers have to leave after SIGTERM, before they are killed."""

PAUSE: Final = 1.0
"""Seconds between two reports of a worker about a unit that takes long."""


def run_template(control: int, preload: Preload) -> None:
    """Be the template until the driver closes the control socket.

    control : file number of the control socket
    preload : loaded before workers are forked
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the driver's to handle
    terminated_by_signal()
    with socket.socket(fileno=control) as line:

        def say(**message: Any) -> None:
            line.sendall(json.dumps(message).encode() + b"\n")

        try:
            preload.load(lambda text: say(note=text))
        except Exception as error:
            with contextlib.suppress(OSError):  # the driver may be gone: that is such an error, too
                say(failed=_pickled(error).hex())
            return
        gc.collect()
        gc.freeze()  # collections in a worker would touch, and so copy, every page of it
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            say(ready=True)
            _Template(line, say).serve()
    os._exit(0)  # to free all that was loaded, piece by piece, would take half a second


class _Template:
    def __init__(self, line: socket.socket, say: Any) -> None:
        self._line = line
        self._say = say
        self._children: set[int] = set()
        self._woken, wake = socket.socketpair()
        self._woken.setblocking(False)
        wake.setblocking(False)
        self._wake = wake
        signal.signal(signal.SIGCHLD, lambda signum, frame: None)
        signal.set_wakeup_fd(wake.fileno(), warn_on_full_buffer=False)

    def serve(self) -> None:
        try:
            while True:
                ready, _, _ = select.select([self._line, self._woken], [], [])
                if self._woken in ready:
                    with contextlib.suppress(BlockingIOError):
                        self._woken.recv(4096)
                self._reap()
                if self._line in ready:
                    asked, files, _, _ = socket.recv_fds(self._line, 1, 2)
                    if not asked:
                        return
                    self._fork(*files)
        finally:
            self._end()

    def _fork(self, jobs: int, log: int) -> None:
        child = os.fork()
        if child == 0:
            code = 1
            try:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                for end in (self._line, self._woken, self._wake):
                    end.close()
                os.dup2(log, 1)
                os.dup2(log, 2)
                os.close(log)
                code = _work(Connection(jobs))
            finally:
                os._exit(code)  # nothing of the template's is to be ended here
        self._children.add(child)
        os.close(jobs)
        os.close(log)
        self._say(began=child)

    def _reap(self) -> None:
        for child in [*self._children]:
            found, status = os.waitpid(child, os.WNOHANG)
            if found:
                self._children.discard(child)
                self._say(ended=child, signal=os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0)

    def _end(self) -> None:
        """End the workers: what they have in hand is not committed, and made again by the next run."""
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        limit = time.monotonic() + GRACE
        how = signal.SIGTERM
        while self._children:
            for child in [*self._children]:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, how)
                if os.waitpid(child, os.WNOHANG)[0]:
                    self._children.discard(child)
            if self._children:
                time.sleep(0.05)
            if time.monotonic() > limit:
                how = signal.SIGKILL


# ---- a worker


class _Jobs:
    """A worker's side of its connection to the driver."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lock = threading.Lock()

    def receive(self) -> Any:
        return self._connection.recv()

    def send(self, kind: str, content: bytes) -> None:
        with self._lock:
            self._connection.send((kind, content))

    def report(self, place: Place, after: float) -> None:
        """Report from now on, from a thread, the unit at `place` when it is at one stage for `after` seconds."""

        def watch() -> None:
            said = False
            while True:
                time.sleep(PAUSE)
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


def _work(connection: Connection) -> int:
    """Serve the driver until it closes the connection; return the exit code."""
    faulthandler.enable()
    terminated_by_signal()
    jobs = _Jobs(connection)
    worker: Worker | None = None
    try:
        while True:
            kind, content = jobs.receive()
            try:
                if kind == "context":
                    context, slots = pickle.loads(content)
                    worker = _new_worker(context, slots, jobs)
                    continue
                assert worker is not None
                result: Any = _done(worker, pickle.loads(content))
            except Exception as error:
                jobs.send("raised", _pickled(error))
            else:
                jobs.send("done", pickle.dumps(result))
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


def _pickled(error: BaseException) -> bytes:
    """Return an error in a form that the driver can read, whatever it is."""
    try:
        found = pickle.dumps(error)
        pickle.loads(found)
        return found
    except Exception:
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
