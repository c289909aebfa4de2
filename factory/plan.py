"""A plan: which units are missing, stale (and why), fresh or quarantined, and what processing them would cost.

Planning runs no stage. A plan is exact for everything that is known before running. A stage behind a stale stage is
POSSIBLE: if the output of the stale stage turns out equal, the later stage need not run (early cut-off).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

from factory.record import Record
from factory.spool import Spool

__all__ = ["Plan", "PlanEntry", "Reason", "StagePlan", "UnitPlan"]

Reason = Literal["data", "parameters", "code", "dependency", "partition", "damaged"]
"""Reasons of staleness. ``damaged``: the inputs are unchanged, but files of the unit are missing from the store or
cut."""
StagePlan = Literal["FRESH", "STALE", "MISSING", "POSSIBLE", "QUARANTINED"]
UnitPlan = Literal["FRESH", "STALE", "MISSING", "QUARANTINED"]


@dataclass(frozen=True, slots=True)
class PlanEntry(Record):
    """What a run would do with one unit.

    reasons : what changed since it was published, for a stale unit
    stages : what would become of each stage, up to one that skipped or failed
    seconds : estimated cost of the stages that will run (POSSIBLE ones not counted)
    possible_seconds : estimated cost of the POSSIBLE ones
    detail : why it is quarantined
    """

    unit_id: str
    partition: str
    status: UnitPlan
    reasons: tuple[Reason, ...] = ()
    stages: tuple[tuple[str, StagePlan], ...] = ()
    seconds: float = 0.0
    possible_seconds: float = 0.0
    detail: str = ""


@dataclass
class Plan:
    """All entries of a plan, and sums over them.

    entries : on disk when there are many; iterate
    removed : units that are published and no longer in the corpus
    renamed : (old id, new id) of removed and missing units with the same bytes: their rows name them, so they are made
    renewed : aggregates that would be built (none is pinned, or its version changed): units behind them show POSSIBLE
    snapshot_id : what is published now; None where nothing is
    carried : number of units for which nothing has to be done, not even publishing
    damaged : files of what is published that are missing or damaged and would be made again, the units' own left out
    """

    entries: Spool[PlanEntry]
    counts: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    stages: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    possible_seconds: float = 0.0
    removed: tuple[str, ...] = ()
    renamed: tuple[tuple[str, str], ...] = ()
    renewed: tuple[str, ...] = ()
    damaged: tuple[str, ...] = ()
    snapshot_id: str | None = None
    carried: int = 0

    @property
    def empty(self) -> bool:
        """Whether a run would change nothing."""
        return not (self.counts["MISSING"] or self.counts["STALE"] or self.removed or self.renewed or self.damaged)

    @property
    def unchanged(self) -> bool:
        """Whether a run would publish exactly what is published now. True also means that a listing of the store found
        every published file.
        """
        return self.empty and self.snapshot_id is not None and self.carried == len(self.entries)

    def add(self, entry: PlanEntry) -> None:
        """Add one unit."""
        self.entries.append(entry)
        self.counts[entry.status] += 1
        self.reasons.update(entry.reasons)
        self.stages.update(f"{stage} {status}" for stage, status in entry.stages)
        self.seconds += entry.seconds
        self.possible_seconds += entry.possible_seconds
