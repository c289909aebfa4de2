"""A small process that reports the reason when Ray ends the driver.

When a node dies, Ray's compiled code may end the driver within milliseconds, past every handler of Python. So a driver
that starts Ray also starts this file as a script, writes to its input how far it is, and says goodbye when it ends in
any way of its own. Where the input ends without a goodbye, the guard writes what happened to standard error. The exit
code is Ray's then, which is not 0.
"""

from __future__ import annotations

import atexit
import subprocess
import sys
from pathlib import Path

__all__ = ["ADVICE", "COMMITTED", "Guard"]

COMMITTED = "they and every finished stage of the others are committed, but nothing was published"

ADVICE = (
    "Run the same command again: it goes on from what is committed. If this happens again, look for the cause in "
    "{logs} and in the system's log (out of memory, a full disk), or set fewer ray.workers."
)

_BYE = b"bye\n"
_TAIL = 1 << 16
"""Bytes of the raylet's log that are searched for the reason of its end."""


class Guard:
    """The driver's side of the guard: starts the process and reports progress to it.

    logs : Ray's folder of logs
    """

    def __init__(self, logs: str) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", __file__, logs],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                # Not reached by Ctrl-C, which is the driver's to handle.
                start_new_session=True,
            )
        except OSError:
            return  # the run does without
        atexit.register(self.end)

    def done(self, units: int) -> None:
        """Set how many units of this pass are done."""
        self._write(b"%d\n" % units)

    def end(self) -> None:
        """Stop the guard: the driver goes on without Ray, or ends normally."""
        self._write(_BYE)
        process, self._process = self._process, None
        if process is not None and process.stdin is not None:
            atexit.unregister(self.end)
            try:
                process.stdin.close()
                process.wait(timeout=5.0)
            except (OSError, subprocess.TimeoutExpired):
                process.kill()

    def _write(self, line: bytes) -> None:
        if self._process is not None and self._process.stdin is not None:
            try:
                self._process.stdin.write(line)
                self._process.stdin.flush()
            except (OSError, ValueError):
                pass


def watch(logs: str) -> str:
    """Read the driver's lines from standard input until the input ends. Return the message to print; empty if the
    driver said goodbye.
    """
    units = 0
    for line in sys.stdin.buffer:
        if line == _BYE:
            return ""
        if line.strip().isdigit():
            units = int(line)
    return (
        f"condvln: Ray died while units were under way and ended this process: {_reason(logs)}. {units} units of this "
        f"pass were done; {COMMITTED}. {ADVICE.format(logs=logs or 'its logs')}"
    )


def _reason(logs: str) -> str:
    """Return, in one line, why Ray's node ended, as far as the node's log tells."""
    try:
        data = Path(logs, "raylet.out").read_bytes()[-_TAIL:].decode("utf-8", "replace")
    except OSError:
        data = ""
    for line in reversed(data.splitlines()):
        # "[2026-11-22 08:35:25,819 E 31432 31476] (raylet) agent_manager.cc:87: The raylet exited …"
        _, found, what = line.partition("The raylet exited")
        if found:
            return f"its node wrote: {found}{what.rstrip('. ')}"
    return "its node was lost, or the system ended the process (out of memory?)"


if __name__ == "__main__":
    said = watch(sys.argv[1])
    if said:
        sys.stderr.write(f"\n{said}\n")
        sys.stderr.flush()
