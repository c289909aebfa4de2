"""Parameters of a run that every worker receives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from factory.heartbeat import BUSY_SECONDS
from factory.pipeline import Pipeline
from factory.store import Store

__all__ = ["RunContext"]


@dataclass(frozen=True)
class RunContext:
    """Parameters of a run; every worker receives them once.

    shared : hashes of the pinned aggregates
    quarantined : (stage, key) pairs not to be tried again
    retrying : units in quarantine are tried again: a success takes their record away
    transient_tries : how often a stage may raise ``TransientIOError`` before its unit is quarantined
    transient_pause : seconds before the second try; each further pause is four times as long
    deadline : seconds one unit may take; None for no limit
    memory : bytes that a process which works on units may hold; None for its share of the machine (``factory.memory``)
    busy_seconds : seconds at one stage of a unit after which a worker of Ray's reports it as long under way
    """

    pipeline: Pipeline
    store: Store
    shared: Mapping[str, str] = field(default_factory=dict)
    quarantined: frozenset[tuple[str, str]] = frozenset()
    retrying: bool = False
    revision: str = ""
    transient_tries: int = 3
    transient_pause: float = 0.2
    deadline: float | None = None
    memory: int | None = None
    busy_seconds: float = BUSY_SECONDS
    faults: str = ""
    token: str = ""
    """Name of the run. A unit that this run has quarantined is not tried again within the run."""
