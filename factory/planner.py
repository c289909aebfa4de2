"""Compares a corpus with the published index: cheaply for a run, exactly for a plan."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from factory.chain import Chain, SharedTables, receipt_of
from factory.commits import Commits
from factory.costs import CostModel
from factory.flags import Flags
from factory.index import STATUSES, Index, id_hashes
from factory.inventory import Inventory
from factory.key import Keyer, StageKey
from factory.pipeline import Pipeline, plain_name
from factory.plan import PlanEntry, Reason, StagePlan, UnitPlan
from factory.receipt import Receipt, StageReceipt
from factory.scratch import batches, let_go
from factory.sorting import SortedNumbers
from factory.unit import Unit, Work
from schemas.errors import CondVLNError, CorruptShardError, InputError, StageError, UsageError

__all__ = ["Planner"]

_BATCH: Final = 512
"""Number of units that are compared at a time."""


PROBES: Final = 100
"""Number of single requests to an object store after which all commits are listed instead, a thousand per request."""


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
        self._incomplete = Flags(len(index))
        for start, batch in batches(index.rows, ["status"]):
            other = pc.not_equal(batch.column(0), STATUSES[0]).to_numpy(zero_copy_only=False)
            self._incomplete[start + np.flatnonzero(other)] = True
        self._model = CostModel(index, pipeline)
        self._probes = 0
        self._listed: frozenset[tuple[str, str]] | None = None
        self._new = SortedNumbers()
        """Hashes of the ids that are not in the index."""
        self._all_fresh: tuple[tuple[str, StagePlan], ...] = tuple((stage.name, "FRESH") for stage in pipeline.stages)
        self.seconds_behind = 0.0
        """Expected CPU seconds of the stages behind the planned ones, of all units that ``work`` yielded."""
        self.kept = Flags(len(index))
        """For each row of the index whether the unit is unchanged, and its row is kept."""
        self._only_damaged = Flags(len(index))
        self.present = Flags(len(index))
        """For each row of the index whether the unit is still in the corpus."""

    def compare(self, units: Iterable[Unit]) -> Iterator[tuple[Unit, bytes, int, bool]]:
        """For each unit, yield (unit, fingerprint, row, unchanged). ``row`` is the unit's position in the index, or -1
        if the index lacks the unit; ``unchanged`` tells whether the unit's published result can be kept.

        Raises ``UsageError`` on a unit id that comes twice or can't be stored.
        """
        stream = iter(units)
        twice = False
        while batch := [*islice(stream, _BATCH)]:
            for unit in batch:
                _check(unit)
            rows = self.index.rows_of([unit.unit_id for unit in batch])
            known = rows[rows >= 0]
            twice = twice or len(np.unique(known)) < len(known) or bool(self.present[known].any())
            self.present[known] = True
            self._new.add(id_hashes([unit.unit_id for unit, row in zip(batch, rows, strict=True) if row < 0]))
            published = iter(self.index.take(known, ["fingerprint"]).column(0).to_pylist())
            let_go()
            for unit, row in zip(batch, rows.tolist(), strict=True):
                checked, fingerprint = self._fingerprint(unit)
                fresh = row >= 0 and fingerprint == next(published) and self._whole and self._stands(row)
                fresh = fresh and unit.unit_id not in self._again
                if fresh and self._inventory is not None and not self._inventory.whole[row]:
                    self._only_damaged[row] = True
                    fresh = False
                if fresh:
                    self.kept[row] = True
                yield checked, fingerprint, row, fresh
        new, self._new = self._new, SortedNumbers()
        last = np.empty(0, np.uint64)
        for piece in new:
            joined = np.concatenate((last, piece))
            twice = twice or bool((joined[1:] == joined[:-1]).any())
            last = piece[-1:]
        if twice:
            raise UsageError("two units of this run have the same id", remedy="Ids must be unique over all sources.")

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
        return str(self.index.value(row, "status")) if self._incomplete[row] else STATUSES[0]

    def kept_incomplete(self) -> Iterator[int]:
        """Yield the rows of the index that are kept and whose units are skipped or quarantined."""
        return self.kept.both(self._incomplete)

    def _fingerprint(self, unit: Unit) -> tuple[Unit, bytes]:
        if unit.fault is None:
            try:
                return unit, self.keyer.fingerprint(unit, self._shared.hashes, self.stages)
            except CondVLNError as error:
                fault = error if isinstance(error, InputError) else InputError(str(error))
            except Exception as error:
                fault = InputError(f"{type(error).__name__}: {error}", where=unit.unit_id)
            unit = replace(unit, fault=fault)
        return unit, id_hashes([unit.unit_id]).tobytes() + id_hashes([str(unit.fault)]).tobytes()

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
        if fresh and self.status(row) == "ok":
            return PlanEntry(unit.unit_id, unit.partition, "FRESH", stages=self._all_fresh)
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
        if old is not None and self._only_damaged[row]:
            return self._damaged_entry(unit, old, row)
        try:
            return self._walk(unit, row, old)
        except (StageError, InputError) as error:
            return self._quarantined_entry(unit, str(error))

    def _quarantined_entry(self, unit: Unit, detail: str) -> PlanEntry:
        return PlanEntry(unit.unit_id, unit.partition, "QUARANTINED", detail=detail)

    def _lost(self, stage: str, row: int) -> bool:
        return self._inventory is not None and row >= 0 and self._inventory.lost(stage, row)

    def _damaged_entry(self, unit: Unit, old: Receipt, row: int) -> PlanEntry:
        """Return the plan for a unit whose inputs are unchanged, but which has files in the store that are missing or
        cut short. Only the stages that wrote those files run again, and they give the same rows as before.
        """
        lost = {stage.stage for stage in old.stages if self._lost(stage.stage, row)}
        return PlanEntry(
            unit.unit_id,
            unit.partition,
            "STALE",
            reasons=("damaged",),
            stages=tuple((stage.stage, "STALE" if stage.stage in lost else "FRESH") for stage in old.stages),
            seconds=sum(
                self._model.stage_seconds(unit, row, stage.stage) for stage in old.stages if stage.stage in lost
            ),
        )

    def _walk(self, unit: Unit, row: int, old: Receipt | None) -> PlanEntry:
        before = {stage.stage: stage for stage in old.stages} if old else {}
        chain = Chain(self.pipeline, self.keyer, self.commits, self._shared, unit, discard=False)
        stages: list[tuple[str, StagePlan]] = []
        reasons: list[Reason] = []
        if old is not None and old.partition != unit.partition:
            reasons.append("partition")
        while chain.at < self.stages:
            stage = self.pipeline.stages[chain.at]
            if not set(stage.needs) <= set(self._shared.hashes):
                break  # its aggregate is not there yet
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
            stages += self._behind(unit, first, before, reasons)
        seconds, possible = self._costs(unit, row, stages)
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
            seconds=seconds,
            possible_seconds=possible,
        )

    def _committed(self, stage: str, key: StageKey) -> StageReceipt | None:
        self._probes += 1
        if self._listed is None and self._probes > PROBES and not self.commits.store.lists_cheaply:
            self._listed = frozenset(self.commits.committed())
        if self._listed is not None and (stage, key.hex) not in self._listed:
            return None
        found = self.commits.find(stage, key.hex, discard=False)
        return receipt_of(found, made=False) if found else None

    def _behind(
        self, unit: Unit, first: int, before: Mapping[str, StageReceipt], reasons: list[Reason]
    ) -> Iterator[tuple[str, StagePlan]]:
        """Yield (stage name, plan) for each stage from position ``first`` on. The stage at ``first`` is the first one
        that is not done, so it will run. A later stage may have to run if it reads tables of a stage that runs.
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
            if at == first or own:
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

    def _costs(self, unit: Unit, row: int, stages: list[tuple[str, StagePlan]]) -> tuple[float, float]:
        sums = {"certain": 0.0, "possible": 0.0}
        for name, plan in stages:
            if plan != "FRESH":
                expected = self._model.stage_seconds(unit, row, name)
                sums["possible" if plan == "POSSIBLE" else "certain"] += expected
        return sums["certain"], sums["possible"]

    def renamed(self, missing: Mapping[bytes, str]) -> tuple[tuple[str, str], ...]:
        """Return (old id, new id) of each unit that was renamed: the old id is published but no longer in the corpus,
        and an unpublished unit in ``missing`` has the same bytes.

        missing : hash of the content → unit id
        """
        if not missing or "content" not in self.index.rows.schema.names:
            return ()
        return tuple(
            (row["unit_id"], missing[row["content"]])
            for row in self._gone("unit_id", "content")
            if row["content"] in missing
        )

    def removed(self) -> tuple[str, ...]:
        """Return the ids of published units that were not among the compared units."""
        return tuple(row["unit_id"] for row in self._gone("unit_id"))

    def _gone(self, *columns: str) -> Iterator[dict[str, Any]]:
        for start, batch in batches(self.index.rows, columns):
            yield from batch.filter(pa.array(~self.present[start : start + batch.num_rows])).to_pylist()


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
