"""Tables that are too long for memory: batches of rows in a temporary file that is mapped into memory.

Arrow reads the file in place. Neither the rows nor their description are held: a batch is decoded when it is asked for.
Pages that were read count as memory of the process until ``let_go`` gives them back; whoever goes through a whole table
calls it after each batch.
"""

from __future__ import annotations

import mmap
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import pyarrow as pa

from factory.temporary import close_files, temporary_space

__all__ = ["BATCH_ROWS", "BatchedTable", "Scratch", "batches", "let_go", "let_pages_go"]

BATCH_ROWS: Final = 2048
"""Most rows of a batch: some 0.5 to 3 MB of a unit index."""

_mapped: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
"""The files that are mapped now."""


class BatchedTable:
    """A table that is read batch by batch.

    source : an Arrow file, or batches that are in memory
    starts : (batches + 1,) int64, the number of the first row of each batch, then the number of all rows
    """

    def __init__(self, schema: pa.Schema, source: pa.Buffer | Sequence[pa.RecordBatch], rows: Sequence[int]) -> None:
        self.schema = schema
        self._source = source
        self.starts = np.cumsum([0, *rows], dtype=np.int64)
        self._reader: pa.ipc.RecordBatchFileReader | None = None

    @classmethod
    def of(cls, table: pa.Table) -> BatchedTable:
        """Return a table that is in memory, in batches of at most ``BATCH_ROWS``."""
        held = table.to_batches(max_chunksize=BATCH_ROWS)
        return cls(table.schema, held, [batch.num_rows for batch in held])

    @property
    def num_rows(self) -> int:
        """Return the number of rows."""
        return int(self.starts[-1])

    def __len__(self) -> int:
        """Return the number of batches."""
        return len(self.starts) - 1

    def batch(self, number: int, columns: Sequence[str] | None = None) -> pa.RecordBatch:
        """Return a batch, or some of its columns."""
        if not isinstance(self._source, pa.Buffer):
            found = self._source[number]
        else:
            # Of all columns: to read some, Arrow would copy them.
            self._reader = self._reader or pa.ipc.open_file(self._source)
            found = self._reader.get_batch(number)
        return found if columns is None else found.select(list(columns))

    def whole(self) -> pa.Table:
        """Return the table with all its batches, whose description takes memory."""
        found = []
        for number in range(len(self)):
            found.append(self.batch(number))
            let_go()
        return pa.Table.from_batches(found, schema=self.schema)


class Scratch:
    """A table that is written batch by batch. Up to ``BATCH_ROWS`` rows never touch the disk."""

    def __init__(self, schema: pa.Schema) -> None:
        self._schema = schema
        self._held: list[pa.RecordBatch] = []
        self._rows: list[int] = []
        self._count = 0
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - closed with this object
        weakref.finalize(self, close_files, self._file)
        self._writer: pa.ipc.RecordBatchFileWriter | None = None

    def __len__(self) -> int:
        """Return the number of batches."""
        return len(self._rows)

    def write(self, batch: pa.RecordBatch) -> None:
        """Append a batch; it stays one batch of the table."""
        self._rows.append(batch.num_rows)
        self._count += batch.num_rows
        self._held.append(batch)
        if self._count > BATCH_ROWS:
            with temporary_space():
                self._writer = self._writer or pa.ipc.new_file(self._file, self._schema)
                for held in self._held:
                    self._writer.write_batch(held)
            self._held.clear()
            let_pages_go()

    def table(self) -> BatchedTable:
        """Return the whole table; nothing can be written after that. Its file lasts as long as the table."""
        if self._writer is None:
            close_files(self._file)
            return BatchedTable(self._schema, self._held, self._rows)
        with temporary_space(), self._file as file:
            self._writer.close()
            file.flush()
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        _mapped.add(mapped)
        return BatchedTable(self._schema, pa.py_buffer(mapped), self._rows)


def batches(table: BatchedTable, columns: Sequence[str] | None = None) -> Iterator[tuple[int, pa.RecordBatch]]:
    """Yield (number of the first row, batch) through a table, or through some of its columns; memory is let go after
    each batch.
    """
    for number in range(len(table)):
        yield int(table.starts[number]), table.batch(number, columns)
        let_go()


def let_go() -> None:
    """Give the memory of all mapped tables back to the system, and what Arrow keeps of freed memory. What is read again
    comes from the system's cache of files.
    """
    pa.default_memory_pool().release_unused()
    let_pages_go()


def let_pages_go() -> None:
    """Give the memory of all mapped tables back to the system."""
    if hasattr(mmap, "MADV_DONTNEED"):
        for mapped in list(_mapped):
            mapped.madvise(mmap.MADV_DONTNEED)
