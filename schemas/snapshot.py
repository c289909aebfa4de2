"""What the store publishes: a snapshot's manifest, the ref that names it, and the pins of shared tables."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from schemas.base import Document, Finite, VersionedDocument
from schemas.unit import Hash32, Hash64

__all__ = [
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

Count = Annotated[int, Field(ge=0)]


class PartRecord(Document):
    """One Parquet file of a snapshot."""

    path: str
    """Relative to the snapshot's folder."""
    rows: Count
    bytes: Count
    sha256: Hash64
    content: Hash32
    """Hash of what went in (rows, schema, writer's settings): an equal one is carried over, not written again."""


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
    """What a stage cost over all units of the snapshot (as recorded when each was made)."""

    version: int
    units: Count
    skipped: Count
    seconds: Annotated[Finite, Field(ge=0)]
    peak_rss: Count
    rows: Count
    bytes: Count


class PinnedTable(Document):
    """A shared table that stays the same until it is renewed on demand, or its version or parameters change."""

    version: int
    hash: Hash32
    rows: Count
    units: Count
    """How many units it was built from."""
    parameters: str = ""
    """SHA-256 of the parameters it was built with, as canonical JSON; empty in pins from before they were kept."""
    generation: Count = 0
    """Counts the times it was pinned: of two pins the later one holds."""


class SharedRecord(PinnedTable):
    """A shared table that the rows of a snapshot were made with, and the snapshot's own copy of it.

    It can't be computed again once there are more units; from here its pin and its table are restored.
    """

    path: str
    """Relative to the snapshot's folder."""
    bytes: Count
    sha256: Hash64


class SnapshotManifest(VersionedDocument):
    """``snapshots/<id>/manifest.json``, written last: readers list a snapshot's files from here, never by a glob."""

    snapshot_id: Hash32
    pipeline: str
    tables: dict[str, TableManifest]
    units: dict[str, Count]
    """Units per status: ok, skipped, quarantined."""
    aggregates: dict[str, Hash32]
    shared: dict[str, SharedRecord] = Field(default_factory=dict)
    """The shared tables behind ``aggregates``, by name; empty in manifests from before copies were kept."""
    stages: dict[str, StageTotals]
    provenance: dict[str, str]
    """Recorded, never keyed: git revision, versions of libraries."""
    checksum: Hash64 | None = None
    """SHA-256 of the rest as canonical JSON; None in documents from before there was one."""

    def files(self) -> Iterator[PartRecord | SharedRecord]:
        """Every file of the snapshot but this manifest; paths are relative to the snapshot's folder."""
        for table in self.tables.values():
            for partition in table.partitions.values():
                yield from partition.parts
        yield from self.shared.values()


class Published(Document):
    """One state of a ref."""

    snapshot_id: Hash32
    index: Hash32
    """The unit index it was published from: ``indexes/<hash>.parquet``."""
    generation: Annotated[int, Field(ge=1)]
    published_at: str = ""
    """UTC, ISO 8601."""


class Ref(Published, VersionedDocument):
    """``refs/<name>.json``: the one mutable file. Moving it is what publishes."""

    name: str
    history: list[Published] = Field(default_factory=list)
    """Earlier states, the newest first, one for each snapshot; as far back as is kept."""
    checksum: Hash64 | None = None
    """SHA-256 of the rest as canonical JSON; None in documents from before there was one."""

    @property
    def previous(self) -> str | None:
        """The snapshot published before this one."""
        return self.history[0].snapshot_id if self.history else None


class RunFailure(Document):
    """A unit that a run quarantined, in short; the quarantine has the whole record."""

    unit_id: str
    stage: str
    key: Hash32
    cause: str
    exception: str
    message: str
    attempts: Annotated[int, Field(ge=1)] = 1


class RunRecord(VersionedDocument):
    """``runs/<started>-<token>.json``: the end of one run that found something to do."""

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
    """Stages made, by name."""
    stage_seconds: dict[str, Annotated[Finite, Field(ge=0)]]
    peak_rss: Count
    failures: list[RunFailure]
    message: str = ""
    host: str = ""
    revision: str = ""


class Pin(VersionedDocument):
    """``pins/<pipeline>/<ref>.json``: the shared tables that the units of a ref are keyed on."""

    tables: dict[str, PinnedTable]
    checksum: Hash64 | None = None
    """SHA-256 of the rest as canonical JSON; None in documents from before there was one."""
