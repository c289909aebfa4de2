"""A server of a test in a thread of its own, which is waited for, but not for ever."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

SECONDS = 60.0
"""Within this time a server starts, and ends, on any machine."""


class Server(Protocol):
    """What is used of ``uvicorn.Server``."""

    started: bool
    should_exit: bool

    def run(self) -> None: ...


@contextmanager
def running(server: Server, *, starting: float = SECONDS, ending: float = SECONDS) -> Iterator[None]:
    """Run a server during the block.

    starting, ending : seconds within which it has to start, and to end

    Raises
    ------
    RuntimeError : it ended before it had started, or did not start or end in time
    """
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    latest = time.monotonic() + starting
    try:
        while not server.started:
            if not thread.is_alive():
                raise RuntimeError("the server ended before it had started")
            if time.monotonic() > latest:
                raise RuntimeError(f"the server did not start within {starting:g} s")
            time.sleep(0.01)
        yield
    finally:
        server.should_exit = True
        thread.join(ending)
    if thread.is_alive():
        raise RuntimeError(f"the server did not end within {ending:g} s")
