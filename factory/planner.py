"""Compares a corpus with the published index: cheaply for a run, exactly for a plan.

A plan says which units are missing, stale (and why), fresh or quarantined, and what processing them would cost.
Planning runs no stage. A plan is exact for everything that is known before running. A stage behind a stale stage is
POSSIBLE: if the output of the stale stage turns out equal, the later stage need not run (early cut-off).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa

from factory.chain import Chain, Keyer, SharedTables, StageKey, receipt_of
from factory.commits import Commits
from factory.index import Index
from factory.inventory import Inventory
from factory.pipeline import Pipeline, plain_name
from factory.receipt import Receipt, StageReceipt
from factory.stage import Unit, Work
from schemas.canonical import digest
from schemas.errors import CondVLNError, CorruptShardError, InputError, StageError, UsageError

__all__ = ["MEMORY_MARGIN", "CostModel", "Plan", "PlanEntry", "Planner"]


MEMORY_MARGIN: Final = 1.25
"""Factor on the measured peak memory when memory is requested: the same unit varies by some percent from run to run."""


class CostModel:
    """Expected CPU seconds of each stage of a unit, and expected peak memory of units.

    A stage is expected to take its estimate times measured CPU seconds over estimates: of the same unit where the
    stage was published for it, else of all units for which it was.
    """

    def __init__(self, index: Index, pipeline: Pipeline) -> None:
        self._index = index
        self._scales = {stage.name: _scale(index.table, stage.name) for stage in pipeline.stages}

    def stage_seconds(self, unit: Unit, row: int, stage: str) -> float:
        """Return the expected CPU seconds of one stage. ``row`` is the unit's row in the published index, or -1."""
        estimate = unit.costs.get(stage, 0.0)
        spent, before = self._number(row, f"{stage}.cpu_seconds"), self._number(row, f"{stage}.estimate")
        if spent > 0 and before > 0 and estimate > 0:
            return spent * estimate / before
        return spent or estimate * self._scales[stage]

    def seconds(self, unit: Unit, row: int, first: int = 0, until: int | None = None) -> float:
        """Return the expected CPU seconds of the stages at positions ``first`` to ``until`` (all by default)."""
        return sum(self.stage_seconds(unit, row, name) for name in [*self._scales][first:until])

    def memory(self, unit: Unit, row: int) -> int:
        """Return the expected peak memory of a unit in bytes: the peak measured when the unit was last made, with a
        margin, else the unit's own estimate.
        """
        peak = max(self._number(row, f"{name}.peak_rss") for name in self._scales)
        return int(MEMORY_MARGIN * peak) if peak > 0 else unit.memory

    def _number(self, row: int, column: str) -> float:
        """Return a value of the unit in ``row``; 0 where there is none."""
        found = self._index.value(row, column) if row >= 0 else None
        return 0.0 if found is None or found != found else float(found)


def _scale(table: pa.Table, stage: str) -> float:
    """Return the CPU seconds of a stage over their estimates, in all rows of an index; 1 where nothing is known."""
    spent, estimated = _numbers(table, f"{stage}.cpu_seconds"), _numbers(table, f"{stage}.estimate")
    both = (spent > 0) & (estimated > 0)
    return float(spent[both].sum() / estimated[both].sum()) if both.any() else 1.0


def _numbers(table: pa.Table, column: str) -> Any:
    """Return a column as (rows,) float64, with 0 where it is null or missing."""
    if column not in table.schema.names:
        return np.zeros(table.num_rows)
    return np.nan_to_num(table.column(column).to_numpy().astype(float))


Reason = Literal["data", "parameters", "code", "dependency", "partition", "damaged"]
"""Reasons of staleness. ``damaged``: the inputs are unchanged, but files of the unit are missing from the store or
cut."""
StagePlan = Literal["FRESH", "STALE", "MISSING", "POSSIBLE", "QUARANTINED"]
UnitPlan = Literal["FRESH", "STALE", "MISSING", "QUARANTINED"]


@dataclass(frozen=True, slots=True)
class PlanEntry:
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

    removed : units that are published and no longer in the corpus
    renewed : aggregates that would be built (none is pinned, or its version changed): units behind them show POSSIBLE
    snapshot_id : what is published now; None where nothing is
    carried : number of units for which nothing has to be done, not even publishing
    damaged : files of what is published that are missing or damaged and would be made again, the units' own left out
    """

    entries: list[PlanEntry] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    possible_seconds: float = 0.0
    removed: tuple[str, ...] = ()
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
        self.seconds += entry.seconds
        self.possible_seconds += entry.possible_seconds


class Planner:
    """Compares units with an index.

    shared : hashes of the pinned aggregates; those not there yet are left out
    stages : how many stages of the chain are planned (a first pass stops where an aggregate is built)
    made : how many stages an earlier pass of the same run made for every unit: they cost nothing more
    quarantined : (stage, key) pairs with a record that stands
    again : ids of units that count as changed
    inventory : what of the index's units is really in the store; a unit that lacks files is not fresh
    """

    def __init__(
        self,
        pipeline: Pipeline,
        commits: Commits,
        index: Index,
        shared: Mapping[str, str],
        quarantined: frozenset[tuple[str, str]] = frozenset(),
        stages: int | None = None,
        made: int = 0,
        again: frozenset[str] = frozenset(),
        inventory: Inventory | None = None,
    ) -> None:
        self.pipeline = pipeline
        self.commits = commits
        self.index = index
        self.keyer = Keyer(pipeline)
        self.stages = len(pipeline.stages) if stages is None else stages
        self._made = made
        self._whole = self.stages == len(pipeline.stages)
        self._shared = SharedTables(commits, shared)
        self._quarantined = quarantined
        self._again = again
        self._inventory = inventory
        self._status = index.table.column("status").to_pylist()
        self._fingerprints = index.table.column("fingerprint").to_pylist()
        self._model = CostModel(index, pipeline)
        self.seconds_behind = 0.0
        """Expected CPU seconds of the stages behind the planned ones, of all units that ``work`` yielded."""
        self.kept = np.zeros(len(index), bool)
        """For each row of the index whether the unit is unchanged, and its row is kept."""
        self.present = np.zeros(len(index), bool)
        """For each row of the index whether the unit is still in the corpus."""

    def compare(self, units: Iterable[Unit]) -> Iterator[tuple[Unit, bytes, int, bool]]:
        """For each unit, yield (unit, fingerprint, row, unchanged). ``row`` is the unit's position in the index, or -1
        if the index lacks the unit; ``unchanged`` tells whether the unit's published result can be kept.

        Raises ``UsageError`` on a unit id that comes twice or can't be stored.
        """
        seen: set[str] = set()
        for unit in units:
            _check(unit)
            if unit.unit_id in seen:
                raise UsageError(
                    f"two units of this run have the same id, {unit.unit_id}",
                    remedy="Ids must be unique over all sources.",
                )
            seen.add(unit.unit_id)
            row = self.index.row_of(unit.unit_id)
            checked, fingerprint = self._fingerprint(unit)
            fresh = False
            if row >= 0:
                self.present[row] = True
                fresh = fingerprint == self._fingerprints[row] and self._whole and self._stands(row)
                fresh = fresh and unit.unit_id not in self._again
                fresh = fresh and (self._inventory is None or bool(self._inventory.whole[row]))
                self.kept[row] = fresh
            yield checked, fingerprint, row, fresh

    def _stands(self, row: int) -> bool:
        """Whether the unit's published result is still valid. A quarantined unit whose record was removed is tried
        again.
        """
        if self.status(row) != "quarantined":
            return True
        failure = self.index.receipt(row, self.pipeline).failure
        return failure is not None and (failure.stage, failure.key.hex()) in self._quarantined

    def status(self, row: int) -> str:
        """Return the published status of the unit in ``row`` of the index."""
        return str(self._status[row])

    def kept_incomplete(self) -> list[int]:
        """Return the rows of the index that are kept and whose units are skipped or quarantined."""
        return [row for row in np.flatnonzero(self.kept).tolist() if self._status[row] != "ok"]

    def _fingerprint(self, unit: Unit) -> tuple[Unit, bytes]:
        if unit.fault is None:
            try:
                return unit, self.keyer.fingerprint(unit, self._shared.hashes, self.stages)
            except CondVLNError as error:
                fault = error if isinstance(error, InputError) else InputError(str(error))
            except Exception as error:
                fault = InputError(f"{type(error).__name__}: {error}", where=unit.unit_id)
            unit = replace(unit, fault=fault)
        return unit, bytes.fromhex(digest([unit.unit_id, str(unit.fault)]))[:16]

    def work(self, units: Iterable[Unit]) -> Iterator[Work]:
        """Yield the units that a run must process. For each unchanged unit, mark its row of the index in ``self.kept``
        instead.
        """
        for unit, fingerprint, row, fresh in self.compare(units):
            if not fresh:
                seconds = self._model.seconds(unit, row, self._made, self.stages)
                self.seconds_behind += self._model.seconds(unit, row, self.stages)
                yield Work(unit, fingerprint, seconds, self._model.memory(unit, row))

    def entry(self, unit: Unit, row: int, fresh: bool) -> PlanEntry:
        """Return the exact plan for one unit."""
        old = self.index.receipt(row, self.pipeline) if row >= 0 else None
        if fresh:
            assert old is not None
            if old.failure is not None:
                return self._quarantined_entry(unit, f"{old.failure.exception}: {old.failure.message}")
            return PlanEntry(
                unit.unit_id, unit.partition, "FRESH", stages=tuple((s.stage, "FRESH") for s in old.stages)
            )
        if unit.fault is not None:
            return self._quarantined_entry(unit, str(unit.fault))
        try:
            return self._walk(unit, row, old)
        except (StageError, InputError) as error:
            return self._quarantined_entry(unit, str(error))

    def _quarantined_entry(self, unit: Unit, detail: str) -> PlanEntry:
        return PlanEntry(unit.unit_id, unit.partition, "QUARANTINED", detail=detail)

    def _lost(self, stage: str, row: int) -> bool:
        return self._inventory is not None and row >= 0 and self._inventory.lost(stage, row)

    def _walk(self, unit: Unit, row: int, old: Receipt | None) -> PlanEntry:
        before = {stage.stage: stage for stage in old.stages} if old else {}
        chain = Chain(self.pipeline, self.keyer, self.commits, self._shared, unit, discard=False)
        stages: list[tuple[str, StagePlan]] = []
        reasons: list[Reason] = []
        awaits = False
        if old is not None and old.partition != unit.partition:
            reasons.append("partition")
        while chain.at < self.stages:
            stage = self.pipeline.stages[chain.at]
            if awaits := not set(stage.needs) <= set(self._shared.hashes):
                if old is not None:
                    reasons.append("dependency")
                break  # its aggregate is not there yet, and may turn out as it was
            known = before.get(stage.name)
            try:
                key = chain.key()
            except CorruptShardError:
                reasons.append("damaged")  # what the key depends on can't be read
                break
            same = known is not None and known.key == key.key
            done = known if same and not self._lost(stage.name, row) else self._committed(stage.name, key)
            if done is None:
                if same:
                    reasons.append("damaged")
                if (stage.name, key.hex) in self._quarantined:
                    record = self.commits.quarantine_record(stage.name, key.hex)
                    return self._quarantined_entry(unit, f"{record.exception}: {record.message}" if record else "")
                if known is not None:
                    reasons += _differences(known, key)
                break
            if known is not None and known.key != key.key:
                reasons += _differences(known, key)
            stages.append((stage.name, "FRESH"))
            chain.add(done)
            if done.skipped:
                break
        first = chain.at
        if not (chain.done and chain.done[-1].skipped):
            stages += self._behind(unit, first, before, reasons, sure=not awaits)
        costs = {"FRESH": 0.0, "POSSIBLE": 0.0, "STALE": 0.0, "MISSING": 0.0}
        for name, found in stages:
            costs[found] += self._model.stage_seconds(unit, row, name)
        status: UnitPlan = "MISSING" if old is None else "STALE"
        if all(plan == "FRESH" for _, plan in stages):
            # Everything is committed, by an interrupted run say: publishing is all that is left.
            status = "FRESH" if old is None or not reasons else "STALE"
        elif old is not None and not reasons:
            # It failed and is tried again: as good as missing.
            status = "MISSING"
        return PlanEntry(
            unit.unit_id,
            unit.partition,
            status,
            reasons=tuple(sorted(set(reasons))),
            stages=tuple(stages),
            seconds=costs["STALE"] + costs["MISSING"],
            possible_seconds=costs["POSSIBLE"],
        )

    def _committed(self, stage: str, key: StageKey) -> StageReceipt | None:
        if self._listed is not None and (stage, key.hex) not in self._listed:
            return None
        found = self.commits.find(stage, key.hex, discard=False)
        return receipt_of(found, made=False) if found else None

    @cached_property
    def _listed(self) -> frozenset[tuple[str, str]] | None:
        """All commits of an object store, where to ask for one takes as long as to list a thousand; else None."""
        return None if self.commits.store.local_path("units") else frozenset(self.commits.committed())

    def _behind(
        self, unit: Unit, first: int, before: Mapping[str, StageReceipt], reasons: list[Reason], *, sure: bool
    ) -> Iterator[tuple[str, StagePlan]]:
        """Yield (stage name, plan) for each stage from position ``first`` on. The stage at ``first`` is the first one
        that is not done; it will run if that is `sure`. A later one may have to run if it reads tables of one that may.
        """
        unsure = {first}
        for at in range(first, self.stages):
            stage = self.pipeline.stages[at]
            known = before.get(stage.name)
            if known is None:
                yield stage.name, "MISSING" if at == first or not before else "POSSIBLE"
                unsure.add(at)
                continue
            own: list[Reason] = []
            if known.code != self.keyer.code(at):
                own.append("code")
            if known.parameters != self.keyer.parameters(unit, at):
                own.append("parameters")
            reasons += own
            if (at == first and sure) or own:
                yield stage.name, "STALE"
                unsure.add(at)
            elif (
                stage.needs
                or stage.reads_inputs
                or any(position in unsure for _, position in self.pipeline.visible(at))
            ):
                yield stage.name, "POSSIBLE"
                unsure.add(at)
            else:
                yield stage.name, "FRESH"

    def removed(self) -> tuple[str, ...]:
        """Return the ids of published units that were not among the compared units."""
        return tuple(self.index.table.column("unit_id").filter(pa.array(~self.present)).to_pylist())


def _differences(known: StageReceipt, key: StageKey) -> list[Reason]:
    parts: tuple[tuple[Reason, str], ...] = (
        ("code", "code"),
        ("data", "inputs"),
        ("parameters", "parameters"),
        ("dependency", "dependencies"),
    )
    return [reason for reason, part in parts if getattr(known, part) != getattr(key, part)]


def _check(unit: Unit) -> None:
    try:
        unit.unit_id.encode()
    except UnicodeEncodeError as error:
        raise UsageError(f"the unit id {unit.unit_id!r} is not text that can be stored") from error
    if not unit.unit_id:
        raise UsageError("a unit has an empty id")
    if not plain_name(unit.partition):
        raise UsageError(f"the partition {unit.partition!r} of {unit.unit_id} is not a plain folder name")
