"""Aggregates: tables over all units, each built once after a first pass over the units, and then pinned by hash for a
ref.

The pin is one small file, ``pins/<pipeline>/<ref>.json``, replaced atomically; the tables are named by their hash,
``aggregates/<name>/<hash>.parquet``. A run that is killed before the pin is written builds the same table again from
the same units; one killed after it finds the pin.
"""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial

import pyarrow as pa

from factory.chain import SharedTables, Upstream
from factory.commits import Commits, sealed, unsealed
from factory.receipt import Receipt
from factory.rows import logical_hash, parquet_bytes, parquet_table
from factory.stage import Aggregate
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
        published: SnapshotManifest | None = None,
    ) -> None:
        self._aggregates = aggregates
        self._commits = commits
        self._path = f"pins/{pipeline}/{ref}.json"
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
        pin, written = None, True
        try:
            pin = unsealed(Pin, store.read(self._path))
        except FileNotFoundError:
            written = False
        except ValueError:
            pass
        tables = {} if pin is None else dict(pin.tables)
        for name, record in kept.items():
            known = tables.get(name)
            if known is None or known.generation < record.generation:
                tables[name] = PinnedTable(**record.model_dump(include=set(PinnedTable.model_fields)))
        if pin is not None and tables == pin.tables:
            return pin
        if kept or written:
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
                    remedy="Restore the file, or run condvln generate CONFIG --priors, which builds it from the "
                    "present units and rebuilds what depends on it.",
                )
            self._commits.store.write(path, parquet_bytes(table))
            return found
        self._commits.store.write(path, parquet_bytes(table))
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

    with _temporary_space():
        table = aggregate.build(counted())
    return table.replace_schema_metadata(None).combine_chunks(), count


@contextmanager
def _temporary_space() -> Iterator[None]:
    """Context in which an aggregate may write temporary files. Raises ``StoreError``, which names their folder, when
    there is no space left for them: the store may well have some.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise StoreError(
            "no space left for temporary files",
            where=tempfile.gettempdir(),
            remedy="Free some space there, or set TMPDIR to another folder; what was committed stays.",
        ) from error


def discard_damaged(aggregate: Aggregate, commits: Commits, receipts: Iterable[Receipt]) -> None:
    """Remove every commit whose tables for ``aggregate`` are damaged, so that another pass rebuilds them all."""
    for _, tables in _tables(aggregate, commits, receipts):
        for name in aggregate.tables:
            with suppress(CorruptShardError):
                tables[name]


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
        read = partial(_table, commits, stage.stage, key)
        yield receipt.unit_id, Upstream({name: partial(read, name, hashes[name]) for name in aggregate.tables})


def _table(commits: Commits, stage: str, key: str, name: str, rows_hash: str) -> pa.Table:
    try:
        return commits.table(stage, key, name, rows_hash)
    except CorruptShardError:
        commits.discard(stage, key)
        raise
