"""Refuse a Parquet file whose rows would fill the memory: one repeated value takes almost no bytes on disk."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq

__all__ = ["refuse_more_rows_than_bytes"]


def refuse_more_rows_than_bytes(path: Path) -> None:
    """Raise ValueError if a file claims more rows than it has bytes. Tables whose rows differ, by an id or a hash, need
    at least a byte for each. Only the file's footer is read.
    """
    rows, size = pq.read_metadata(path).num_rows, path.stat().st_size
    if rows > size:
        raise ValueError(f"{rows:,} rows in a file of {size:,} bytes: their ids can't all differ")
