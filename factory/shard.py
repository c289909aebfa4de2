"""Shards: the file that holds all tables of one stage of one unit, for later stages and for packing.

Each table is an Arrow stream in one frame of zstd, which is written and read in a tenth of the time of Parquet: a unit
has fifteen small tables with hundreds of nested columns, and Parquet describes each column. Any tool for Arrow and zstd
reads them: ``pyarrow.ipc.open_stream`` returns one after the other from ``pyarrow.input_stream(path)``.

A frame that decoders skip stands before each and holds the table's name, the sizes of its frame and of its stream, the
logical hash of its rows, and a checksum of all these and of the frame. So damage is found before anything is decoded,
and the rows are known without hashing them again.
"""

from __future__ import annotations

import hashlib
import struct
from typing import Any, Final

import pyarrow as pa
import pyarrow.ipc as ipc

from schemas.errors import CorruptShardError

__all__ = ["SHARD_FILE", "shard_bytes", "shard_table"]

SHARD_FILE: Final = "tables.arrows.zst"
"""File name of a shard."""

_LEVEL: Final = 1
"""Compression level of zstd. Level 3 takes a quarter longer and saves a twelfth of the bytes."""

_CODEC: Final = pa.Codec("zstd", _LEVEL)
_SKIPPED: Final = struct.Struct("<II")
"""Head of a frame that decoders of zstd skip: its magic number, and the size of what it holds."""

_MAGIC: Final = 0x184D2A50
_CHECKSUM: Final = hashlib.sha256().digest_size
_FACTS: Final = struct.Struct("<QQ16s")
"""Bytes of the frame of zstd, bytes of the stream, logical hash of the rows. The name of the table follows."""

_HEAD: Final = _SKIPPED.size + _CHECKSUM + _FACTS.size


def shard_bytes(name: str, table: pa.Table, rows_hash: str) -> bytes:
    """Encode ``table`` as a part of a shard; the parts of a shard follow each other.

    rows_hash : its logical hash, see ``factory.rows``
    """
    sink = pa.BufferOutputStream()
    with ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    stream = sink.getvalue()
    frame = _CODEC.compress(stream, asbytes=True)
    facts = _FACTS.pack(len(frame), stream.size, bytes.fromhex(rows_hash)) + name.encode()
    return b"".join((_SKIPPED.pack(_MAGIC, _CHECKSUM + len(facts)), _checksum(facts, frame), facts, frame))


def shard_table(data: bytes, name: str, where: str, rows_hash: str | None, remedy: str) -> pa.Table:
    """Decode the table called ``name`` in the shard ``data``.

    rows_hash : the logical hash that its rows must have; None where it is not known

    Raises ``CorruptShardError``, with ``remedy``, when its bytes are not those that were written, or the rows are
    others.
    """
    checksum, facts, frame = _part(memoryview(data), name.encode())
    if checksum != _checksum(facts, frame):
        raise CorruptShardError(f"the bytes of table {name!r} differ from their checksum", where=where, remedy=remedy)
    _, size, found = _FACTS.unpack_from(facts)
    if rows_hash is not None and found.hex() != rows_hash:
        raise CorruptShardError("the rows differ from the hash of their commit", where=where, remedy=remedy)
    try:
        return ipc.open_stream(_CODEC.decompress(frame, size)).read_all()
    except (pa.ArrowException, OSError, ValueError) as error:
        raise CorruptShardError(f"not a readable table: {error}", where=where, remedy=remedy) from error


def _part(view: Any, name: bytes) -> tuple[Any, Any, Any]:
    """Return (checksum, facts, frame) of a table; all of them empty where there is no such table."""
    at = 0
    while at + _HEAD <= len(view):
        magic, held = _SKIPPED.unpack_from(view, at)
        facts = view[at + _SKIPPED.size + _CHECKSUM : at + _SKIPPED.size + held]
        if magic != _MAGIC or len(facts) < _FACTS.size:
            break
        frame = at + _SKIPPED.size + held
        end = frame + _FACTS.unpack_from(facts)[0]
        if facts[_FACTS.size :] == name:
            return view[at + _SKIPPED.size : at + _SKIPPED.size + _CHECKSUM], facts, view[frame:end]
        at = end
    return b"", b"", b""


def _checksum(facts: Any, frame: Any) -> bytes:
    state = hashlib.sha256(facts)
    state.update(frame)
    return state.digest()
