"""Documents that the store keeps for one stage of one unit: its commit, or the reason why it failed.

``unit.json`` is written last of a unit's files, so its presence means that all the others are there and whole.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from schemas.base import Document, Finite, VersionedDocument

__all__ = ["Cause", "FileRecord", "KeyParts", "QuarantineRecord", "TableRecord", "UnitCommit"]

Hash32 = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
"""128 bits as hexadecimal digits: keys and logical hashes."""

Hash64 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
"""SHA-256 of a file's bytes."""

FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.\-]{0,127}$")]
"""A plain file name: no folders, no leading dot."""

Cause = Literal["input", "error", "deadline", "memory", "worker"]
"""Why a unit is quarantined: unreadable input, an exception, its deadline, its memory, or the death of its worker."""


class KeyParts(Document):
    """Hashes of the parts of a key. A plan reports the part that changed as the reason why a unit is stale."""

    code: Hash32
    inputs: Hash32
    parameters: Hash32
    dependencies: Hash32


class FileRecord(Document):
    """One file of a unit."""

    sha256: Hash64
    bytes: Annotated[int, Field(ge=0)]


class TableRecord(FileRecord):
    """One table of a unit, ``<table>.parquet``, and a hash of its rows that does not depend on the encoding."""

    logical_hash: Hash32
    rows: Annotated[int, Field(ge=0)]
    logical_bytes: Annotated[int, Field(ge=0)]
    """Size of the canonical buffers, bytes. Packing uses it because file sizes depend on the version of the writer."""


class UnitCommit(VersionedDocument):
    """``unit.json``: the commit of one stage of one unit."""

    unit_id: str
    partition: str
    stage: str
    stage_version: int
    key: Hash32
    key_parts: KeyParts
    outcome: Literal["ok", "skipped"]
    reason: str = ""
    tables: dict[FileName, TableRecord]
    files: dict[FileName, FileRecord]
    measures: dict[str, Finite]
    seconds: Annotated[float, Field(ge=0)]
    """Wall-clock seconds."""
    cpu_seconds: Annotated[float, Field(ge=0)] = 0.0
    """CPU seconds of the process, from which the cost model learns."""
    peak_rss: Annotated[int, Field(ge=0)]
    host: str
    libraries: dict[str, str]
    revision: str = ""
    checksum: Hash64 | None = None
    """SHA-256 of the rest as canonical JSON; None until the document is written."""


class QuarantineRecord(VersionedDocument):
    """``quarantine/<stage>/<key>.json``: why a unit failed. The unit is retried when its key changes, or on demand."""

    unit_id: str
    partition: str
    stage: str
    key: Hash32
    cause: Cause
    exception: str
    message: str
    traceback: str = ""
    attempts: Annotated[int, Field(ge=1)] = 1
    peak_rss: Annotated[int, Field(ge=0)] = 0
    host: str = ""
    revision: str = ""
    run: str = ""
    """Token of the run that recorded the failure."""
    recorded_at: str = ""
    """Time of the record, UTC, ISO 8601."""
