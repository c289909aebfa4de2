"""Stop a unit that exceeds its time limit, or a run that receives SIGTERM, the signal that schedulers send.

Python code is interrupted by a signal and quarantined with its traceback. Compiled code that keeps the interpreter
locked cannot be: there, in a worker process that may die, a watchdog written in C prints where every thread stands
(to the worker's log) and ends the process; the driver then counts the death.
"""

from __future__ import annotations

import contextlib
import faulthandler
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Final

from schemas.errors import DeadlineError

__all__ = ["Deadline", "Terminated", "terminable", "terminated_by_signal"]

_AGAIN: Final = 1.0
"""Seconds until the signal is sent again, in case a stage has swallowed the error."""

_GRACE: Final = 5.0
"""Seconds past the deadline after which a process whose compiled code does not return is ended."""


class Terminated(SystemExit):
    """Raised in a worker that receives SIGTERM. The worker's unit is not at fault and must not go to quarantine, unlike
    a unit whose stage raises ``SystemExit`` itself.
    """


class Deadline:
    """The time limit of one unit.

    seconds : the whole limit; None for no limit
    may_exit : this process may be ended by the watchdog (a worker, not the driver)
    """

    def __init__(self, seconds: float | None, *, may_exit: bool = False) -> None:
        self.seconds = seconds
        self._end = time.monotonic() + (seconds or 0.0)
        self._may_exit = may_exit

    @contextlib.contextmanager
    def watch(self) -> Iterator[None]:
        """Context that raises ``DeadlineError`` when the time is up. It works in the main thread only."""
        if self.seconds is None or threading.current_thread() is not threading.main_thread():
            yield
            return
        watching = True
        limit = self.seconds

        def late(signum: int, frame: FrameType | None) -> None:
            if watching:
                raise DeadlineError(f"the unit ran longer than its deadline of {limit:g} s")

        left = max(self._end - time.monotonic(), 1e-3)
        before = signal.signal(signal.SIGALRM, late)
        signal.setitimer(signal.ITIMER_REAL, left, _AGAIN)
        if self._may_exit:
            faulthandler.dump_traceback_later(left + _GRACE, exit=True)
        try:
            yield
        finally:
            watching = False
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)
            if self._may_exit:
                faulthandler.cancel_dump_traceback_later()


@contextlib.contextmanager
def terminable() -> Iterator[threading.Event]:
    """Let SIGTERM stop a run as Ctrl-C does: no more work is handed out, and a run that started Ray shuts Ray down.

    The event is set as well: what is raised inside a callback of C code may be printed and forgotten there.
    """
    stopped = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stopped
        return

    def stop(signum: int, frame: FrameType | None) -> None:
        stopped.set()
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield stopped
    finally:
        signal.signal(signal.SIGTERM, before)


def terminated_by_signal() -> None:
    """Let SIGTERM raise ``Terminated`` in this process from now on. Workers get SIGTERM when
    their driver or their node ends.
    """

    def stop(signum: int, frame: FrameType | None) -> None:
        raise Terminated(1)

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, stop)
