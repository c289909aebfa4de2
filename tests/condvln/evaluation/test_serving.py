"""A test's server that does not start, or does not end, is an error and not a wait without end."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from tests.condvln.evaluation.serving import running


class Served:
    """A server that starts and ends, or does not; it ends in any case once it is released."""

    def __init__(self, *, starts: bool = True, ends: bool = True, dies: bool = False) -> None:
        self.started = self.should_exit = False
        self.released = threading.Event()
        self._starts, self._ends, self._dies = starts, ends, dies

    def run(self) -> None:
        if self._dies:
            return
        self.started = self._starts
        while not (self.should_exit and self._ends) and not self.released.wait(0.001):
            pass


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    """A test leaves no thread behind."""
    before = {*threading.enumerate()}
    yield
    assert {*threading.enumerate()} <= before


def test_a_server_runs_during_the_block() -> None:
    server = Served()
    with running(server):
        assert server.started
        assert not server.should_exit
    assert server.should_exit


@pytest.mark.parametrize(
    ("kind", "limits", "what"),
    [
        ({"dies": True}, {}, "ended before it had started"),
        ({"starts": False}, {"starting": 0.05}, "did not start within 0.05 s"),
        ({"ends": False}, {"ending": 0.05}, "did not end within 0.05 s"),
    ],
)
def test_a_server_that_hangs_is_an_error(kind: dict[str, bool], limits: dict[str, float], what: str) -> None:
    server, before = Served(**kind), {*threading.enumerate()}
    try:
        with pytest.raises(RuntimeError, match=what), running(server, **limits):
            pass
        assert server.should_exit
    finally:
        server.released.set()
        for thread in {*threading.enumerate()} - before:
            thread.join()
