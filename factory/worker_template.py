"""The process that worker processes of this machine are forked from.

The template loads once what every worker needs (modules, compiled kernels) and then forks workers, which share that
memory with it and begin to work within milliseconds. It has one thread, so that forking it is safe; a driver, which has
several, is never forked.

The driver sends a name with two open files for each worker: a socket for jobs and a file for whatever the worker
prints. The template writes lines of JSON: ``note`` (a message for the user), ``ready``, ``failed`` (an error), and for
each worker ``began`` (its number, and the ``name`` of the request) and ``ended`` (its number, ``code`` of its exit, and
``signal`` that ended it). It ends, and its workers with it, as soon as the driver closes the control socket or is gone.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import json
import os
import select
import signal
import socket
import time
import traceback
from collections.abc import Iterator
from multiprocessing.connection import Connection
from types import FrameType
from typing import Any, Final

from factory.deadline import Terminated, terminated_by_signal
from factory.preload import Preload
from factory.worker_process import pickled_error, serve
from schemas.errors import ClusterError

__all__ = ["NAME_BYTES", "run_template"]

NAME_BYTES: Final = 8
"""Length of a request for one more worker: the name by which the driver knows the request."""

GRACE: Final = 5.0
"""Seconds that workers have to leave after SIGTERM, before they are killed."""

FIRST_TO_GO: Final = "500"
"""Linux's score for processes to be ended when memory runs out: a worker, whose unit is tried again, and not the driver
(0)."""

LOOK: Final = 0.5
"""Seconds between two looks, while the template loads, at whether its driver is still there."""


def run_template(control: int, preload: Preload) -> None:
    """Be the template until the driver closes the control socket.

    control : file number of the control socket
    preload : loaded before workers are forked
    """
    faulthandler.enable()
    signal.pthread_sigmask(signal.SIG_SETMASK, [])  # whatever the driver's thread had blocked
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the driver's to handle
    terminated_by_signal()
    with socket.socket(fileno=control) as line:

        def say(**message: Any) -> None:
            line.sendall(json.dumps(message).encode() + b"\n")

        try:
            with _ended_without(line):
                preload.load(lambda text: say(note=text))
        except Exception as error:
            with contextlib.suppress(OSError):  # the driver may be gone: that is such an error, too
                say(failed=pickled_error(error).hex())
            return
        gc.collect()
        gc.freeze()  # collections in a worker would touch, and so copy, every page of it
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            say(ready=True)
            _Template(line, say).serve()
    os._exit(0)  # to free all that was loaded, piece by piece, would take half a second


@contextlib.contextmanager
def _ended_without(line: socket.socket) -> Iterator[None]:
    """Context that is left with ``Terminated`` when the driver has closed its end of `line`."""

    def look(signum: int, frame: FrameType | None) -> None:
        with contextlib.suppress(BlockingIOError):
            if not line.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT):
                raise Terminated(1)

    signal.signal(signal.SIGALRM, look)
    signal.setitimer(signal.ITIMER_REAL, LOOK, LOOK)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)


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
        poll = select.poll()  # unlike select, it takes file numbers beyond 1023
        poll.register(self._line, select.POLLIN)
        poll.register(self._woken, select.POLLIN)
        try:
            while True:
                ready = {number for number, _ in poll.poll()}
                if self._woken.fileno() in ready:
                    with contextlib.suppress(BlockingIOError):
                        self._woken.recv(4096)
                self._reap()
                if self._line.fileno() in ready:
                    asked, files, _, _ = socket.recv_fds(self._line, NAME_BYTES, 2)
                    if not asked:
                        return
                    self._fork(int.from_bytes(asked, "big"), *files)
        finally:
            self._end()

    def _fork(self, name: int, jobs: int, log: int) -> None:
        # SIGTERM between the fork and the `try` would send the child back into ``serve`` and so on to its siblings.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
        try:
            child = os.fork()
        except OSError as error:
            told = ClusterError(f"no further worker could be started: {error}", remedy="Free memory, or end processes.")
            self._say(failed=pickled_error(told).hex())
            raise Terminated(1) from error
        if child == 0:
            code = 1
            try:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
                os.set_inheritable(jobs, False)  # else what a stage starts would keep the connection open
                os.setpgid(0, 0)
                with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as score:
                    score.write(FIRST_TO_GO)
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                for end in (self._line, self._woken, self._wake):
                    end.close()
                os.dup2(log, 1)
                os.dup2(log, 2)
                os.close(log)
                code = serve(Connection(jobs))
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)  # nothing of the template's is to be ended here
        self._children.add(child)
        with contextlib.suppress(OSError):
            os.setpgid(child, child)  # set on both sides, so that the group exists whoever comes first
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(jobs)
        os.close(log)
        self._say(began=child, name=name)

    def _reap(self) -> None:
        for child in [*self._children]:
            _end_group(child)
            found, status = os.waitpid(child, os.WNOHANG)
            if found:
                self._children.discard(child)
                code = os.WEXITSTATUS(status) if os.WIFEXITED(status) else 0
                self._say(ended=child, code=code, signal=os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0)

    def _end(self) -> None:
        """End the workers: what they have in hand is not committed, and made again by the next run."""
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        limit = time.monotonic() + GRACE
        for child in self._children:
            with contextlib.suppress(OSError):
                os.kill(child, signal.SIGTERM)  # once: another would interrupt what the first one made it clean up
        while self._children and time.monotonic() < limit:
            for child in [*self._children]:
                _end_group(child)
                if _ended(child, os.WNOHANG):
                    self._children.discard(child)
            time.sleep(0.02)
        for child in self._children:
            with contextlib.suppress(OSError):
                os.killpg(child, signal.SIGKILL)  # what is left of it, and what its stages started
            _ended(child, 0)


def _ended(child: int, options: int) -> bool:
    """Return whether a worker has ended; also if its end was taken note of just before a signal came."""
    try:
        return bool(os.waitpid(child, options)[0])
    except ChildProcessError:
        return True


def _end_group(leader: int) -> None:
    """End what a worker has started, if the worker has ended: before its own end is taken note of, for until then its
    number can't be another's.
    """
    with contextlib.suppress(OSError):
        if hasattr(os, "waitid") and os.waitid(os.P_PID, leader, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
            os.killpg(leader, signal.SIGKILL)
