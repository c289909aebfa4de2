"""Aggregates: tables over all units, built once when a first pass is complete, and then pinned by hash for a ref.

The pin is one small file, ``pins/<pipeline>/<ref>.json``, replaced atomically; the tables are named by their hash,
``aggregates/<name>/<hash>.parquet``. A run that is killed before the pin is written builds the same table again from
the same units; one killed after it finds the pin.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import pyarrow as pa
from pydantic import ValidationError

from factory.chain import SharedTables, Upstream
from factory.commits import Commits
from factory.faults import FaultPlan
from factory.pipeline import Pipeline
from factory.receipt import Receipt
from factory.rows import logical_hash, parquet_bytes
from factory.stage import Aggregate
from schemas.canonical import digest
from schemas.errors import CorruptShardError
from schemas.snapshot import Pin, PinnedTable

__all__ = ["Pins", "build_aggregate", "discard_damaged"]


class Pins:
    """The pinned aggregates of one pipeline and ref."""

    def __init__(self, pipeline: Pipeline, commits: Commits, ref: str, faults: FaultPlan | None = None) -> None:
        self._pipeline = pipeline
        self._commits = commits
        self._path = f"pins/{pipeline.name}/{ref}.json"
        self._faults = faults or FaultPlan()
        self.pin = self._read()

    def _read(self) -> Pin:
        try:
            return Pin.model_validate_json(self._commits.store.read(self._path))
        except (FileNotFoundError, ValidationError):
            return Pin(tables={})

    def hashes(self, renew: Iterable[str] = ()) -> dict[str, str]:
        """Hashes of the aggregates that hold: pinned under this version and these parameters, not to be renewed, and
        still there."""
        found = {}
        for aggregate in self._pipeline.aggregates:
            pinned = self.pin.tables.get(aggregate.name)
            if pinned is None or pinned.version != aggregate.version or aggregate.name in renew:
                continue
            if pinned.parameters != digest(aggregate.parameters()):
                continue
            if self._commits.store.exists(SharedTables.path(aggregate.name, pinned.hash)):
                found[aggregate.name] = pinned.hash
        return found

    def set(self, aggregate: Aggregate, table: pa.Table, units: int) -> str:
        """Keep ``table`` and pin it; returns its hash."""
        found, _ = logical_hash(table)
        self._faults.reach("pin-before-table")
        # Not create(): one of this name that is damaged must not stay.
        self._commits.store.write(SharedTables.path(aggregate.name, found), parquet_bytes(table))
        self._faults.reach("pin-before-pin")
        pinned = PinnedTable(
            version=aggregate.version,
            hash=found,
            rows=table.num_rows,
            units=units,
            parameters=digest(aggregate.parameters()),
        )
        self.pin = Pin(tables={**self.pin.tables, aggregate.name: pinned})
        self._commits.store.write(self._path, self.pin.model_dump_json(indent=1).encode())
        self._faults.reach("pin-after-pin")
        return found


def build_aggregate(aggregate: Aggregate, commits: Commits, receipts: Iterable[Receipt]) -> tuple[pa.Table, int]:
    """(table, number of units) of ``aggregate`` over units in the order of their ids.

    A unit counts when the stage was made for it and it has not failed. Raises ``CorruptShardError`` when a unit's
    committed table is damaged; it is removed, and making that unit again helps.
    """
    count = 0

    def counted() -> Iterator[tuple[str, Mapping[str, pa.Table]]]:
        nonlocal count
        for found in _tables(aggregate, commits, receipts):
            count += 1
            yield found

    table = aggregate.build(counted())
    return table.replace_schema_metadata(None).combine_chunks(), count


def discard_damaged(aggregate: Aggregate, commits: Commits, receipts: Iterable[Receipt]) -> int:
    """Remove every commit that ``aggregate`` could not read, so that one more pass makes all of them; how many."""
    damaged = 0
    for _, tables in _tables(aggregate, commits, receipts):
        try:
            for name in aggregate.tables:
                tables[name]
        except CorruptShardError:
            damaged += 1
    return damaged


def _tables(
    aggregate: Aggregate, commits: Commits, receipts: Iterable[Receipt]
) -> Iterator[tuple[str, Mapping[str, pa.Table]]]:
    """(unit id, the tables that ``aggregate`` reads, each read when asked for) of all units that count."""
    for receipt in receipts:
        stage = next((s for s in receipt.stages if s.stage == aggregate.after and not s.skipped), None)
        if stage is None:
            continue
        key = stage.key.hex()
        hashes = {table.table: table.hash.hex() for table in stage.tables}
        loaders = {name: _loader(commits, stage.stage, key, name, hashes[name]) for name in aggregate.tables}
        yield receipt.unit_id, Upstream(loaders)


def _loader(commits: Commits, stage: str, key: str, name: str, rows_hash: str):  # type: ignore[no-untyped-def]
    def load() -> pa.Table:
        try:
            return commits.table(stage, key, name, rows_hash)
        except CorruptShardError:
            commits.discard(stage, key)
            raise

    return load
