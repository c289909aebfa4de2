"""Snapshots: immutable folders of Parquet files. A snapshot is named by the hash of its rows, and published by moving a
ref.

``snapshots/<id>/<table>/source=<partition>/part-<bucket>.parquet``, then ``manifest.json``, then the unit index, then
``refs/<name>.json``. Until the ref moves, readers see the previous snapshot; a snapshot without manifest is none.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from factory.commits import REBUILD_VERIFIED, Commits
from factory.index import Index
from factory.packing import Members, PackJob, bucket_count, buckets, content_of, hash_members, size
from factory.pipeline import Pipeline, plain_name
from factory.receipt import StageReceipt
from factory.rows import parquet_table, schema_hash
from factory.scratch import BatchedTable, batches
from factory.seal import unsealed
from factory.stage import Stage
from factory.store import Store, token_of
from schemas.canonical import JSON, digest
from schemas.errors import CorruptShardError, StoreError, UsageError
from schemas.snapshot import (
    PartitionRecord,
    PartRecord,
    Ref,
    SharedRecord,
    SnapshotManifest,
    StageTotals,
    TableManifest,
)

__all__ = ["Composition", "Snapshot", "damaged_parts", "read_manifest", "read_ref"]


@dataclass(frozen=True)
class Composition:
    """The content of a snapshot, known from the index alone, before any file of it is written.

    sizes : for each (table, partition) the canonical bytes of all rows
    hashes : for each (table, partition) the hash over all rows
    """

    pipeline: Pipeline
    index: BatchedTable
    sizes: Mapping[tuple[str, str], int]
    hashes: Mapping[tuple[str, str], str]
    snapshot_id: str

    @classmethod
    def of(cls, pipeline: Pipeline, index: BatchedTable) -> Composition:
        """Compose a snapshot of ``pipeline`` from a unit index that is sorted by unit id."""
        states: dict[str, dict[str, Any]] = {name: {} for name in sorted(pipeline.tables)}
        sizes: Counter[tuple[str, str]] = Counter()
        for batch, here, partition in _partitions(index, index.schema.names):
            for name, known in states.items():
                members = _members(batch, here, name, pipeline.tables[name].stages)
                hash_members(known.setdefault(partition, hashlib.sha256()), members)
                sizes[name, partition] += size(members)
        hashes: dict[tuple[str, str], str] = {}
        document: dict[str, JSON] = {}
        for name, known in states.items():
            spec = pipeline.tables[name]
            sums: dict[str, JSON] = {}
            for partition in sorted(known):
                hashes[name, partition] = sums[partition] = known[partition].hexdigest()[:32]
            document[name] = {"schema": schema_hash(spec.schema), "sort": list(spec.sort_keys), "partitions": sums}
        snapshot_id = digest({"pipeline": pipeline.name, "tables": document})[:32]
        return cls(pipeline, index, sizes, hashes, snapshot_id)

    def bucket_count(self, table: str, partition: str, part_bytes: int) -> int:
        """Return into how many files the rows of one table and partition are divided."""
        return bucket_count(self.sizes[table, partition], part_bytes)

    def jobs(self, part_bytes: int) -> Iterator[PackJob]:
        """Return the pack jobs for the files of the snapshot."""
        for table, partition in self.hashes:
            spec = self.pipeline.tables[table]
            members = Members(partial(self._members, table, partition))
            for bucket, share in buckets(members, self.bucket_count(table, partition, part_bytes)):
                path = f"snapshots/{self.snapshot_id}/{table}/source={partition}/part-{bucket:05d}.parquet"
                content, whole = content_of(spec, share)
                yield PackJob(table, partition, bucket, path, content, share, whole)

    def _members(self, table: str, partition: str) -> Iterator[pa.Table]:
        stages = self.pipeline.tables[table].stages
        columns = ["unit_id", "partition", "status", *(f"{stage}.key" for stage in stages)]
        columns += [f"{stage}/{table}.{what}" for stage in stages for what in ("rows", "hash", "bytes")]
        for batch, here, found in _partitions(self.index, columns):
            if found == partition:
                yield _members(batch, here, table, stages)

    def manifest(
        self,
        parts: Mapping[tuple[str, str], list[PartRecord]],
        aggregates: Mapping[str, str],
        shared: Mapping[str, SharedRecord],
        provenance: Mapping[str, str],
    ) -> SnapshotManifest:
        """Return the manifest. Call this when all parts are written."""
        tables = {}
        for name, spec in sorted(self.pipeline.tables.items()):
            partitions = {
                partition: PartitionRecord(
                    rows=sum(part.rows for part in found),
                    logical_hash=self.hashes[table, partition],
                    parts=sorted(found, key=lambda part: part.path),
                )
                for (table, partition), found in sorted(parts.items())
                if table == name
            }
            tables[name] = TableManifest(
                stages=list(spec.stages),
                columns=spec.schema.names,
                sort_keys=list(spec.sort_keys),
                rows=sum(partition.rows for partition in partitions.values()),
                partitions=partitions,
            )
        status: Counter[str] = Counter()
        sums: dict[str, Counter[str]] = {stage.name: Counter() for stage in self.pipeline.stages}
        for _, batch in batches(self.index):
            counted = pc.value_counts(batch.column("status")).to_pylist()
            status.update({item["values"]: item["counts"] for item in counted})
            for stage in self.pipeline.stages:
                _add(sums[stage.name], batch, stage)
        return SnapshotManifest(
            snapshot_id=self.snapshot_id,
            pipeline=self.pipeline.name,
            tables=tables,
            units=dict(status),
            aggregates=dict(aggregates),
            shared=dict(shared),
            stages={stage.name: _totals(stage, sums[stage.name]) for stage in self.pipeline.stages},
            provenance=dict(provenance),
        )


def _add(sums: Counter[str], batch: pa.RecordBatch, stage: Stage) -> None:
    """Add what a batch of an index says of a stage."""

    def total(name: str) -> Any:
        return pc.sum(batch.column(f"{stage.name}{name}")).as_py() or 0

    sums["units"] += pc.count(batch.column(f"{stage.name}.key")).as_py()
    sums["skipped"] += total(".skipped")
    sums["seconds"] += total(".seconds")
    sums["peak_rss"] = max(sums["peak_rss"], pc.max(batch.column(f"{stage.name}.peak_rss")).as_py() or 0)
    sums["rows"] += sum(total(f"/{table}.rows") for table in stage.tables)
    sums["bytes"] += sum(total(f"/{table}.bytes") for table in stage.tables)


def _totals(stage: Stage, sums: Counter[str]) -> StageTotals:
    return StageTotals(
        version=stage.version,
        units=sums["units"],
        skipped=sums["skipped"],
        seconds=round(float(sums["seconds"]), 3),
        peak_rss=sums["peak_rss"],
        rows=sums["rows"],
        bytes=sums["bytes"],
    )


def _partitions(index: BatchedTable, columns: Sequence[str]) -> Iterator[tuple[pa.Table, pa.Array, str]]:
    """Go through an index; yield (some rows, mask of those that are of a partition and not quarantined, partition)."""
    for _, batch in batches(index, columns):
        done = pc.not_equal(batch.column("status"), "quarantined")
        for partition in pc.unique(batch.column("partition").filter(done)).to_pylist():
            yield pa.table(batch), pc.and_(done, pc.equal(batch.column("partition"), partition)), partition


def _members(index: pa.Table, here: pa.Array, table: str, stages: tuple[str, ...]) -> pa.Table:
    """Return one row for each pair of a unit and a stage that wrote rows of ``table``. The units are those that the
    mask ``here`` selects; the rows are sorted by unit id, then by the order of ``stages``.
    """
    parts = []
    for order, stage in enumerate(stages):
        prefix = f"{stage}/{table}"
        rows = pc.fill_null(pc.greater(index.column(f"{prefix}.rows"), 0), False)
        names = ["unit_id", f"{stage}.key", f"{prefix}.hash", f"{prefix}.bytes"]
        there = index.select(names).filter(pc.and_(here, rows))
        columns = {
            "unit_id": there.column("unit_id"),
            "stage": pa.repeat(pa.scalar(stage), there.num_rows),
            "key": there.column(f"{stage}.key"),
            "hash": there.column(f"{prefix}.hash"),
            "bytes": there.column(f"{prefix}.bytes"),
            "order": pa.repeat(pa.scalar(order, pa.int8()), there.num_rows),
        }
        parts.append(pa.table(columns))
    whole = pa.concat_tables(parts)
    if len(parts) > 1:
        whole = whole.sort_by([("unit_id", "ascending"), ("order", "ascending")])
    return whole.drop_columns(["order"])


def read_ref(store: Store, name: str) -> tuple[Ref | None, str | None]:
    """Return (the ref, its token for ``Store.swap``); (None, None) if it was never published."""
    path = ref_path(name)
    try:
        data = store.read(path)
    except FileNotFoundError:
        return None, None
    try:
        return unsealed(Ref, data), token_of(data)
    except ValueError as error:
        raise CorruptShardError(
            f"the ref is damaged: {_first_line(error)}",
            where=f"{store.url}/{path}",
            remedy="Remove the file and run condvln generate CONFIG: what is committed is published again.",
        ) from error


def _repeated(text: str, count: int) -> pa.Array:
    """Return an array of one text `count` times. To convert Python's objects, pyarrow would import pandas."""
    data = text.encode()
    offsets = np.arange(count + 1, dtype=np.int32) * len(data)
    return pa.Array.from_buffers(pa.string(), count, [None, pa.py_buffer(offsets), pa.py_buffer(data * count)])


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def ref_path(name: str) -> str:
    """Return the path of a ref. Raises ``UsageError`` if ``name`` is not a plain file name."""
    if not plain_name(name):
        raise UsageError(f"{name!r} is not a valid name of a ref", remedy="Use letters, digits, '-', '_' and '.'.")
    return f"refs/{name}.json"


def manifest_path(snapshot_id: str) -> str:
    """Return the path of a snapshot's manifest."""
    return f"snapshots/{snapshot_id}/manifest.json"


def read_manifest(store: Store, snapshot_id: str) -> SnapshotManifest | None:
    """Read the manifest of a snapshot; None when there is none (the snapshot was never finished, or is damaged)."""
    try:
        manifest = unsealed(SnapshotManifest, store.read(manifest_path(snapshot_id)))
    except (FileNotFoundError, ValueError):
        return None
    return manifest if manifest.snapshot_id == snapshot_id else None


def damaged_parts(store: Store, snapshot_id: str) -> Iterator[str]:
    """Yield the paths of a snapshot's files that are missing or differ from the manifest. This reads every file of the
    snapshot.
    """
    manifest = read_manifest(store, snapshot_id)
    if manifest is None:
        return
    for file in manifest.files():
        path = f"snapshots/{snapshot_id}/{file.path}"
        try:
            data = store.read(path)
        except FileNotFoundError:
            data = b""
        if hashlib.sha256(data).hexdigest() != file.sha256:
            yield path


@dataclass(frozen=True)
class Snapshot:
    """A published snapshot, for readers."""

    store: Store
    manifest: SnapshotManifest
    index_hash: str

    @classmethod
    def open(cls, store: Store, ref: str = "main") -> Snapshot:
        """Open the snapshot that ``ref`` names now. Raises ``StoreError`` when nothing was published under it."""
        found, _ = read_ref(store, ref)
        if found is None:
            raise StoreError(
                f"nothing is published as {ref!r}",
                where=f"{store.url}/{ref_path(ref)}",
                remedy="Run condvln generate CONFIG first.",
            )
        manifest = read_manifest(store, found.snapshot_id)
        if manifest is None:
            raise CorruptShardError(
                "the manifest of the published snapshot is missing or damaged",
                where=f"{store.url}/{manifest_path(found.snapshot_id)}",
                remedy="Run condvln rebuild CONFIG, which writes the manifest again.",
            )
        return cls(store, manifest, found.index)

    @property
    def snapshot_id(self) -> str:
        """Return the id: a hash over the logical hashes of all rows."""
        return self.manifest.snapshot_id

    def paths(self, table: str) -> tuple[str, ...]:
        """Return the paths of a table's files, relative to the store. Raises ``UsageError`` on an unknown table."""
        if table not in self.manifest.tables:
            raise UsageError(
                f"there is no table {table!r}", remedy=f"Choose one of: {', '.join(self.manifest.tables)}."
            )
        partitions = self.manifest.tables[table].partitions
        return tuple(
            f"snapshots/{self.snapshot_id}/{part.path}"
            for name in sorted(partitions)
            for part in partitions[name].parts
        )

    def local_paths(self, table: str) -> tuple[Path, ...]:
        """Return the paths of a table's files on this machine's disk. Raises ``StoreError`` for a store that is not on
        this disk.
        """
        found = tuple(self.store.local_path(path) for path in self.paths(table))
        local = tuple(path for path in found if path is not None)
        if len(local) != len(found):
            raise StoreError("the files are not on this machine's disk", where=self.store.url)
        return local

    def table(
        self,
        name: str,
        columns: list[str] | None = None,
        partition: str | None = None,
        narrowed: Callable[[pa.Table], pa.Table] = lambda rows: rows,
    ) -> pa.Table:
        """Read rows of a table, with the partition as the last column ``source``.

        narrowed : returns what is kept of the rows of a file, so that not all rows of a large table are in memory

        Raises ``CorruptShardError`` when a file differs from the manifest.
        """
        tables = []
        for source, record in sorted(self.manifest.tables[name].partitions.items()):
            if partition is not None and source != partition:
                continue
            for part in record.parts:
                path = f"snapshots/{self.snapshot_id}/{part.path}"
                where = f"{self.store.url}/{path}"
                try:
                    data = self.store.read(path)
                except FileNotFoundError as error:
                    raise CorruptShardError(
                        "a published file is missing", where=where, remedy=REBUILD_VERIFIED
                    ) from error
                if hashlib.sha256(data).hexdigest() != part.sha256:
                    raise CorruptShardError("the file differs from the manifest", where=where, remedy=REBUILD_VERIFIED)
                rows = narrowed(parquet_table(data, where, columns))
                tables.append(rows.append_column("source", _repeated(source, rows.num_rows)))
        return pa.concat_tables(tables) if tables else pa.table({})

    def index(self) -> Index:
        """Return the unit index that this snapshot was published from."""
        return Index.read(self.store, self.index_hash)

    def unit_files(self, unit_id: str, pipeline: Pipeline) -> dict[str, bytes]:
        """Return the names and content of files that a unit's stages kept. Raises ``UsageError`` on an unknown unit."""
        commits = Commits(self.store)
        found = {}
        for stage in self._stages(unit_id, pipeline):
            committed = commits.find(stage.stage, stage.key.hex(), discard=False)
            if committed is not None:
                commit = committed.commit
                found.update({name: commits.file(commit, name) for name in commit.files})
        return found

    def unit_table(self, unit_id: str, pipeline: Pipeline, name: str) -> pa.Table:
        """Read a table that a stage of a unit keeps but the snapshot does not publish. The result has no rows if the
        stage did not run.

        Raises ``UsageError`` on an unknown unit, ``CorruptShardError`` where the table is damaged or was swept away.
        """
        commits = Commits(self.store)
        stage_of = {table: stage.name for stage in pipeline.stages for table in stage.tables}
        for stage in self._stages(unit_id, pipeline):
            if stage.stage == stage_of[name]:
                rows_hash = next((table.hash.hex() for table in stage.tables if table.table == name), None)
                return commits.table(stage.stage, stage.key.hex(), name, rows_hash)
        return pa.table({})

    def _stages(self, unit_id: str, pipeline: Pipeline) -> tuple[StageReceipt, ...]:
        row = int(self._index.rows_of([unit_id])[0])
        if row < 0:
            raise UsageError(f"no unit {unit_id!r} is published")
        return self._index.receipt(row, pipeline).stages

    @cached_property
    def _index(self) -> Index:
        return self.index()
