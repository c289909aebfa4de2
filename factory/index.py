"""The unit index: one row for each unit of a published snapshot, in one columnar file.

A plan compares a corpus with this file alone, never with one small file per unit. It stands beside the snapshot, not in
it: units may get new keys while their rows stay the same (a version raised, a file renamed and read alike), and then
the snapshot is the same one with another index. ``indexes/<hash>.parquet``, named by ``Ref.index``.

Columns: unit_id, partition, status (ok | skipped | quarantined), reason, fingerprint, attempts; for each stage
``<stage>.key .code .inputs .parameters .dependencies .seconds .peak_rss .skipped .cpu_seconds .estimate .stored`` (null
where it did not run); for each table ``<stage>/<table>.hash .rows .bytes``; of failed units ``failure.stage .key .cause
.exception .message``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from factory.pipeline import Pipeline
from factory.receipt import Failure, Receipt, StageReceipt, TableReceipt
from factory.rows import parquet_bytes, parquet_table
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
_FAILURE_FIELDS: Final = ("stage", "key", "cause", "exception", "message")
_BATCH: Final = 1024
"""Number of rows that are receipts at a time: as columns they take a tenth of the memory."""
_REBUILD: Final = "Run condvln generate CONFIG, which writes the index again."


def index_schema(pipeline: Pipeline) -> pa.Schema:
    """Return the columns of the index of ``pipeline``."""
    fields = [pa.field(name, kind) for name, kind in _UNIT_FIELDS.items()]
    for stage in pipeline.stages:
        fields += [pa.field(f"{stage.name}.{name}", kind) for name, kind in _STAGE_FIELDS]
        for table in stage.tables:
            prefix = f"{stage.name}/{table}"
            kinds = {"hash": _KEY, "rows": pa.int64(), "bytes": pa.int64()}
            fields += [pa.field(f"{prefix}.{name}", kind) for name, kind in kinds.items()]
    fields += [pa.field(f"failure.{name}", _KEY if name == "key" else pa.string()) for name in _FAILURE_FIELDS]
    return pa.schema(fields)


def _row(receipt: Receipt) -> dict[str, Any]:
    row: dict[str, Any] = {
        "unit_id": receipt.unit_id,
        "partition": receipt.partition,
        "status": receipt.status,
        "reason": receipt.reason,
        "fingerprint": receipt.fingerprint,
        "attempts": max(receipt.attempts, receipt.failure.attempts if receipt.failure else 1),
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
        for name in _FAILURE_FIELDS:
            row[f"failure.{name}"] = getattr(receipt.failure, name)
    return row


class IndexWriter:
    """Collects the receipts of a run as columns."""

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

    def finish(self, carried: pa.Table | None = None) -> Index:
        """Return the index of all added units and of the rows ``carried`` over from an older index."""
        self._flush()
        added = pa.Table.from_batches(self._batches, schema=self._schema)
        whole = added if carried is None else pa.concat_tables([added, _conformed(carried, self._schema)])
        return Index(whole.take(pc.sort_indices(whole, sort_keys=[("unit_id", "ascending")])))


def _conformed(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """Return ``table`` with exactly the columns of ``schema``; those that it lacks, of a new stage say, are null."""
    known = set(table.schema.names)
    columns = [
        table.column(f.name).cast(f.type) if f.name in known else pa.nulls(table.num_rows, f.type) for f in schema
    ]
    return pa.table(columns, schema=schema)


def failed_keys(index: Index) -> set[tuple[str, str]]:
    """Return (stage, key) of the quarantined units of an index."""
    failed = index.table.filter(pc.equal(index.table.column("status"), "quarantined"))
    rows = failed.select(["failure.stage", "failure.key"]).to_pylist()
    return {(row["failure.stage"], row["failure.key"].hex()) for row in rows}


class Index:
    """The rows of an index, sorted by unit id, and the lookup of single units.

    damaged : it stands in for one that is missing or damaged
    """

    def __init__(self, table: pa.Table, *, damaged: bool = False) -> None:
        self.table = table.combine_chunks()
        self.damaged = damaged

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
        if _hash_of(data) != hash_:
            raise CorruptShardError("the unit index differs from its hash", where=path, remedy=_REBUILD)
        table = parquet_table(data, path)
        if not set(_UNIT_FIELDS) <= set(table.schema.names):
            raise CorruptShardError("the unit index is of another version", where=path, remedy=_REBUILD)
        return cls(table)

    def write(self, store: Store) -> str:
        """Write the index; return the hash that names it."""
        data = parquet_bytes(self.table)
        found = _hash_of(data)
        store.write(Index.path(found), data)
        return found

    def __len__(self) -> int:
        return int(self.table.num_rows)

    @cached_property
    def _rows(self) -> dict[str, int]:
        return {unit_id: row for row, unit_id in enumerate(self.table.column("unit_id").to_pylist())}

    def stage_keys(self) -> Iterator[tuple[str, str]]:
        """Yield (stage, key in hexadecimal) of every stage that was made for a unit."""
        for name in self.stages:
            for key in self.table.column(f"{name}.key").drop_null().to_pylist():
                yield name, key.hex()

    @property
    def stages(self) -> list[str]:
        """Return the names of the stages that the index has columns of."""
        names = (name.rpartition(".") for name in self.table.schema.names)
        return [stage for stage, _, last in names if last == "key" and stage != "failure"]

    def row_of(self, unit_id: str) -> int:
        """Return the row number of a unit, or -1 if it is not in the index."""
        return self._rows.get(unit_id, -1)

    def value(self, row: int, column: str) -> Any:
        """Return one value; None where the index has no such column."""
        return self.table.column(column)[row].as_py() if column in self._names else None

    @cached_property
    def _names(self) -> frozenset[str]:
        return frozenset(self.table.schema.names)

    def receipt(self, row: int, pipeline: Pipeline) -> Receipt:
        """Return the receipt of the unit in ``row``. Stages that are no longer in ``pipeline`` are left out."""
        return next(self.receipts(pipeline, [row]))

    def receipts(self, pipeline: Pipeline, rows: Iterable[int] | None = None) -> Iterator[Receipt]:
        """Yield the receipts of the units in ``rows``, or of all; see `receipt`."""
        table = self.table if rows is None else self.table.take(pa.array(np.fromiter(rows, np.int64)))
        for batch in table.to_batches(max_chunksize=_BATCH):
            for values in batch.to_pylist():
                yield _receipt(values, pipeline)


def _hash_of(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:32]


def _receipt(values: dict[str, Any], pipeline: Pipeline) -> Receipt:
    """Return the receipt that a row of an index was made of."""
    stages = []
    for stage in pipeline.stages:
        if values.get(f"{stage.name}.key") is None:
            break
        tables = []
        for table in stage.tables:
            prefix = f"{stage.name}/{table}"
            if values.get(f"{prefix}.hash") is not None:
                tables.append(
                    TableReceipt(table, values[f"{prefix}.hash"], values[f"{prefix}.rows"], values[f"{prefix}.bytes"])
                )
        fields: dict[str, Any] = {name: values[f"{stage.name}.{name}"] for name, _ in _STAGE_FIELDS}
        stages.append(StageReceipt(stage=stage.name, made=False, tables=tuple(tables), **fields))
    failure = None
    if values["failure.stage"] is not None:
        fields = {name: values[f"failure.{name}"] for name in _FAILURE_FIELDS}
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
    )
