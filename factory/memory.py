"""A memory limit for a process while it works on a unit, so that a unit which is too large fails alone.

Two guards. A thread looks at the resident memory every 20 ms and, beyond the ceiling, raises ``MemoryCeilingError`` in
the main thread: between two steps of Python code, not inside a call into compiled code. For one single large request
the system's limit on private memory (``RLIMIT_DATA``) stands at 1.25 times the room that is left below the ceiling:
numpy, Arrow, numba and Python then raise ``MemoryError`` before anything is taken. Virtual memory is counted there, so
it is left a margin.

What is not guarded: C++ code that can't report a refused request (FCL, Ray's own threads) aborts its process. In a
worker that counts as its death and the unit is tried again alone; in this process it ends the run. Both need Linux;
elsewhere nothing is watched.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import gc
import resource
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Final

import pyarrow as pa

from factory import machine
from schemas.errors import MemoryCeilingError

__all__ = ["LEAST", "MemoryCeiling", "release", "share"]

LEAST: Final = 1 << 30
"""Least limit that is derived from the machine, bytes: a worker holds 0.4 GiB before it reads a scene."""

SHARE: Final = 0.8
"""Share of the machine's memory, and of what is free of it, that all workers together may take."""

_SLACK: Final = 1.25
"""Private virtual memory that is allowed, as a multiple of the resident memory left below the limit."""

_LOOK: Final = 0.02
"""Seconds between two checks of the resident memory."""

_AGAIN: Final = 1.0
"""Seconds until the error is raised again, in case a stage has swallowed it."""

_SIGNAL: Final = signal.SIGUSR2
"""Signal that the watching thread sends to the main thread; it also ends a blocking system call."""


def share(slots: int) -> int | None:
    """Return how many bytes of memory this process may hold if `slots` such processes share the machine; None where the
    system does not report its memory.
    """
    total, free = machine.memory_total(), machine.memory_available()
    if not total:
        return None
    mine = machine.rss() + int(SHARE * free / slots)
    return max(LEAST, min(int(SHARE * total / slots), mine))


def release() -> None:
    """Return freed memory to the system."""
    gc.collect()
    pa.default_memory_pool().release_unused()
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)


class MemoryCeiling:
    """The limit on the memory that this process may hold while it works on a unit.

    ceiling : bytes of resident memory; None for no ceiling
    """

    def __init__(self, ceiling: int | None) -> None:
        self.ceiling = ceiling
        self._over = False
        self._armed = False
        self._watched = False

    @contextlib.contextmanager
    def watch(self) -> Iterator[None]:
        """Context that limits the memory of one unit. It works in the main thread of a Linux process only."""
        if self.ceiling is None or not machine.rss() or threading.current_thread() is not threading.main_thread():
            yield
            return
        before = signal.signal(_SIGNAL, self._raise)
        limits = _limits()
        self._watched = True
        watcher = _watcher()
        watcher.look_after(self)
        try:
            yield
        finally:
            self._watched = False
            watcher.look_after(None)
            signal.signal(_SIGNAL, before)
            # Once more: an error that came between two steps of ``armed`` may have left it lowered.
            _limit(limits)

    @contextlib.contextmanager
    def armed(self) -> Iterator[None]:
        """Context in which the memory error may be raised. It must be entered inside ``watch`` and not be nested."""
        if not self._watched or self.ceiling is None:
            yield
            return
        before = _limits()
        try:
            _limit(_lowered(before, self.ceiling))
            self._over, self._armed = False, True
            yield
        finally:
            self._armed = False
            _limit(before)

    def named(self, error: BaseException) -> BaseException:
        """Return the error to raise for ``error``. A ``MemoryError`` that was raised elsewhere becomes an error that
        names the limit in force; any other error is returned as it is.
        """
        if self.ceiling is None or not isinstance(error, MemoryError) or isinstance(error, MemoryCeilingError):
            return error
        named = self._error(self.ceiling, str(error) or "a request was refused")
        named.__cause__ = error
        return named

    def look(self) -> bool:
        """Return whether the main thread must be interrupted now. The watching thread calls this."""
        over = self._armed and self.ceiling is not None and machine.rss() > self.ceiling
        self._over = self._over or over
        return over

    def _raise(self, signum: int, frame: FrameType | None) -> None:
        if self._over and self._armed:
            self._over = False
            assert self.ceiling is not None
            raise self._error(self.ceiling, f"it held {machine.rss() / 2**30:.2f} GiB")

    @staticmethod
    def _error(ceiling: int, what: str) -> MemoryCeilingError:
        return MemoryCeilingError(
            f"it needs more memory than the ceiling of {ceiling / 2**30:.2f} GiB a process ({what})",
            remedy="Raise ray.memory_gib, or lower ray.workers, and run again with --retry-quarantined",
        )


class _Watcher:
    """The one thread that checks the memory of this process; it sleeps while there is no ceiling to watch."""

    def __init__(self) -> None:
        self._ceiling: MemoryCeiling | None = None
        self._lock = threading.Lock()
        self._wanted = threading.Event()
        self._main = threading.main_thread().ident or 0
        threading.Thread(target=self._run, name="memory ceiling", daemon=True).start()

    def look_after(self, ceiling: MemoryCeiling | None) -> None:
        """Watch `ceiling` from now on. Once this returns, no signal is sent for the ceiling that was watched before."""
        with self._lock:
            self._ceiling = ceiling
        if ceiling is None:
            self._wanted.clear()
        else:
            self._wanted.set()

    def _run(self) -> None:
        raised = -_AGAIN
        while self._wanted.wait():
            with self._lock:
                now = time.monotonic()
                if self._ceiling is not None and now - raised >= _AGAIN and self._ceiling.look():
                    raised = now
                    signal.pthread_kill(self._main, _SIGNAL)
            time.sleep(_LOOK)


@functools.cache
def _watcher() -> _Watcher:
    return _Watcher()


def _limits() -> tuple[int, int]:
    """Return the (soft, hard) limit on private memory in bytes."""
    return resource.getrlimit(resource.RLIMIT_DATA)


def _limit(limits: tuple[int, int]) -> None:
    resource.setrlimit(resource.RLIMIT_DATA, limits)


def _lowered(limits: tuple[int, int], ceiling: int) -> tuple[int, int]:
    """Return ``limits`` (soft, hard) in bytes with the soft limit lowered. Under the new soft limit, this process can
    still allocate slightly more than what is left below ``ceiling``.
    """
    _, hard = limits
    found = machine.private_memory() + int(_SLACK * max(ceiling - machine.rss(), 0))
    return min([found, *(limit for limit in limits if limit != resource.RLIM_INFINITY)]), hard
