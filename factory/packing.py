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
    "content_of",
    "hash_members",
    "in_threads",
    "pack",
    "size",
]

PART_BYTES: Final = 128 * 1024 * 1024
"""Most canonical bytes of one part: a file of some 16-64 MB after zstd, packed within 1 GiB of memory."""

READERS: Final = 16
"""Number of requests to an object store at once while packing: each takes some tens of milliseconds and no CPU."""


@dataclass(frozen=True, slots=True)
class PackJob:
    """A file of a published table that is to be written, and the rows that belong in the file.

    members : columns unit_id, stage, key, hash, bytes; a row for each unit and stage with rows, by unit id
    logical_bytes : canonical bytes of all members
    """

    table: str
    partition: str
    bucket: int
    path: str
    content: str
    members: pa.Table
    logical_bytes: int


@dataclass(frozen=True, slots=True)
class Packed:
    """Result of a ``PackJob``: the file written, or the units whose damaged files were removed."""

    table: str
    partition: str
    part: PartRecord | None
    damaged: tuple[str, ...] = ()


def buckets(members: pa.Table, count: int) -> Iterator[tuple[int, pa.Table]]:
    """Divide the ``members`` of one table and partition (see ``PackJob``) into ``count`` buckets; yield (number,
    members) of each bucket that is not empty. A single bucket is yielded in any case.
    """
    if count == 1:
        yield 0, members
        return
    names = members.column("unit_id").to_pylist()
    numbers = np.fromiter((zlib.crc32(unit_id.encode()) % count for unit_id in names), np.int64, len(names))
    for bucket in np.unique(numbers).tolist():
        yield bucket, members.filter(pa.array(numbers == bucket))


def bucket_count(whole: int, part_bytes: int) -> int:
    """Return the number of buckets, a power of two, into which ``whole`` canonical bytes of one table and partition are
    divided.
    """
    count = 1
    while count * part_bytes < whole:
        count *= 2
    return count


def size(members: pa.Table) -> int:
    """Return the total number of canonical bytes of ``members``."""
    return int(pc.sum(members.column("bytes")).as_py() or 0)


def _rows(members: pa.Table, *names: str) -> Iterator[tuple[Any, ...]]:
    """Yield the values of the named columns, row by row."""
    return zip(*(members.column(name).to_pylist() for name in names), strict=True)


def in_threads(load: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
    """Apply ``load`` to each item as ``map`` does, but in threads, so that requests to a remote store overlap."""
    with ThreadPoolExecutor(READERS) as pool:
        yield from pool.map(load, items)


def hash_members(state: Any, members: pa.Table) -> None:
    """Update the hash ``state`` with the unit ids of ``members`` and the logical hashes of their rows."""
    for unit_id, hash_ in _rows(members, "unit_id", "hash"):
        name = unit_id.encode()
        state.update(len(name).to_bytes(4, "little") + name + hash_)


def content_of(spec: TableSpec, members: pa.Table) -> str:
    """Return the 128-bit hash of everything that a part's bytes depend on, except versions of libraries and of this
    code.
    """
    settings = [schema_hash(spec.schema), *spec.sort_keys, str(ROW_GROUP_ROWS), str(ZSTD_LEVEL)]
    state = hashlib.sha256(bytes.fromhex(digest(settings)))
    hash_members(state, members)
    return state.hexdigest()[:32]


def pack(store: Store, pipeline: Pipeline, job: PackJob) -> Packed:
    """Write the file of ``job``, and check every unit's rows against their logical hash."""
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
    for found in in_threads(load, rows):
        if isinstance(found, str):
            damaged.append(found)
        else:
            tables.append(found)
    if damaged:
        return Packed(job.table, job.partition, None, tuple(damaged))
    # with the contract's descriptions of its columns, as metadata of the fields
    whole = pa.table(concatenated(tables, spec, job.table).columns, schema=spec.schema)
    metadata = {f"{pipeline.name}.table": job.table, f"{pipeline.name}.schema_version": pipeline.schema_version}
    data = parquet_bytes(whole, sort_keys=spec.sort_keys, metadata=metadata)
    store.write(job.path, data)
    part = PartRecord(
        path=job.path.split("/", 2)[2],
        rows=whole.num_rows,
        bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
        content=job.content,
    )
    return Packed(job.table, job.partition, part)
