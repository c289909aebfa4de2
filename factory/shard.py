"""Shards: the file of one table of one unit, as the store keeps it for later stages and for packing.

A shard is an Arrow stream in one frame of zstd (``<table>.arrows.zst``), which is written and read in a tenth of the
time of Parquet: a unit has fifteen small tables with hundreds of nested columns, and Parquet describes each column.
``pyarrow.ipc.open_stream(pyarrow.input_stream(path))`` reads it, and so does any tool for Arrow and zstd.

A frame that decoders skip stands before it and holds the size of the stream, the logical hash of the rows, and a
checksum of the two and of all bytes that follow. So damage is found before anything is decoded, and the rows are known
without hashing them again.
"""

from __future__ import annotations

import hashlib
import struct
from typing import Any, Final

import pyarrow as pa
import pyarrow.ipc as ipc

from schemas.errors import CorruptShardError

__all__ = ["SUFFIX", "shard_bytes", "shard_table"]

SUFFIX: Final = ".arrows.zst"
"""End of the name of a shard's file."""

_LEVEL: Final = 1
"""Compression level of zstd. Level 3 takes a quarter longer and saves a twelfth of the bytes."""

_CODEC: Final = pa.Codec("zstd", _LEVEL)
_SKIPPED: Final = struct.pack("<II", 0x184D2A50, 56)
"""Magic number of a frame that decoders of zstd skip, and the size of what it holds."""

_FACTS: Final = struct.Struct("<Q16s")
"""Bytes of the stream before compression, and logical hash of the rows."""

_HEAD: Final = len(_SKIPPED) + hashlib.sha256().digest_size + _FACTS.size


def shard_bytes(table: pa.Table, rows_hash: str) -> bytes:
    """Encode ``table``.

    rows_hash : its logical hash, see ``factory.rows``
    """
    sink = pa.BufferOutputStream()
    with ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    stream = sink.getvalue()
    facts = _FACTS.pack(stream.size, bytes.fromhex(rows_hash))
    frame = _CODEC.compress(stream, asbytes=True)
    return b"".join((_SKIPPED, _checksum(facts, frame), facts, frame))


def shard_table(data: bytes, where: str, rows_hash: str | None, remedy: str) -> pa.Table:
    """Decode the table in ``data``.

    rows_hash : the logical hash that its rows must have; None where it is not known

    Raises ``CorruptShardError``, with ``remedy``, when the bytes are not those that were written, or the rows are
    others.
    """
    view = memoryview(data)
    checksum, facts, frame = view[8:40], view[40:_HEAD], view[_HEAD:]
    if len(view) < _HEAD or view[:8] != _SKIPPED or checksum != _checksum(facts, frame):
        raise CorruptShardError("the bytes differ from their checksum", where=where, remedy=remedy)
    size, found = _FACTS.unpack(facts)
    if rows_hash is not None and found.hex() != rows_hash:
        raise CorruptShardError("the rows differ from the hash of their commit", where=where, remedy=remedy)
    try:
        return ipc.open_stream(_CODEC.decompress(frame, size)).read_all()
    except (pa.ArrowException, OSError, ValueError) as error:
        raise CorruptShardError(f"not a readable table: {error}", where=where, remedy=remedy) from error


def _checksum(facts: Any, frame: Any) -> bytes:
    state = hashlib.sha256(facts)
    state.update(frame)
    return state.digest()
