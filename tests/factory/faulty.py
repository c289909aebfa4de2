"""A store that kills its process, or fails, at a chosen write. Imported by path, as ``toys`` is."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

from factory.store import LocalStore
from schemas.errors import StoreError, TransientIOError

POINTS = {
    "unit-before-data": ("before", r"units/.*\.parquet"),
    "unit-between-data": ("after", r"units/.*\.parquet"),
    "unit-before-commit": ("before", r"units/.*/unit\.json"),
    "unit-after-commit": ("after", r"units/.*/unit\.json"),
    "quarantine-before-record": ("before", "quarantine/.*"),
    "pin-before-table": ("before", "aggregates/.*"),
    "pin-before-pin": ("before", "pins/.*"),
    "pin-after-pin": ("after", "pins/.*"),
    "snapshot-before-parts": ("before", "snapshots/.*/part-.*"),
    "snapshot-between-parts": ("after", "snapshots/.*/part-.*"),
    "snapshot-before-manifest": ("before", r"snapshots/.*/manifest\.json"),
    "snapshot-before-index": ("before", "indexes/.*"),
    "snapshot-before-ref": ("before", "refs/.*"),
    "snapshot-after-ref": ("after", "refs/.*"),
}
"""Before or after a write of which path."""


class FaultyStore(LocalStore):
    """A local store with a fault ``point[@n][=action]``: at the n-th time (default first) that the point is reached in
    a process, ``kill`` (the default), ``full`` (no space left) or ``transient`` (``TransientIOError``).
    """

    def __init__(self, root: Path, fault: str) -> None:
        super().__init__(root, durable=False)
        place, _, action = fault.partition("=")
        self.point, _, count = place.partition("@")
        self.when, self.path = POINTS[self.point]
        self.action, self.left = action or "kill", int(count or 1)

    def write(self, path: str, data: bytes, *, settle: bool = True) -> None:
        self.reach("before", path)
        super().write(path, data, settle=settle)
        self.reach("after", path)

    def reach(self, when: str, path: str) -> None:
        if when != self.when or not re.fullmatch(self.path, path):
            return
        self.left -= 1
        if self.left:
            return
        if self.action == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        raise (TransientIOError if self.action == "transient" else StoreError)(f"no space left: injected at {path}")
