"""Aggregates: tables over all units, each built once after a first pass over the units, and then pinned by hash for a
ref.

The pin is one small file, ``pins/<pipeline>/<ref>.json``, replaced atomically; the tables are named by their hash,
``aggregates/<name>/<hash>.parquet``. A run that is killed before the pin is written builds the same table again from
the same units; one killed after it finds the pin.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress

import pyarrow as pa

from factory.chain import SharedTables, Upstream
from factory.commits import Commits
from factory.faults import FaultPlan
from factory.receipt import Receipt
from factory.rows import logical_hash, parquet_bytes, parquet_table
from factory.seal import sealed, unsealed
from factory.stage import Aggregate
from factory.temporary import temporary_space
from schemas.canonical import digest
from schemas.errors import CorruptShardError, StoreError
from schemas.snapshot import Pin, PinnedTable, SnapshotManifest

__all__ = ["Pins", "build_aggregate", "discard_damaged"]


class Pins:
    """The pinned aggregates of one pipeline and ref.

    Neither a pin nor its table can be computed again once there are more units, so the published snapshot has a copy of
    both: what is missing, damaged or older than the snapshot's is restored from there.

    pipeline, aggregates : name of the pipeline, and what it pins
    published : manifest of what is published under the ref
    """

    def __init__(
        self,
        pipeline: str,
        aggregates: Sequence[Aggregate],
        commits: Commits,
        ref: str,
        faults: FaultPlan | None = None,
        published: SnapshotManifest | None = None,
    ) -> None:
        self._aggregates = aggregates
        self._commits = commits
        self._path = f"pins/{pipeline}/{ref}.json"
        self._faults = faults or FaultPlan()
        self._published = published
        self.damaged: list[str] = []
        """Paths of files that are missing or damaged, which ``restore`` writes again."""
        self.pin = self._read()

    def damaged_tables(self) -> list[str]:
        """Return the paths of pinned tables that are missing or damaged; reads all of them."""
        paths = {SharedTables.path(name, pinned.hash): pinned.hash for name, pinned in self.pin.tables.items()}
        return [path for path, rows_hash in paths.items() if not self._sound(path, rows_hash)]

    def _read(self) -> Pin:
        store = self._commits.store
        kept = {} if self._published is None else self._published.shared
        pin: Pin | None = None
        with suppress(FileNotFoundError, ValueError):
            pin = unsealed(Pin, store.read(self._path))
        tables = {} if pin is None else dict(pin.tables)
        for name, record in kept.items():
            known = tables.get(name)
            if known is None or known.generation < record.generation:
                tables[name] = PinnedTable(**record.model_dump(include=set(PinnedTable.model_fields)))
        if pin is not None and tables == pin.tables:
            return pin
        if kept or store.exists(self._path):
            self.damaged.append(self._path)
        return Pin(tables=tables)

    def hashes(self, renew: Iterable[str] = ()) -> dict[str, str]:
        """Return the hashes of the valid aggregates, by name. An aggregate is valid if it was pinned under its present
        version and parameters, is not listed in ``renew``, and has an undamaged table in the store or in the snapshot.
        """
        found = {}
        for aggregate in self._aggregates:
            pinned = self.pin.tables.get(aggregate.name)
            if pinned is None or not _holds(pinned, aggregate) or aggregate.name in renew:
                continue
            path = SharedTables.path(aggregate.name, pinned.hash)
            if self._sound(path, pinned.hash):
                found[aggregate.name] = pinned.hash
                continue
            if path not in self.damaged:
                self.damaged.append(path)
            if self._copy(aggregate.name, pinned.hash) is not None:
                found[aggregate.name] = pinned.hash
        return found

    def restore(self) -> list[str]:
        """Write the pin file and the tables of pinned aggregates again if they are missing or damaged and their content
        is known; return the paths of the written files.
        """
        written = []
        for path in self.damaged:
            if path == self._path:
                if self.pin.tables:
                    self._commits.store.write(path, sealed(self.pin))
                    written.append(path)
                continue
            _, name, file = path.split("/")
            copy = self._copy(name, file.removesuffix(".parquet"))
            if copy is not None:
                self._commits.store.write(path, copy)
                written.append(path)
        self.damaged = [path for path in self.damaged if path not in written]
        return written

    def _sound(self, path: str, rows_hash: str) -> bool:
        try:
            return logical_hash(parquet_table(self._commits.store.read(path), path))[0] == rows_hash
        except (FileNotFoundError, CorruptShardError):
            return False

    def _copy(self, name: str, rows_hash: str) -> bytes | None:
        """Return the bytes of the copy of the table ``name`` in the published snapshot; None if there is no undamaged
        copy with this hash.
        """
        record = None if self._published is None else self._published.shared.get(name)
        if self._published is None or record is None or record.hash != rows_hash:
            return None
        path = f"snapshots/{self._published.snapshot_id}/{record.path}"
        return self._commits.store.read(path) if self._sound(path, rows_hash) else None

    def set(self, aggregate: Aggregate, table: pa.Table, units: int, *, renew: bool = False) -> str:
        """Store ``table`` and pin it; return its hash.

        renew : another table than the pinned one is wanted

        Raises ``StoreError`` when the pinned table holds, is lost, differs from this one and was not to be renewed: all
        units that depend on it would change silently.
        """
        found, _ = logical_hash(table)
        before = self.pin.tables.get(aggregate.name)
        path = SharedTables.path(aggregate.name, found)
        if before is not None and _holds(before, aggregate) and not renew:
            if before.hash != found:
                raise StoreError(
                    f"the shared table {aggregate.name!r} is missing or damaged, here and in the published snapshot, "
                    "and a table built from the present units differs from it",
                    where=f"{self._commits.store.url}/{SharedTables.path(aggregate.name, before.hash)}",
                    remedy="Restore the file, or run condvln rebuild CONFIG --priors, which builds it from the present "
                    "units and rebuilds what depends on it.",
                )
            self._commits.store.write(path, parquet_bytes(table))
            return found
        self._faults.reach("pin-before-table")
        # Not create(): one of this name that is damaged must not stay.
        self._commits.store.write(path, parquet_bytes(table))
        self._faults.reach("pin-before-pin")
        pinned = PinnedTable(
            version=aggregate.version,
            hash=found,
            rows=table.num_rows,
            units=units,
            parameters=digest(aggregate.parameters()),
            generation=0 if before is None else before.generation + 1,
        )
        self.pin = Pin(tables={**self.pin.tables, aggregate.name: pinned})
        self._commits.store.write(self._path, sealed(self.pin))
        self._faults.reach("pin-after-pin")
        return found


def _holds(pinned: PinnedTable, aggregate: Aggregate) -> bool:
    """Whether a pinned table was built by the present version of ``aggregate``, with its present parameters."""
    return pinned.version == aggregate.version and pinned.parameters == digest(aggregate.parameters())


def build_aggregate(aggregate: Aggregate, commits: Commits, receipts: Iterable[Receipt]) -> tuple[pa.Table, int]:
    """Build ``aggregate`` over units in the order of their ids. Return (table, number of units).

    A unit counts when the stage was made for it and it has not failed. Raises ``CorruptShardError`` when a unit's
    committed table is damaged; it is removed, and making that unit again helps. Raises ``StoreError`` when there is no
    space left for temporary files.
    """
    count = 0

    def counted() -> Iterator[tuple[str, Mapping[str, pa.Table]]]:
        nonlocal count
        for found in _tables(aggregate, commits, receipts):
            count += 1
            yield found

    with temporary_space():
        table = aggregate.build(counted())
    return table.replace_schema_metadata(None).combine_chunks(), count


def discard_damaged(aggregate: Aggregate, commits: Commits, receipts: Iterable[Receipt]) -> int:
    """Remove every commit whose tables for ``aggregate`` are damaged, so that another pass rebuilds them all. Return
    the number of units affected.
    """
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
    """Yield (unit id, tables that ``aggregate`` reads) for each unit for which the stage ``aggregate.after`` is done
    and was not skipped. Each table is loaded when it is first read.
    """
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
