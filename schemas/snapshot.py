"""Documents of the store: a snapshot's manifest, the ref that names it, and the pins of shared tables."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Final, Literal

from pydantic import Field

from schemas.base import Document, Finite, VersionedDocument
from schemas.unit import Hash32, Hash64

__all__ = [
    "STORE_VERSION",
    "PartRecord",
    "PartitionRecord",
    "Pin",
    "PinnedTable",
    "Published",
    "Ref",
    "RunFailure",
    "RunRecord",
    "SharedRecord",
    "SnapshotManifest",
    "StageTotals",
    "TableManifest",
]

STORE_VERSION: Final = 2
"""Version of the layout of stores. Version 1, which releases before 1.0 wrote, had frames of Arrow in place of Parquet
files of units, and its refs say no version."""

Count = Annotated[int, Field(ge=0)]


class PartRecord(Document):
    """One Parquet file of a snapshot."""

    path: str
    """Path relative to the snapshot's folder."""
    rows: Count
    bytes: Count
    sha256: Hash64
    content: Hash32
    """Hash of the inputs (rows, schema, writer's settings). A file with an equal hash is reused instead of written
    again."""


class PartitionRecord(Document):
    """One partition of one table."""

    rows: Count
    logical_hash: Hash32
    parts: list[PartRecord]


class TableManifest(Document):
    """One published table."""

    stages: list[str]
    columns: list[str]
    sort_keys: list[str]
    rows: Count
    partitions: dict[str, PartitionRecord]


class StageTotals(Document):
    """Cost of a stage over all units of the snapshot, as recorded when each unit was processed."""

    version: int
    units: Count
    skipped: Count
    seconds: Annotated[Finite, Field(ge=0)]
    peak_rss: Count
    rows: Count
    bytes: Count


class PinnedTable(Document):
    """A shared table that is reused until it is renewed on demand, or until its version or its parameters change."""

    version: int
    hash: Hash32
    rows: Count
    units: Count
    """Number of units that the table was built from."""
    parameters: str = ""
    """SHA-256 of the parameters as canonical JSON."""
    generation: Count = 0
    """Number of times that the table was pinned. Of two pins, the one with the larger number is valid."""


class SharedRecord(PinnedTable):
    """A shared table that the rows of a snapshot depend on, and the snapshot's own copy of it.

    It can't be computed again once there are more units; from here its pin and its table are restored.
    """

    path: str
    """Path relative to the snapshot's folder."""
    bytes: Count
    sha256: Hash64


class SnapshotManifest(VersionedDocument):
    """``snapshots/<id>/manifest.json``, written last. Readers take a snapshot's files from it and never list the
    folder."""

    snapshot_id: Hash32
    pipeline: str
    tables: dict[str, TableManifest]
    units: dict[str, Count]
    """Units per status: ok, skipped, quarantined."""
    aggregates: dict[str, Hash32]
    shared: dict[str, SharedRecord] = Field(default_factory=dict)
    """The shared tables behind ``aggregates``, by name."""
    stages: dict[str, StageTotals]
    provenance: dict[str, str]
    """Git revision and versions of libraries. They are recorded, but are not part of any key."""
    checksum: Hash64 | None = None
    """SHA-256 of the rest as canonical JSON; None until the document is written."""

    def files(self) -> Iterator[PartRecord | SharedRecord]:
        """Return every file of the snapshot except this manifest; paths are relative to the snapshot's folder."""
        for table in self.tables.values():
            for partition in table.partitions.values():
                yield from partition.parts
        yield from self.shared.values()


class Published(Document):
    """One published state of a ref."""

    snapshot_id: Hash32
    index: Hash32
    """The unit index that the snapshot was published from: ``indexes/<hash>.parquet``."""
    generation: Annotated[int, Field(ge=1)]
    published_at: str = ""
    """Time of publication, UTC, ISO 8601."""


class Ref(Published, VersionedDocument):
    """``refs/<name>.json``, the only mutable file. Replacing it publishes a snapshot."""

    name: str
    store_version: Literal[2]
    """Version of the layout of the store. A store of another version is refused."""
    history: list[Published] = Field(default_factory=list)
    """Earlier states, one per snapshot, the newest first. Old ones are dropped."""
    checksum: Hash64 | None = None
    """SHA-256 of the rest as canonical JSON; None until the document is written."""


class RunFailure(Document):
    """Short record of a unit that a run quarantined; the quarantine holds the full record."""

    unit_id: str
    stage: str
    key: Hash32
    cause: str
    exception: str
    message: str
    attempts: Annotated[int, Field(ge=1)] = 1


class RunRecord(VersionedDocument):
    """``runs/<started>-<token>.json``: record of one finished run that had work to do."""

    token: str
    pipeline: str
    ref: str
    executor: str
    started_at: str
    seconds: Annotated[Finite, Field(ge=0)]
    exit_code: int
    snapshot_id: Hash32 | None
    published: bool
    counts: dict[str, Count]
    stages: dict[str, Count]
    """Number of stages that were run, by name."""
    stage_seconds: dict[str, Annotated[Finite, Field(ge=0)]]
    peak_rss: Count
    failures: list[RunFailure]
    message: str = ""
    host: str = ""
    revision: str = ""


class Pin(VersionedDocument):
    """``pins/<pipeline>/<ref>.json``: the shared tables whose hashes enter the keys of a ref's units."""

    tables: dict[str, PinnedTable]
    checksum: Hash64 | None = None
    """SHA-256 of the rest as canonical JSON; None until the document is written."""
