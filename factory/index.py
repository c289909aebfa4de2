"""The unit index: one row for each unit of a published snapshot, in one columnar file.

A plan compares a corpus with this file alone, never with one small file per unit. It stands beside the snapshot, not in
it: units may get new keys while their rows stay the same (a version raised, a file renamed and read alike), and then
the snapshot is the same one with another index. ``indexes/<hash>.parquet``, named by ``Ref.index``.

Columns: unit_id, partition, status (ok | skipped | quarantined), reason, fingerprint, attempts, content; for each stage
``<stage>.key .code .inputs .parameters .dependencies .seconds .peak_rss .skipped .cpu_seconds .estimate .stored`` (null
where it did not run); for each table ``<stage>/<table>.hash .rows .bytes``; of failed units ``failure.stage .key .cause
.exception .message``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from factory.pipeline import Pipeline
from factory.receipt import Failure, Receipt, StageReceipt, TableReceipt
from factory.store import Store
from schemas.errors import CorruptShardError

__all__ = ["Index", "IndexWriter", "failed_keys", "index_schema"]

_KEY = pa.binary(16)
_UNIT_FIELDS: Final = {
    "unit_id": pa.string(),
    "partition": pa.string(),
    "status": pa.string(),
    "reason": pa.string(),
    "fingerprint": _KEY,
    "attempts": pa.int32(),
    "content": _KEY,
}
_STAGE_FIELDS: Final = (
    ("key", _KEY),
    ("code", _KEY),
    ("inputs", _KEY),
    ("parameters", _KEY),
    ("dependencies", _KEY),
    ("seconds", pa.float32()),
    ("peak_rss", pa.int64()),
    ("skipped", pa.bool_()),
    ("cpu_seconds", pa.float32()),
    ("estimate", pa.float32()),
    ("stored", pa.int64()),
)
_BATCH: Final = 4096
"""Number of receipts that are converted to columns at a time."""
_REBUILD: Final = "Run condvln rebuild CONFIG, which writes the index again."


def index_schema(pipeline: Pipeline) -> pa.Schema:
    """Return the columns of the index of ``pipeline``."""
    fields = [pa.field(name, kind) for name, kind in _UNIT_FIELDS.items()]
    for stage in pipeline.stages:
        fields += [pa.field(f"{stage.name}.{name}", kind) for name, kind in _STAGE_FIELDS]
        for table in stage.tables:
            prefix = f"{stage.name}/{table}"
            fields += [
                pa.field(f"{prefix}.hash", _KEY),
                pa.field(f"{prefix}.rows", pa.int64()),
                pa.field(f"{prefix}.bytes", pa.int64()),
            ]
    fields += [
        pa.field("failure.stage", pa.string()),
        pa.field("failure.key", _KEY),
        pa.field("failure.cause", pa.string()),
        pa.field("failure.exception", pa.string()),
        pa.field("failure.message", pa.string()),
    ]
    return pa.schema(fields)


def _row(receipt: Receipt) -> dict[str, Any]:
    row: dict[str, Any] = {
        "unit_id": receipt.unit_id,
        "partition": receipt.partition,
        "status": receipt.status,
        "reason": receipt.reason,
        "fingerprint": receipt.fingerprint,
        "attempts": max(receipt.attempts, receipt.failure.attempts if receipt.failure else 1),
        "content": receipt.content or None,
    }
    for stage in receipt.stages:
        for name, _ in _STAGE_FIELDS:
            row[f"{stage.stage}.{name}"] = getattr(stage, name)
        for table in stage.tables:
            prefix = f"{stage.stage}/{table.table}"
            row[f"{prefix}.hash"] = table.hash
            row[f"{prefix}.rows"] = table.rows
            row[f"{prefix}.bytes"] = table.logical_bytes
    if receipt.failure is not None:
        for name in ("stage", "key", "cause", "exception", "message"):
            row[f"failure.{name}"] = getattr(receipt.failure, name)
    return row


class IndexWriter:
    """Converts receipts to columns, a batch at a time."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._schema = index_schema(pipeline)
        self._pending: list[dict[str, Any]] = []
        self._batches: list[pa.RecordBatch] = []

    def add(self, receipt: Receipt) -> None:
        """Add one finished unit."""
        self._pending.append(_row(receipt))
        if len(self._pending) >= _BATCH:
            self._flush()

    def _flush(self) -> None:
        columns = [pa.array([row.get(f.name) for row in self._pending], type=f.type) for f in self._schema]
        self._batches.append(pa.record_batch(columns, schema=self._schema))
        self._pending.clear()

    def finish(self, carried: pa.Table | None) -> pa.Table:
        """Return one table, sorted by unit id, of all added units and the rows of ``carried``, which are taken over
        from an older index.
        """
        if self._pending:
            self._flush()
        whole = pa.Table.from_batches(self._batches, schema=self._schema)
        self._batches = []
        if carried is not None and carried.num_rows:
            whole = pa.concat_tables([whole, _conformed(carried, self._schema)])
        order = pc.sort_indices(whole.select(["unit_id"]), sort_keys=[("unit_id", "ascending")])
        # Column by column, so that the unsorted and the sorted table are never both there as a whole.
        columns = []
        for name in whole.column_names:
            columns.append(whole.column(name).take(order))
            whole = whole.drop_columns([name])
        return pa.table(columns, schema=self._schema)


def _conformed(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """Return ``table`` with exactly the columns of ``schema``. Columns that ``table`` lacks (those of a new stage, for
    example) are null.
    """
    columns = [
        table.column(f.name).cast(f.type) if f.name in table.column_names else pa.nulls(table.num_rows, f.type)
        for f in schema
    ]
    return pa.table(columns, schema=schema)


def failed_keys(index: pa.Table) -> set[tuple[str, str]]:
    """Return (stage, key) of the quarantined units of an index."""
    failed = pc.equal(index.column("status"), "quarantined")
    rows = index.select(["failure.stage", "failure.key"]).filter(failed).to_pylist()
    return {(row["failure.stage"], row["failure.key"].hex()) for row in rows}


class Index:
    """An index in memory: whole columns, and single units by id.

    damaged : it stands in for one that is missing or damaged
    """

    def __init__(self, table: pa.Table, *, damaged: bool = False) -> None:
        self.table = table
        self.damaged = damaged
        ids = table.column("unit_id").combine_chunks() if table.num_rows else pa.array([], pa.string())
        self._ids = ids.chunk(0) if isinstance(ids, pa.ChunkedArray) else ids
        self._hashes = id_hashes(self._ids.to_pylist()) if len(self._ids) else np.zeros(0, np.uint64)
        self._order = np.argsort(self._hashes, kind="stable")
        self._sorted = self._hashes[self._order]

    @classmethod
    def empty(cls, pipeline: Pipeline, *, damaged: bool = False) -> Index:
        """Return an empty index."""
        return cls(index_schema(pipeline).empty_table(), damaged=damaged)

    @staticmethod
    def path(hash_: str) -> str:
        """Return the path of an index in the store."""
        return f"indexes/{hash_}.parquet"

    @classmethod
    def read(cls, store: Store, hash_: str) -> Index:
        """Read an index. Raises ``CorruptShardError`` when it is gone or differs from its hash."""
        path = f"{store.url}/{cls.path(hash_)}"
        try:
            data = store.read(cls.path(hash_))
        except FileNotFoundError as error:
            raise CorruptShardError("the unit index is missing", where=path, remedy=_REBUILD) from error
        if hashlib.sha256(data).hexdigest()[:32] != hash_:
            raise CorruptShardError("the unit index differs from its hash", where=path, remedy=_REBUILD)
        # Without threads: those of Arrow may still end while the interpreter does, and abort the process then.
        table = pq.ParquetFile(pa.BufferReader(data)).read(use_threads=False)
        if not set(_UNIT_FIELDS) <= set(table.column_names):
            raise CorruptShardError("the unit index is of another version", where=path, remedy=_REBUILD)
        return cls(table)

    @staticmethod
    def write(store: Store, table: pa.Table) -> str:
        """Write an index; return the hash that names it."""
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd", compression_level=1, row_group_size=131_072)
        data = sink.getvalue()
        found = hashlib.sha256(data).hexdigest()[:32]
        # Not create(): one of this name that is damaged must not stay.
        store.write(Index.path(found), data)
        return found

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def rows_of(self, unit_ids: Sequence[str]) -> Any:
        """Return the row number of each unit id, as (n,) int64; -1 for ids that are not in the index."""
        if not len(self):
            return np.full(len(unit_ids), -1, np.int64)
        wanted = id_hashes(unit_ids)
        place = np.minimum(np.searchsorted(self._sorted, wanted), len(self._sorted) - 1)
        rows = self._order[place].astype(np.int64)
        rows[self._sorted[place] != wanted] = -1
        # 64 bits could fall together; a wrong row must never be taken for the right one.
        found = np.nonzero(rows >= 0)[0]
        for at, unit_id in zip(found.tolist(), self._ids.take(pa.array(rows[found])).to_pylist(), strict=True):
            if unit_id != unit_ids[at]:
                rows[at] = self._search(unit_ids[at])
        return rows

    def _search(self, unit_id: str) -> int:
        return int(pc.index(self._ids, unit_id).as_py())

    def fingerprints(self) -> list[bytes]:
        """Return the fingerprint of every row."""
        found: list[bytes] = self.table.column("fingerprint").to_pylist()
        return found

    def statuses(self) -> list[str]:
        """Return the status of every row."""
        found: list[str] = self.table.column("status").to_pylist()
        return found

    def receipt(self, row: int, pipeline: Pipeline) -> Receipt:
        """Return the receipt of the unit in ``row``. Stages that are no longer in ``pipeline`` are left out."""
        values = self.table.slice(row, 1).to_pylist()[0]
        stages = []
        for stage in pipeline.stages:
            if values.get(f"{stage.name}.key") is None:
                break
            tables = []
            for table in stage.tables:
                prefix = f"{stage.name}/{table}"
                if values.get(f"{prefix}.hash") is not None:
                    tables.append(
                        TableReceipt(
                            table, values[f"{prefix}.hash"], values[f"{prefix}.rows"], values[f"{prefix}.bytes"]
                        )
                    )
            fields = {name: values.get(f"{stage.name}.{name}") for name, _ in _STAGE_FIELDS}
            # An index from before these were recorded has none.
            fields |= {name: fields[name] or 0.0 for name in ("cpu_seconds", "estimate")}
            stages.append(StageReceipt(stage=stage.name, made=False, tables=tuple(tables), **fields))
        failure = None
        if values["failure.stage"] is not None:
            fields = {name: values[f"failure.{name}"] for name in ("stage", "key", "cause", "exception", "message")}
            failure = Failure(**fields, known=True, attempts=values["attempts"] or 1)
        return Receipt(
            unit_id=values["unit_id"],
            partition=values["partition"],
            status=values["status"],
            reason=values["reason"] or "",
            fingerprint=values["fingerprint"],
            stages=tuple(stages),
            failure=failure,
            attempts=values["attempts"] or 1,
            content=values["content"] or b"",
        )

    def receipts(self, rows: Iterable[int], pipeline: Pipeline) -> Iterator[Receipt]:
        """Return the receipts of the units in `rows`; see `receipt`."""
        return (self.receipt(row, pipeline) for row in rows)


def id_hashes(unit_ids: Sequence[str]) -> Any:
    """Return the (n,) uint64 hashes of unit ids; a million of them fit easily in memory."""
    joined = b"".join(
        hashlib.blake2b(text.encode("utf-8", "surrogatepass"), digest_size=8).digest() for text in unit_ids
    )
    return np.frombuffer(joined, np.uint64).copy()
