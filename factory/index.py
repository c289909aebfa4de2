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
import tempfile
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from itertools import islice, pairwise
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from factory.flags import Flags
from factory.pipeline import Pipeline
from factory.receipt import Failure, Receipt, StageReceipt, TableReceipt
from factory.scratch import BATCH_ROWS, BatchedTable, Scratch, batches, let_go, let_pages_go
from factory.store import Store
from factory.temporary import temporary_space
from schemas.errors import CorruptShardError, StoreError

__all__ = ["STATUSES", "Index", "IndexWriter", "failed_keys", "index_schema"]

STATUSES: Final = ("ok", "skipped", "quarantined")
"""Statuses of published units."""

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
_BATCH: Final = 256
"""Number of receipts that are converted to columns at a time."""
_RUN_ROWS: Final = 2 * BATCH_ROWS
"""Rows of a sorted run."""
_PIECE: Final = BATCH_ROWS
"""Most rows that are merged at a time."""
_STEP: Final = 256
"""Rows of a batch of what is merged."""
_FAN_IN: Final = 16
"""Most runs that are merged at a time: a batch of each is in memory."""
_GROUP_ROWS: Final = 8192
"""Rows of a row group of an index file."""
_SINGLY: Final = 8
"""Up to so many ids in one batch are looked up one by one; for more, all ids of the batch are read."""
_CHUNK: Final = 1 << 18
"""Bytes of a file that are hashed at a time."""
_STREAMED: Final = 1 << 14
"""Bytes that are read of a column of an index file at a time."""
_RECENT: Final = 16
"""Batches of an index whose description is kept: the next unit that is asked for is often in one of them."""
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
    """Converts receipts to columns, and sorts them by unit id: sorted runs go to disk and are merged at the end."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._schema = index_schema(pipeline)
        self._pending: list[dict[str, Any]] = []
        self._run: list[pa.RecordBatch] = []
        self._runs = _Runs(self._schema)

    def add(self, receipt: Receipt) -> None:
        """Add one finished unit."""
        self._pending.append(_row(receipt))
        if len(self._pending) >= _BATCH:
            self._flush()
            if len(self._run) * _BATCH >= _RUN_ROWS:
                self._end_run()

    def _flush(self) -> None:
        columns = [pa.array([row.get(f.name) for row in self._pending], type=f.type) for f in self._schema]
        self._run.append(pa.record_batch(columns, schema=self._schema))
        self._pending.clear()

    def _end_run(self) -> None:
        whole = _joined(self._run)
        self._run.clear()
        order = pc.sort_indices(whole.column("unit_id"))
        self._runs.add(whole.take(order.slice(start, _STEP)) for start in range(0, len(order), _STEP))

    def finish(self, carried: BatchedTable | None, kept: Flags | None = None) -> BatchedTable:
        """Return one table, sorted by unit id, of all added units and the rows of ``carried``, which are taken over
        from an older index.

        kept : for each row of ``carried`` whether it is taken over; all are by default
        """
        if self._pending:
            self._flush()
        if self._run:
            self._end_run()
        runs = self._runs
        while len(runs) > _FAN_IN:
            fewer = _Runs(self._schema)
            streams = runs.streams()
            while some := [*islice(streams, _FAN_IN)]:
                fewer.add(_regrouped(_merged(some), _STEP))
            runs = fewer
        last = [*runs.streams()]
        if carried is not None:
            last.append(_carried(carried, kept, self._schema))
        whole = Scratch(self._schema)
        for batch in _regrouped(_merged(last), BATCH_ROWS):
            whole.write(batch)
        return whole.table()


class _Runs:
    """Sorted runs on disk."""

    def __init__(self, schema: pa.Schema) -> None:
        self._scratch = Scratch(schema)
        self._ends: list[int] = []
        """Where each run ends, in batches."""

    def __len__(self) -> int:
        return len(self._ends)

    def add(self, run: Iterable[pa.RecordBatch]) -> None:
        """Add a run."""
        for batch in run:
            self._scratch.write(batch)
        self._ends.append(len(self._scratch))

    def streams(self) -> Iterator[Iterator[pa.RecordBatch]]:
        """Yield the batches of each run; nothing can be added after that."""
        table = self._scratch.table()
        for begin, end in pairwise([0, *self._ends]):
            yield map(table.batch, range(begin, end))


def _regrouped(pieces: Iterable[pa.RecordBatch], size: int) -> Iterator[pa.RecordBatch]:
    """Yield the rows of all pieces in batches of `size` rows; what was read of mapped tables is let go on the way."""
    held: list[pa.RecordBatch] = []
    rows = 0
    for piece in pieces:
        held.append(piece)
        rows += piece.num_rows
        if rows >= size:
            joined = _joined(held)
            held.clear()
            cut = rows - rows % size
            for start in range(0, cut, size):
                yield joined.slice(start, size)
            rows -= cut
            # Taken, since a slice would hold the whole.
            held = [joined.take(pa.array(np.arange(cut, cut + rows)))] if rows else []
        let_go()
    if rows:
        yield _joined(held)


class _LettingGo:
    """A file that is written; what was read of mapped tables is let go each time, which is once for each column."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.closed = False

    def write(self, data: Any) -> int:
        let_pages_go()
        return self._file.write(data)

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        self._file.flush()


def _write(file: Any, rows: BatchedTable) -> None:
    with pq.ParquetWriter(file, rows.schema, compression="zstd", compression_level=1) as writer:
        for group in _groups(rows):
            writer.write_table(group, row_group_size=_GROUP_ROWS)
        if not rows.num_rows:
            writer.write_table(rows.schema.empty_table())


def _groups(rows: BatchedTable) -> Iterator[pa.Table]:
    """Yield all rows in tables of ``_GROUP_ROWS`` rows, which are not copied."""
    held = rows.schema.empty_table()
    for number in range(len(rows)):
        held = pa.concat_tables([held, pa.table(rows.batch(number))])
        while held.num_rows >= _GROUP_ROWS:
            yield held.slice(0, _GROUP_ROWS)
            held = held.slice(_GROUP_ROWS)
            let_go()
    if held.num_rows:
        yield held


def _joined(parts: Sequence[pa.RecordBatch]) -> pa.RecordBatch:
    return parts[0] if len(parts) == 1 else pa.concat_batches(parts)


def _sorted(parts: Sequence[pa.RecordBatch]) -> pa.RecordBatch:
    """Return the rows of sorted or unsorted batches in the order of their unit ids."""
    whole = _joined(parts)
    return whole.take(pc.sort_indices(whole.column("unit_id")))


def _carried(table: BatchedTable, kept: Flags | None, schema: pa.Schema) -> Iterator[pa.RecordBatch]:
    for start, batch in batches(table):
        rows = batch if kept is None else batch.filter(pa.array(kept[start : start + batch.num_rows]))
        yield _conformed(rows, schema)


class _Run:
    """A sorted stream of batches that is being merged: its current batch, and how many rows of it are gone."""

    def __init__(self, stream: Iterator[pa.RecordBatch]) -> None:
        self._stream = stream
        self._batch: pa.RecordBatch | None = None
        self._at = 0
        self.first = ""

    def fill(self) -> bool:
        """Make sure that rows are left; return whether there are any."""
        while self._batch is None or self._at == self._batch.num_rows:
            self._batch, self._at = next(self._stream, None), 0
            if self._batch is None:
                return False
        self.first = self._id(self._at)
        return True

    def _id(self, row: int) -> str:
        assert self._batch is not None
        found: str = self._batch.column(0)[row].as_py()
        return found

    def last(self, window: int) -> str:
        """Return the last id of the next ``window`` rows."""
        assert self._batch is not None
        return self._id(min(self._at + window, self._batch.num_rows) - 1)

    def take(self, bound: str, window: int) -> pa.RecordBatch:
        """Remove and return those of the next ``window`` rows whose ids are not above ``bound``."""
        assert self._batch is not None
        start, stop = self._at, min(self._at + window, self._batch.num_rows)
        self._at = bisect_right(range(stop), bound, start, key=self._id)
        return self._batch.slice(start, self._at - start)


def _merged(streams: Iterable[Iterator[pa.RecordBatch]]) -> Iterator[pa.RecordBatch]:
    """Merge sorted streams of batches into one, at most ``_PIECE`` rows (or one of each stream) at a time.

    Of each stream a window of rows is looked at; what is not above the end of any window is next.
    """
    runs = [run for run in map(_Run, streams) if run.fill()]
    while runs:
        due: Sequence[_Run] = ()
        for _ in range(2):  # the second time with windows for those streams that have any of the next rows
            window = max(_PIECE // max(len(due), 1), 1)
            bound = min(run.last(window) for run in runs)
            due = [run for run in runs if run.first <= bound]
        parts = [run.take(bound, window) for run in due]
        yield parts[0] if len(parts) == 1 else _sorted(parts)
        gone = {run for run in due if not run.fill()}
        runs = [run for run in runs if run not in gone]


def _conformed(batch: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """Return ``batch`` with exactly the columns of ``schema``. Columns that ``batch`` lacks (those of a new stage, for
    example) are null.
    """
    known = set(batch.schema.names)
    columns = [
        batch.column(f.name).cast(f.type) if f.name in known else pa.nulls(batch.num_rows, f.type) for f in schema
    ]
    return pa.record_batch(columns, schema=schema)


def failed_keys(index: BatchedTable) -> set[tuple[str, str]]:
    """Return (stage, key) of the quarantined units of an index."""
    found = set()
    for _, batch in batches(index, ["status", "failure.stage", "failure.key"]):
        failed = batch.filter(pc.equal(batch.column("status"), "quarantined"))
        found |= {(row["failure.stage"], row["failure.key"].hex()) for row in failed.to_pylist()}
    return found


def _checked(batch: pa.RecordBatch, last: pa.Scalar | None, path: str) -> pa.Scalar | None:
    """Return the last id of a batch. Raises ``CorruptShardError`` where merging would go wrong: ids that do not ascend
    from `last` on, or an unknown status.
    """
    ids = batch.column("unit_id")
    if not len(ids):
        return last
    ascend = last is None or pc.less(last, ids[0]).as_py()
    if ids.null_count or not ascend or pc.any(pc.less_equal(ids.slice(1), ids.slice(0, len(ids) - 1))).as_py():
        raise CorruptShardError("the ids of the unit index do not ascend", where=path, remedy=_REBUILD)
    if not pc.all(pc.is_in(batch.column("status"), value_set=pa.array(STATUSES))).as_py():
        raise CorruptShardError("the unit index has an unknown status", where=path, remedy=_REBUILD)
    return ids[len(ids) - 1]


@contextmanager
def _readable(path: str) -> Iterator[None]:
    """Context in which an index is read. Raises ``StoreError`` where its disk fails."""
    try:
        yield
    except OSError as error:
        raise StoreError(f"the unit index can't be read: {error}", where=path, remedy="Check the disk.") from error


class Index:
    """The rows of an index, sorted by unit id, and the lookup of single units. An index of many rows is on disk.

    damaged : it stands in for one that is missing or damaged
    """

    def __init__(self, rows: BatchedTable | pa.Table, *, damaged: bool = False) -> None:
        self.rows = rows if isinstance(rows, BatchedTable) else BatchedTable.of(rows)
        self.damaged = damaged
        self._recent: dict[int, pa.RecordBatch] = {}

    @property
    def table(self) -> pa.Table:
        """Return all rows as one table."""
        return self.rows.whole()

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
            file = store.open(cls.path(hash_))
        except FileNotFoundError as error:
            raise CorruptShardError("the unit index is missing", where=path, remedy=_REBUILD) from error
        with file, _readable(path):
            if _hash_of(file) != hash_:
                raise CorruptShardError("the unit index differs from its hash", where=path, remedy=_REBUILD)
            # Buffered in advance, the file would be held as a whole by its end.
            parquet = pq.ParquetFile(file, pre_buffer=False, buffer_size=_STREAMED)
            if not set(_UNIT_FIELDS) <= set(parquet.schema_arrow.names):
                raise CorruptShardError("the unit index is of another version", where=path, remedy=_REBUILD)
            scratch, last = Scratch(parquet.schema_arrow), None
            # Without threads: those of Arrow may still end while the interpreter does, and abort the process then.
            for batch in parquet.iter_batches(BATCH_ROWS, use_threads=False):
                last = _checked(batch, last, path)
                scratch.write(batch)
                del batch  # while the next one is decoded
            del parquet
            let_go()
        return cls(scratch.table())

    @staticmethod
    def write(store: Store, rows: BatchedTable) -> str:
        """Write an index; return the hash that names it."""
        with tempfile.TemporaryFile() as file:
            with temporary_space():
                _write(_LettingGo(file), rows)
                let_go()
                found = _hash_of(file)
            # Not create(): one of this name that is damaged must not stay.
            store.write(Index.path(found), file)
        return found

    def __len__(self) -> int:
        return self.rows.num_rows

    @cached_property
    def _firsts(self) -> list[str]:
        """The first id of each batch."""
        return [batch.column(0)[0].as_py() for _, batch in batches(self.rows, ["unit_id"])]

    def rows_of(self, unit_ids: Sequence[str]) -> npt.NDArray[np.int64]:
        """Return the row number of each unit id, as (n,) int64; -1 for ids that are not in the index."""
        rows = [-1] * len(unit_ids)
        if len(self):
            there: dict[int, list[int]] = {}
            for at, unit_id in enumerate(unit_ids):
                there.setdefault(bisect_right(self._firsts, unit_id) - 1, []).append(at)
            there.pop(-1, None)
            for number, places in there.items():
                for at, row in zip(places, self._rows_in(number, [unit_ids[at] for at in places]), strict=True):
                    rows[at] = row
        return np.array(rows, np.int64)

    def _rows_in(self, number: int, unit_ids: Sequence[str]) -> list[int]:
        """Return the row number of each unit id in a batch, -1 for those that are not in it."""
        start = int(self.rows.starts[number])
        column = self.rows.batch(number, ["unit_id"]).column(0)
        found = []
        if len(unit_ids) <= _SINGLY:
            for unit_id in unit_ids:
                at = bisect_left(range(len(column)), unit_id, key=lambda row: column[row].as_py())
                found.append(start + at if at < len(column) and column[at].as_py() == unit_id else -1)
            return found
        ids = column.to_pylist()
        for unit_id in unit_ids:
            at = bisect_left(ids, unit_id)
            found.append(start + at if at < len(ids) and ids[at] == unit_id else -1)
        return found

    def take(self, rows: npt.NDArray[np.int64], columns: Sequence[str]) -> pa.Table:
        """Return some columns of the given rows, in their order."""
        order = np.argsort(rows, kind="stable")
        ranked = rows[order]
        cuts = np.searchsorted(ranked, self.rows.starts)
        parts = [self.rows.schema.empty_table().select(list(columns)).combine_chunks()]
        for at in np.flatnonzero(np.diff(cuts)).tolist():
            there = pa.array(ranked[cuts[at] : cuts[at + 1]] - self.rows.starts[at])
            parts.append(pa.table(self.rows.batch(at, columns).take(there)))
        back = np.empty_like(order)
        back[order] = np.arange(len(order))
        return pa.concat_tables(parts).combine_chunks().take(pa.array(back))

    def value(self, row: int, column: str) -> Any:
        """Return one value; None where the index has no such column."""
        batch, at = self._place(row)
        return batch.column(column)[at].as_py() if column in self._names else None

    @cached_property
    def _names(self) -> frozenset[str]:
        return frozenset(self.rows.schema.names)

    def _place(self, row: int) -> tuple[pa.RecordBatch, int]:
        number = int(np.searchsorted(self.rows.starts, row, "right")) - 1
        batch = self._recent.get(number)
        if batch is None:
            if len(self._recent) >= _RECENT:
                self._recent.clear()
            batch = self._recent[number] = self.rows.batch(number)
        return batch, row - int(self.rows.starts[number])

    def receipt(self, row: int, pipeline: Pipeline) -> Receipt:
        """Return the receipt of the unit in ``row``. Stages that are no longer in ``pipeline`` are left out."""
        batch, at = self._place(row)
        values = batch.slice(at, 1).to_pylist()[0]
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
        for number, row in enumerate(rows):
            yield self.receipt(row, pipeline)
            if number % BATCH_ROWS == 0:
                let_go()


def id_hashes(unit_ids: Sequence[str]) -> Any:
    """Return the (n,) uint64 hashes of unit ids; a million of them fit easily in memory."""
    joined = b"".join(
        hashlib.blake2b(text.encode("utf-8", "surrogatepass"), digest_size=8).digest() for text in unit_ids
    )
    return np.frombuffer(joined, np.uint64).copy()


def _hash_of(file: BinaryIO) -> str:
    """Return the first half of a file's SHA-256."""
    state = hashlib.sha256()
    file.seek(0)
    while data := file.read(_CHUNK):
        state.update(data)
    file.seek(0)
    return state.hexdigest()[:32]
