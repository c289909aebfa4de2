"""What a worker returns for a unit: names and hashes of its results, never rows. A receipt takes at most 2 kB when
pickled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Failure", "Receipt", "StageReceipt", "Status", "TableReceipt"]

Status = Literal["ok", "skipped", "quarantined", "partial", "memory"]
"""Status of a unit. ``partial``: no failure, done up to the requested stage; ``memory``: to be retried once with more
memory."""


@dataclass(frozen=True, slots=True)
class TableReceipt:
    """One table of one stage: its 16-byte logical hash, number of rows, and size in bytes of its canonical buffers."""

    table: str
    hash: bytes
    rows: int
    logical_bytes: int


@dataclass(frozen=True, slots=True)
class StageReceipt:
    """One stage of a unit: its key, the hashes of the key's parts (16 bytes each), and its cost.

    seconds : by the clock
    made : it was made just now, rather than found committed
    skipped : it ended the unit's chain
    cpu_seconds : CPU seconds of its process; 0 where they were not recorded
    estimate : CPU seconds by the unit's own estimate
    stored : bytes of its files in the store, by which a listing tells that one is missing or cut
    """

    stage: str
    key: bytes
    code: bytes
    inputs: bytes
    parameters: bytes
    dependencies: bytes
    seconds: float
    peak_rss: int
    made: bool
    skipped: bool
    tables: tuple[TableReceipt, ...]
    cpu_seconds: float = 0.0
    estimate: float = 0.0
    stored: int = 0


@dataclass(frozen=True, slots=True)
class Failure:
    """Why and at which stage a unit was quarantined; the full record is in the store.

    known : it stood in quarantine already and was not tried again
    attempts : how often it was tried
    """

    stage: str
    key: bytes
    cause: str
    exception: str
    message: str
    known: bool = False
    attempts: int = 1


@dataclass(frozen=True, slots=True)
class Receipt:
    """The result of one unit.

    expected : CPU seconds that were expected of it, by which a run tells how much is left; set by the executor
    """

    unit_id: str
    partition: str
    status: Status
    reason: str
    fingerprint: bytes
    stages: tuple[StageReceipt, ...]
    failure: Failure | None = None
    attempts: int = 1
    expected: float = 0.0

    @property
    def seconds(self) -> float:
        """Return the wall-clock seconds of the stages that this run executed. Stages that were found committed do not
        count.
        """
        return sum(stage.seconds for stage in self.stages if stage.made)
