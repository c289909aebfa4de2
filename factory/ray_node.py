"""Checks whether Ray is still alive, so that its end is reported as one clear error.

When the raylet (Ray's process of each node) or the control store of the head ends, Ray's own code ends the driver
some seconds later, in the middle of whatever it does and with raw lines of its log. Whoever drives Ray therefore asks
here first, at least once a second. Where Ray is quicker than that, the last word is the guard's (``ray_guard``).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

from factory.ray_guard import ADVICE
from schemas.errors import ClusterError

__all__ = ["RayNode", "lost"]

_ESSENTIAL: Final = {"raylet": "raylet", "gcs_server": "control store (gcs_server)"}
"""Processes that a local Ray needs, by Ray's names for them."""

_PAUSE: Final = 5.0
"""Seconds between two checks of a cluster whose processes are not ours."""


class RayNode:
    """The Ray node to which this process is connected."""

    def __init__(self) -> None:
        self._processes = dict(_own_processes())
        self._node_id = _own_node_id()
        self._asked = time.monotonic()
        self.logs = _logs()

    def check(self) -> None:
        """Raise ``ClusterError`` when Ray can't go on. The check takes microseconds if Ray was started here."""
        for name, poll in self._processes.items():
            code = poll()
            if code is not None:
                how = f"signal {-code}" if code < 0 else f"exit code {code}"
                raise lost(f"its {name} ended ({how})", self.logs)
        now = time.monotonic()
        if not self._processes and self._node_id and now - self._asked > _PAUSE:
            self._asked = now
            import ray

            with answered(self.logs):
                states = {node["NodeID"]: node["Alive"] for node in ray.nodes()}  # type: ignore[no-untyped-call]
            if states.get(self._node_id) is False:
                raise lost("the cluster counts the driver's node as dead", self.logs)

    @contextmanager
    def answers(self) -> Iterator[None]:
        """Context in which this process calls Ray. It raises ``ClusterError`` if Ray no longer answers."""
        self.check()
        with answered(self.logs):
            yield


@contextmanager
def answered(logs: str = "") -> Iterator[None]:
    """Context that converts Ray's errors about a lost connection to ``ClusterError``."""
    import ray

    try:
        yield
    except (ConnectionError, ray.exceptions.RaySystemError, ray.exceptions.RpcError) as error:
        first = next(iter(str(error).strip().splitlines()), type(error).__name__)
        raise lost(f"it does not answer any more ({first})", logs) from error


def lost(what: str, logs: str = "") -> ClusterError:
    """Return the error that reports that Ray has died; ``what`` tells how this was noticed."""
    return ClusterError(f"Ray died while units were under way: {what}", remedy=ADVICE.format(logs=logs or "its logs"))


def _own_processes() -> Iterator[tuple[str, Callable[[], int | None]]]:
    """Yield (name, function) for each essential process of Ray that this process started. The function returns the exit
    code of the Ray process, or None while it is alive. If this process joined a running cluster, nothing is yielded.
    """
    try:
        from ray._private import worker

        node = worker._global_node
        started: Mapping[str, Any] = {} if node is None else node.all_processes
        for kind, name in _ESSENTIAL.items():
            for info in started.get(kind, ()):
                yield name, info.process.poll
    except (ImportError, AttributeError):
        return  # another version of Ray: its own end of the driver is all there is


def _own_node_id() -> str:
    import ray

    try:
        return str(ray.get_runtime_context().get_node_id())
    except Exception:
        return ""  # a driver that uses Ray's client runs on no node of the cluster


def _logs() -> str:
    try:
        from ray._private import worker

        node = worker._global_node
        return "" if node is None else str(node.get_logs_dir_path())
    except (ImportError, AttributeError):
        return ""
