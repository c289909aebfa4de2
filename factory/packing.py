"""Packing: the rows of many units into few files.

The units of a partition are spread over 2^k buckets by the CRC of their id, k the smallest that keeps a bucket's share
below ``part_bytes``; so one changed unit rewrites one file of each table it changed in, and the same rows make the same
files whatever their history. Sizes are those of the canonical buffers, since file sizes depend on the writer's version.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from factory.commits import Commits
from factory.faults import FaultPlan
from factory.pipeline import Pipeline, TableSpec
from factory.rows import ROW_GROUP_ROWS, ZSTD_LEVEL, concatenated, parquet_bytes, schema_hash
from factory.store import Store
from schemas.canonical import digest
from schemas.errors import CorruptShardError
from schemas.snapshot import PartRecord

__all__ = [
    "PART_BYTES",
    "PackJob",
    "Packed",
    "bucket_count",
    "buckets",
    "content_hash",
    "in_threads",
    "members_hash",
    "pack",
]

PART_BYTES: Final = 128 * 1024 * 1024
"""Most canonical bytes of one part: a file of some 16-64 MB after zstd, packed within 1 GiB of memory."""

READERS: Final = 16
"""Number of requests to an object store at once while packing: each takes some tens of milliseconds and no CPU."""

_BATCH: Final = 8192


@dataclass(frozen=True, slots=True)
class PackJob:
    """A file of a published table that is to be written, and the rows that belong in the file.

    members : columns unit_id, stage, key, hash, bytes; one row for each unit and stage with rows in it, by unit id
    """

    table: str
    partition: str
    bucket: int
    path: str
    content: str
    members: pa.Table

    @property
    def logical_bytes(self) -> int:
        """Return the total number of canonical bytes of all members."""
        return int(pc.sum(self.members.column("bytes")).as_py() or 0)


@dataclass(frozen=True, slots=True)
class Packed:
    """Result of a ``PackJob``: the file written, or the units whose damaged files were removed."""

    table: str
    partition: str
    part: PartRecord | None
    damaged: tuple[str, ...] = ()


def buckets(members: pa.Table, part_bytes: int) -> Iterator[tuple[int, pa.Table]]:
    """Divide the ``members`` of one table and partition into buckets; yield (number, members) of each bucket that is
    not empty. If there are no rows at all, yield one empty bucket.
    """
    count = bucket_count(members, part_bytes)
    if count == 1:
        yield 0, members
        return
    numbers = np.fromiter(
        (zlib.crc32(unit_id.encode()) % count for (unit_id,) in _rows(members, "unit_id")), np.int64, members.num_rows
    )
    order = np.argsort(numbers, kind="stable")
    starts = np.searchsorted(numbers[order], np.arange(count + 1))
    for bucket in range(count):
        share = order[starts[bucket] : starts[bucket + 1]]
        if len(share):
            yield bucket, members.take(pa.array(share))


def bucket_count(members: pa.Table, part_bytes: int) -> int:
    """Return the number of buckets, a power of two, into which the rows of one table and partition are divided."""
    whole = int(pc.sum(members.column("bytes")).as_py() or 0)
    count = 1
    while count * part_bytes < whole:
        count *= 2
    return count


def _rows(members: pa.Table, *names: str) -> Iterator[tuple[Any, ...]]:
    """Yield the values of the named columns, row by row. Only a batch of rows at a time is converted to objects."""
    for batch in members.select(list(names)).to_batches(max_chunksize=_BATCH):
        yield from zip(*(column.to_pylist() for column in batch.columns), strict=True)


def in_threads(load: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
    """Apply ``load`` to each item as ``map`` does, but in threads, so that requests to a remote store overlap."""
    with ThreadPoolExecutor(READERS) as pool:
        yield from pool.map(load, items)


def members_hash(members: pa.Table, state: Any = None) -> str:
    """Return a 128-bit hash over the unit ids of ``members`` and the logical hashes of their rows."""
    state = hashlib.sha256() if state is None else state
    for unit_id, hash_ in _rows(members, "unit_id", "hash"):
        name = unit_id.encode()
        state.update(len(name).to_bytes(4, "little") + name + hash_)
    found: str = state.hexdigest()[:32]
    return found


def content_hash(spec: TableSpec, members: pa.Table) -> str:
    """Return a 128-bit hash of everything that a part's bytes depend on (except versions of libraries)."""
    settings = [schema_hash(spec.schema), *spec.sort_keys, str(ROW_GROUP_ROWS), str(ZSTD_LEVEL)]
    return members_hash(members, hashlib.sha256(bytes.fromhex(digest(settings))))


def pack(store: Store, pipeline: Pipeline, job: PackJob, faults: str = "") -> Packed:
    """Write the file of ``job``, and check every unit's rows against their logical hash."""
    plan = FaultPlan.parse(faults) if faults else FaultPlan.from_environment()
    commits = Commits(store)
    spec = pipeline.tables[job.table]
    tables: list[pa.Table] = []
    damaged = []

    def load(member: tuple[Any, ...]) -> pa.Table | str:
        unit_id, stage, key, hash_ = member
        try:
            table = commits.table(stage, key.hex(), job.table, hash_.hex())
        except CorruptShardError:
            commits.discard(stage, key.hex())
            return str(unit_id)
        return table

    rows = _rows(job.members, "unit_id", "stage", "key", "hash")
    for found in map(load, rows) if store.lists_cheaply else in_threads(load, rows):
        if isinstance(found, str):
            damaged.append(found)
        else:
            tables.append(found)
    if damaged:
        return Packed(job.table, job.partition, None, tuple(damaged))
    whole = concatenated(iter(tables), spec, job.table)
    metadata = {f"{pipeline.name}.table": job.table, f"{pipeline.name}.schema_version": pipeline.schema_version}
    data = parquet_bytes(whole, sort_keys=spec.sort_keys, metadata=metadata)
    store.write(job.path, data)
    plan.reach("snapshot-between-parts")
    part = PartRecord(
        path=job.path.split("/", 2)[2],
        rows=whole.num_rows,
        bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
        content=job.content,
    )
    return Packed(job.table, job.partition, part)
