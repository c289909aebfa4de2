"""A test's server that does not start, or does not end, is an error and not a wait without end."""

from __future__ import annotations

import time

import pytest

from tests.condvln.evaluation.serving import running


class Served:
    """A server that starts and ends, or does not."""

    def __init__(self, *, starts: bool = True, ends: bool = True, dies: bool = False) -> None:
        self.started = self.should_exit = False
        self._starts, self._ends, self._dies = starts, ends, dies

    def run(self) -> None:
        if self._dies:
            return
        self.started = self._starts
        until = time.monotonic() + 5
        while time.monotonic() < until and not (self.should_exit and self._ends):
            time.sleep(0.001)


def test_a_server_runs_during_the_block() -> None:
    server = Served()
    with running(server):
        assert server.started
        assert not server.should_exit
    assert server.should_exit


@pytest.mark.parametrize(
    ("server", "what"),
    [
        (Served(dies=True), "ended before it had started"),
        (Served(starts=False), "did not start within 0.05 s"),
        (Served(ends=False), "did not end within 0.05 s"),
    ],
)
def test_a_server_that_hangs_is_an_error(server: Served, what: str) -> None:
    with pytest.raises(RuntimeError, match=what), running(server, 0.05):
        pass
    assert server.should_exit
