"""Tables that are too long for memory: batches of rows in a temporary file that is mapped into memory.

Arrow reads the file in place, so such a table is used as any other. Pages that were read count as memory of the process
until ``let_go`` gives them back; whoever goes through a whole table calls it after each batch.
"""

from __future__ import annotations

import mmap
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from typing import Final

import pyarrow as pa

from factory.temporary import close_files, temporary_space

__all__ = ["BATCH_ROWS", "Scratch", "batches", "let_go"]

BATCH_ROWS: Final = 8192
"""Most rows of a batch: some 2 to 10 MB of a unit index."""

_mapped: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
"""The files that are mapped now."""


class Scratch:
    """A table that is written batch by batch. Up to ``BATCH_ROWS`` rows never touch the disk."""

    def __init__(self, schema: pa.Schema) -> None:
        self._schema = schema
        self._held: list[pa.RecordBatch] = []
        self._rows = 0
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - closed with this object
        weakref.finalize(self, close_files, self._file)
        self._writer: pa.ipc.RecordBatchFileWriter | None = None

    def write(self, batch: pa.RecordBatch) -> None:
        """Append a batch; it stays one batch of the table."""
        self._rows += batch.num_rows
        self._held.append(batch)
        if self._rows > BATCH_ROWS:
            with temporary_space():
                self._writer = self._writer or pa.ipc.new_file(self._file, self._schema)
                for held in self._held:
                    self._writer.write_batch(held)
            self._held.clear()
            let_go()

    def table(self) -> pa.Table:
        """Return the whole table; nothing can be written after that. Its file lasts as long as the table."""
        if self._writer is None:
            close_files(self._file)
            return pa.Table.from_batches(self._held, schema=self._schema)
        with temporary_space(), self._file as file:
            self._writer.close()
            file.flush()
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        _mapped.add(mapped)
        return pa.ipc.open_file(pa.py_buffer(mapped)).read_all()


def batches(table: pa.Table, columns: Sequence[str] | None = None) -> Iterator[tuple[int, pa.RecordBatch]]:
    """Yield (number of the first row, batch) through a table, or through some of its columns; memory is let go after
    each batch.
    """
    start = 0
    for batch in (table if columns is None else table.select(list(columns))).to_batches(max_chunksize=BATCH_ROWS):
        yield start, batch
        start += batch.num_rows
        let_go()


def let_go() -> None:
    """Give the memory of all mapped tables back to the system, and what Arrow keeps of freed memory. What is read again
    comes from the system's cache of files.
    """
    pa.default_memory_pool().release_unused()
    if hasattr(mmap, "MADV_DONTNEED"):
        for mapped in list(_mapped):
            mapped.madvise(mmap.MADV_DONTNEED)
