"""Snapshots: immutable folders of Parquet files. A snapshot is named by the hash of its rows, and published by moving a
ref.

``snapshots/<id>/<table>/source=<partition>/part-<bucket>.parquet``, then ``manifest.json``, then the unit index, then
``refs/<name>.json``. Until the ref moves, readers see the previous snapshot; a snapshot without manifest is none.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from factory.commits import Commits, unsealed, verified
from factory.files import FileHashes
from factory.index import Index
from factory.packing import PackJob, bucket_count, buckets, content_of, hash_members, size
from factory.pipeline import Pipeline, plain_name
from factory.receipt import StageReceipt
from factory.rows import parquet_table, schema_hash
from factory.stage import Stage
from factory.store import LocalStore, Store, token_of
from schemas.canonical import JSON, digest
from schemas.errors import CorruptShardError, MissingFileError, StoreError, UsageError
from schemas.snapshot import (
    STORE_VERSION,
    PartitionRecord,
    PartRecord,
    Ref,
    SharedRecord,
    SnapshotManifest,
    StageTotals,
    TableManifest,
)

__all__ = ["COPIES_KEPT", "Composition", "Snapshot", "damaged_parts", "local_copy", "read_manifest", "read_ref"]


@dataclass(frozen=True)
class Composition:
    """The content of a snapshot, known from the index alone, before any file of it is written.

    members : for each (table, partition) the units and stages whose rows belong there, see ``PackJob``
    hashes : for each (table, partition) the hash over all rows
    """

    pipeline: Pipeline
    index: Index
    members: Mapping[tuple[str, str], pa.Table]
    hashes: Mapping[tuple[str, str], str]
    snapshot_id: str

    @classmethod
    def of(cls, pipeline: Pipeline, index: Index) -> Composition:
        """Compose a snapshot of ``pipeline`` from a unit index."""
        done = index.table.filter(pc.not_equal(index.table.column("status"), "quarantined"))
        members: dict[tuple[str, str], pa.Table] = {}
        for partition in sorted(pc.unique(done.column("partition")).to_pylist()):
            units = done.filter(pc.equal(done.column("partition"), partition))
            for name in pipeline.tables:
                members[name, partition] = _members(units, name, pipeline.writers(name))
        hashes = {}
        document: dict[str, JSON] = {}
        for name, spec in sorted(pipeline.tables.items()):
            sums: dict[str, JSON] = {}
            for (table, partition), found in members.items():
                if table == name:
                    state = hashlib.sha256()
                    hash_members(state, found)
                    hashes[name, partition] = sums[partition] = state.hexdigest()[:32]
            document[name] = {"schema": schema_hash(spec.schema), "sort": list(spec.sort_keys), "partitions": sums}
        snapshot_id = digest({"pipeline": pipeline.name, "tables": document})[:32]
        return cls(pipeline, index, members, hashes, snapshot_id)

    def jobs(self, part_bytes: int) -> Iterator[PackJob]:
        """Return the pack jobs for the files of the snapshot."""
        for table, partition in self.hashes:
            spec = self.pipeline.tables[table]
            whole = self.members[table, partition]
            for bucket, share in buckets(whole, bucket_count(size(whole), part_bytes)):
                path = f"snapshots/{self.snapshot_id}/{table}/source={partition}/part-{bucket:05d}.parquet"
                yield PackJob(table, partition, bucket, path, content_of(spec, share), share, size(share))

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
                stages=self.pipeline.writers(name),
                columns=spec.schema.names,
                sort_keys=list(spec.sort_keys),
                rows=sum(partition.rows for partition in partitions.values()),
                partitions=partitions,
            )
        counted = pc.value_counts(self.index.table.column("status")).to_pylist()
        return SnapshotManifest(
            snapshot_id=self.snapshot_id,
            pipeline=self.pipeline.name,
            tables=tables,
            units={item["values"]: item["counts"] for item in counted},
            aggregates=dict(aggregates),
            shared=dict(shared),
            stages={stage.name: _totals(stage, self.index.table) for stage in self.pipeline.stages},
            provenance=dict(provenance),
        )


def _totals(stage: Stage, index: pa.Table) -> StageTotals:
    """Sum what an index says of a stage."""

    def total(name: str) -> Any:
        return pc.sum(index.column(f"{stage.name}{name}")).as_py() or 0

    return StageTotals(
        version=stage.version,
        units=pc.count(index.column(f"{stage.name}.key")).as_py(),
        skipped=total(".skipped"),
        seconds=round(float(total(".seconds")), 3),
        peak_rss=pc.max(index.column(f"{stage.name}.peak_rss")).as_py() or 0,
        rows=sum(total(f"/{table}.rows") for table in stage.tables),
        bytes=sum(total(f"/{table}.bytes") for table in stage.tables),
    )


def _members(units: pa.Table, table: str, stages: Sequence[str]) -> pa.Table:
    """Return one row for each pair of a unit of an index and a stage that wrote rows of ``table``, sorted by unit id,
    then by the order of ``stages``.
    """
    parts = []
    for order, stage in enumerate(stages):
        prefix = f"{stage}/{table}"
        there = units.filter(pc.fill_null(pc.greater(units.column(f"{prefix}.rows"), 0), False))
        columns = {
            "unit_id": there.column("unit_id"),
            "stage": pa.repeat(pa.scalar(stage), there.num_rows),
            "key": there.column(f"{stage}.key"),
            "hash": there.column(f"{prefix}.hash"),
            "bytes": there.column(f"{prefix}.bytes"),
            "order": pa.repeat(pa.scalar(order, pa.int8()), there.num_rows),
        }
        parts.append(pa.table(columns))
    whole = pa.concat_tables(parts).sort_by([("unit_id", "ascending"), ("order", "ascending")])
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
        where = f"{store.url}/{path}"
        with suppress(ValueError, AttributeError):
            if json.loads(data).get("store_version", 1) != STORE_VERSION:
                raise StoreError(
                    "this store was written by another release of CondVLN, whose files this one does not read",
                    where=where,
                    remedy="Remove the store, or name another one in the configuration, and run condvln generate "
                    "CONFIG again.",
                ) from error
        raise CorruptShardError(
            f"the ref is damaged: {next(iter(str(error).splitlines()), '')}",
            where=where,
            remedy="Remove the file and run condvln generate CONFIG: what is committed is published again.",
        ) from error


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
            verified(store, path, file.sha256)
        except CorruptShardError:
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
                remedy="Run condvln generate CONFIG, which writes the manifest again.",
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

    def table(
        self,
        name: str,
        columns: list[str] | None = None,
        partition: str | None = None,
        narrowed: Callable[[pa.Table], pa.Table] = lambda rows: rows,
    ) -> pa.Table:
        """Read rows of a table, with the partition as the last column ``source``.

        narrowed : returns what is kept of the rows of a file, so that not all rows of a large table are in memory

        Raises ``CorruptShardError`` when a file is missing or differs from the manifest.
        """
        tables = []
        for source, record in sorted(self.manifest.tables[name].partitions.items()):
            if partition is not None and source != partition:
                continue
            for part in record.parts:
                path = f"snapshots/{self.snapshot_id}/{part.path}"
                data = verified(self.store, path, part.sha256)
                rows = narrowed(parquet_table(data, f"{self.store.url}/{path}", columns))
                tables.append(rows.append_column("source", pa.repeat(pa.scalar(source), rows.num_rows)))
        return pa.concat_tables(tables) if tables else pa.table({})

    @cached_property
    def index(self) -> Index:
        """The unit index that this snapshot was published from."""
        return Index.read(self.store, self.index_hash)

    def unit_files(self, unit_id: str, pipeline: Pipeline) -> dict[str, bytes]:
        """Return the names and content of files that a unit's stages kept.

        Raises ``UsageError`` on an unknown unit, ``CorruptShardError`` where one is damaged or was swept away.
        """
        commits = Commits(self.store)
        found = {}
        for stage in self._stages(unit_id, pipeline):
            commit = commits.commit(stage.stage, stage.key.hex())
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
        row = self.index.row_of(unit_id)
        if row < 0:
            raise UsageError(f"no unit {unit_id!r} is published")
        return self.index.receipt(row, pipeline).stages


FETCHERS: Final = 4
"""Number of files that are fetched at once: each may take some tens of megabytes of memory."""

COPIES_KEPT: Final = 3
"""Number of copies of snapshots that are kept, the requested one included. Others are removed after a day without
use."""

IDLE_SECONDS: Final = 24 * 3600.0


def local_copy(
    snapshot: Snapshot, cache: Path, tables: Iterable[str] | None = None, hashes: FileHashes | None = None
) -> Path:
    """Return the folder of ``snapshot`` on this disk, with ``<table>/source=<partition>/part-*.parquet`` below it.

    cache : where copies of snapshots stand, in ``snapshots/<id>``; not touched when the store itself is on this disk
    tables : those that are needed; all by default
    hashes : memory of the files' hashes; without one every file is read

    Raises ``CorruptShardError`` when a file is missing or differs from the manifest.
    """
    hashes = hashes or FileHashes()
    manifest = snapshot.manifest
    wanted = manifest.tables if tables is None else [name for name in manifest.tables if name in set(tables)]
    parts = [
        part for name in wanted for partition in manifest.tables[name].partitions.values() for part in partition.parts
    ]
    folder = f"snapshots/{snapshot.snapshot_id}"
    own = snapshot.store.local_path(folder)
    copies = LocalStore(cache if own is None else own.parents[1], durable=False)

    def check(part: PartRecord) -> None:
        path = f"{folder}/{part.path}"
        copies.local_path(path)  # a manifest's path that leads out of the folder ends here
        with suppress(MissingFileError):
            if hashes.file(copies.root, path).sha256 == part.sha256:
                return
        data = verified(snapshot.store, path, part.sha256)
        if own is None:
            copies.write(path, data)

    with ThreadPoolExecutor(FETCHERS) as pool:
        for _ in pool.map(check, parts):
            pass
    hashes.save()
    if own is not None:
        return own
    copies.write(f"{folder}/manifest.json", manifest.model_dump_json(indent=1).encode())
    _forget(cache / "snapshots", snapshot.snapshot_id)
    return cache / folder


def _forget(folder: Path, used: str) -> None:
    """Remove copies of snapshots that were not used recently."""

    def last_use(copy: Path) -> float:
        try:
            return (copy / "manifest.json").stat().st_mtime
        except OSError:
            return 0.0

    others = sorted((copy for copy in folder.iterdir() if copy.name != used), key=last_use, reverse=True)
    for copy in others[COPIES_KEPT - 1 :]:
        if time.time() - max(last_use(copy), os.stat(copy).st_mtime) > IDLE_SECONDS:
            shutil.rmtree(copy, ignore_errors=True)
