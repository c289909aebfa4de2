"""Refuse a Parquet file whose rows would fill the memory: one repeated value takes almost no bytes on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from condvln.formats.regular_file import refuse_special

__all__ = ["FREE_BYTES", "MAX_RATIO", "refuse_parquet_bombs"]

MAX_RATIO: Final = 200
FREE_BYTES: Final = 256 << 20
"""A table may take this many bytes in memory, or `MAX_RATIO` times the size of its file if that is more."""

_WIDTHS: Final = {"BOOLEAN": 1, "INT32": 4, "INT64": 8, "INT96": 12, "FLOAT": 4, "DOUBLE": 8}
_TEXT: Final = "BYTE_ARRAY"
_SHARED: Final = "DELTA_BYTE_ARRAY"
"""An encoding of texts by what each shares with the one before it, so that every text may be longer than the file."""


def refuse_parquet_bombs(path: Path) -> None:
    """Raise ValueError if a file claims more rows than it has bytes, or would take more memory than `FREE_BYTES` and
    `MAX_RATIO` allow. Tables whose rows differ, by an id or a hash, need at least a byte for each row.

    Of columns of texts only the different texts are decoded, and the number of each counts.

    Raises
    ------
    ValueError : see above
    OSError : the file can't be opened, or is none
    pyarrow.ArrowException : it is not a Parquet file
    """
    refuse_special(path)
    size = path.stat().st_size
    with pq.ParquetFile(path) as file:
        footer = file.metadata
        if footer.num_rows > size:
            raise ValueError(f"{footer.num_rows:,} rows in a file of {size:,} bytes: their ids can't all differ")
        limit = max(FREE_BYTES, MAX_RATIO * size)
        groups = [footer.row_group(number) for number in range(footer.num_row_groups)]
        chunks = [group.column(number) for group in groups for number in range(group.num_columns)]
        packed = sum(chunk.total_uncompressed_size for chunk in chunks)
        fixed = sum(_decoded_size(chunk) for chunk in chunks)
    if max(packed, fixed) > limit:
        raise _too_large(size, limit)
    texts = sorted({chunk.path_in_schema for chunk in chunks if _is_plain_text(chunk)})
    with pq.ParquetFile(path, read_dictionary=texts) as file:
        found = fixed
        for group in range(file.num_row_groups):
            for name in texts:
                # One column at a time, since a name may occur twice, and a dot may be part of a name.
                found += sum(_text_size(part) for part in file.read_row_group(group, [name]).columns)
                if found > limit:
                    raise _too_large(size, limit)


def _too_large(size: int, limit: int) -> ValueError:
    return ValueError(f"a file of {size:,} bytes whose rows take more than {limit:,} bytes")


def _is_plain_text(chunk: Any) -> bool:
    """Return whether a column chunk holds texts outside of lists and structs, in an encoding that keeps them apart."""
    return chunk.physical_type == _TEXT and "." not in chunk.path_in_schema and _SHARED not in chunk.encodings


def _decoded_size(chunk: Any) -> int:
    """Return the bytes that the values of a column chunk take at most in memory; 0 for texts that are counted."""
    if _is_plain_text(chunk):
        return 0
    # A value of variable size is at most all that the chunk holds.
    return int(chunk.num_values) * int(_WIDTHS.get(chunk.physical_type, chunk.total_uncompressed_size))


def _text_size(column: pa.ChunkedArray) -> int:
    """Return the bytes of the texts of a column that was read with a dictionary."""
    total = 0
    for part in column.chunks:
        if not pa.types.is_dictionary(part.type):
            total += part.nbytes
            continue
        lengths = pc.fill_null(pc.binary_length(part.dictionary), 0).to_numpy(zero_copy_only=False)
        uses = np.bincount(part.indices.drop_null().to_numpy(), minlength=len(lengths))
        total += int(uses @ lengths.astype(np.int64))
    return total
