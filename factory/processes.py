"""Worker processes of this machine and the template that they are forked from, as the driver knows them."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import pickle
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe, wait
from typing import IO, Any, Final

from factory.dispatch import Job
from factory.preload import Preload
from factory.worker_template import NAME_BYTES
from schemas.errors import ClusterError, WorkerError
from schemas.standard_files import open_standard_files

__all__ = ["REMEDY", "Processes", "WorkerProcess"]

CHILD: Final = """
import json, sys
control, sys.path[:], *preload = json.loads(sys.argv[1])
from factory.preload import Preload
from factory.worker_template import run_template
run_template(control, Preload(*preload))
"""
"""Run by a Python that reads neither the environment nor the working folder, so that it imports what this process does,
and not the main module of whoever calls this package."""

REMEDY: Final = (
    "Run the same command again: it goes on from what is committed. If this happens again, look for the cause in the "
    "system's log (out of memory?), or set fewer ray.workers."
)

LAST_WORDS: Final = 1500
"""Characters of what a worker printed that are quoted when it died."""

LOG_BYTES: Final = 1 << 16
"""Bytes of a dead worker's log that are searched for its last words."""

_DUMP: Final = re.compile(r"^(Fatal Python error|Timeout \()", re.MULTILINE)
"""Where Python begins to tell where a process stood that was ended."""

END_SECONDS: Final = 20.0
"""Seconds that the template has to end its workers and itself."""


@dataclass(slots=True)
class WorkerProcess:
    """A worker process, as the driver knows it.

    serves : number of the crew whose context the worker was sent
    ready : it has loaded that context, or failed to
    job : number, content and expected memory of the job that it has in hand, and whether it is to run alone
    busy : what it reported of a unit that takes long
    """

    connection: Connection
    log: IO[bytes]
    number: int = 0
    ready: bool = False
    serves: int = -1
    job: tuple[int, Job, int, bool] | None = None
    busy: tuple[str, str, float] | None = None


class Processes:
    """The worker processes of an executor and their template, which live until ``end``.

    numbers : of crews and of jobs, so that no two of an executor share one
    note : shows what the template says while it loads
    environment : variables set for the template and its workers
    """

    def __init__(self, preload: Preload, note: Callable[[str], None], environment: Mapping[str, str]) -> None:
        self.all: list[WorkerProcess] = []
        self._rest = b""
        self._ended: dict[int, tuple[int, int]] = {}
        self._began: dict[int, int] = {}
        self._names = itertools.count(1)
        self.numbers = itertools.count(1)
        open_standard_files()
        ours, theirs = socket.socketpair()
        path = [entry for entry in sys.path if isinstance(entry, str)]
        told = json.dumps([theirs.fileno(), path, preload.module, preload.function, preload.arguments])
        try:
            self._template = subprocess.Popen(
                [sys.executable, "-I", "-u", "-c", CHILD, told],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env={**os.environ, **environment},
                pass_fds=[theirs.fileno()],
                # Not reached by Ctrl-C, which is the driver's to handle.
                start_new_session=True,
            )
        except (OSError, TypeError) as error:
            ours.close()
            raise ClusterError(
                f"the process that starts workers can't be started with Python {sys.executable!r}: {error}",
                remedy="Correct the environment that runs this Python, or do the work in one process (--inline).",
            ) from error
        finally:
            theirs.close()
        self._line = ours
        try:
            while "ready" not in (message := self._next(None)):
                if "note" in message:
                    note(message["note"])
        except BaseException:
            self.end()
            raise

    @property
    def template(self) -> int:
        """Return the number of the template's process."""
        return self._template.pid

    def _next(self, seconds: float | None) -> dict[str, Any]:
        """Return the next message of the template; nothing if none came within so many seconds."""
        limit = None if seconds is None else time.monotonic() + seconds
        while b"\n" not in self._rest:
            left = None if limit is None else max(limit - time.monotonic(), 0.0)
            if not wait([self._line], left):
                return {}
            try:
                found = self._line.recv(65536)
            except ConnectionError:  # it ended before it read all that it was sent
                found = b""
            if not found:
                raise ClusterError("the process that starts workers has ended", remedy=REMEDY)
            self._rest += found
        line, _, self._rest = self._rest.partition(b"\n")
        message: dict[str, Any] = json.loads(line)
        if "began" in message:
            self._ended.pop(message["began"], None)  # another process had this number before
            self._began[message["name"]] = message["began"]
        if "failed" in message:
            raise pickle.loads(bytes.fromhex(message["failed"]))
        if "ended" in message:
            self._ended[message["ended"]] = (message["code"], message["signal"])
        return message

    def check(self) -> None:
        """Read what the template has to say. Raises ``ClusterError`` if it is gone."""
        while self._next(0.0):
            pass

    def fork(self) -> WorkerProcess:
        """Start one more worker."""
        ours, theirs = Pipe()
        log = tempfile.TemporaryFile("a+b", buffering=0)  # noqa: SIM115 - open as long as the worker lives
        # An interrupt may keep the driver from waiting for a worker, so answers are known by a name.
        name = next(self._names)
        process = WorkerProcess(ours, log)
        with theirs:  # open until the template has it: macOS may drop a file that is closed on its way
            try:
                socket.send_fds(self._line, [name.to_bytes(NAME_BYTES, "big")], [theirs.fileno(), log.fileno()])
            except OSError as error:
                raise ClusterError("the process that starts workers has ended", remedy=REMEDY) from error
            while name not in self._began:
                self._next(None)
        process.number = self._began.pop(name)
        self.all.append(process)  # one that nobody waited for ends by itself when its connection is closed
        return process

    def bury(self, process: WorkerProcess) -> WorkerError:
        """Take note that a worker has died; return the error that tells how."""
        limit = time.monotonic() + 2.0
        while process.number not in self._ended and time.monotonic() < limit:
            self._next(0.1)
        how = _how(self._ended.pop(process.number, None))
        size = os.fstat(process.log.fileno()).st_size
        words = _last_words(os.pread(process.log.fileno(), LOG_BYTES, max(size - LOG_BYTES, 0)))
        self._forget(process)
        return WorkerError(f"the worker {how}" + (f"; its last words were: {words}" if words else ""))

    def dead(self, process: WorkerProcess) -> bool:
        """Return whether a worker has ended, though a process that it started may hold its connection open."""
        return process.number in self._ended

    def kill(self, process: WorkerProcess) -> None:
        """End a worker whatever it does."""
        with contextlib.suppress(ClusterError):  # its workers are to end all the same
            self.check()
        if process.number not in self._ended:  # else another process may have its number by now
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.number, signal.SIGKILL)
        try:
            self.bury(process)
        except ClusterError:
            self._forget(process)

    def _forget(self, process: WorkerProcess) -> None:
        self.all.remove(process)
        process.connection.close()
        process.log.close()

    def end(self) -> None:
        """End the workers and the template."""
        for process in [*self.all]:
            if process.job is not None:
                self.kill(process)
            else:
                self._forget(process)
        self._line.close()
        # It listens while it serves; while it still loads, only a signal stops it.
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._template.wait(0.5)
        self._template.terminate()
        try:
            self._template.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self._template.kill()
            self._template.wait()


def _how(status: tuple[int, int] | None) -> str:
    """Return how a worker ended, by its exit code and the number of the signal that ended it."""
    if status is None:
        return "ended; how is not known"
    code, number = status
    if not number:
        return f"left by itself with exit code {code}"
    try:
        return f"was ended by signal {signal.Signals(number).name}"
    except ValueError:  # a real-time signal
        return f"was ended by signal {number}"


def _last_words(log: bytes) -> str:
    """Return the end of what a worker printed; where Python told where it stood, the beginning of that, and what came
    before.
    """
    text = log.decode("utf-8", "replace").partition("\n\nExtension modules:")[0]
    dump = _DUMP.search(text)
    if dump is None:
        return text[-LAST_WORDS:].strip()
    return text[max(dump.start() - LAST_WORDS // 2, 0) : dump.start() + LAST_WORDS].strip()
