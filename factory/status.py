"""The content of a store: refs and their snapshots, quarantine with causes, latest runs, drift of pinned tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from pydantic import ValidationError

from factory.chain import SharedTables
from factory.commits import Commits
from factory.index import Index
from factory.inventory import Inventory, missing_parts
from factory.pins import Pins, build_aggregate
from factory.pipeline import Pipeline
from factory.snapshot import Snapshot, read_manifest, read_ref
from factory.store import Store
from schemas.errors import CorruptShardError
from schemas.snapshot import Ref, RunRecord, SnapshotManifest
from schemas.unit import QuarantineRecord

__all__ = ["AggregateDrift", "RefStatus", "StoreStatus", "drift", "store_status"]

RUNS_SHOWN: Final = 10
"""Number of latest runs that a status lists."""


@dataclass(frozen=True)
class RefStatus:
    """One ref, and the snapshot that it names.

    manifest : None when it is missing or damaged
    damaged : what the ref names and is not there, or not whole by a listing: a line for each file, one for all units
    """

    ref: Ref
    manifest: SnapshotManifest | None
    damaged: tuple[str, ...] = ()


@dataclass(frozen=True)
class StoreStatus:
    """Summary of a store.

    quarantine : every record, by unit id
    runs : the latest first
    unpublished : names that a run published under and whose ref is missing
    files, bytes : by folder; empty unless sizes were asked for
    """

    url: str
    refs: tuple[RefStatus, ...]
    quarantine: tuple[QuarantineRecord, ...]
    runs: tuple[RunRecord, ...]
    unpublished: tuple[str, ...]
    files: Counter[str]
    bytes: Counter[str]


def store_status(store: Store, *, sizes: bool = False) -> StoreStatus:
    """Summarize a store. With ``sizes``, all its files are listed and counted, which takes long for a large store."""
    refs = []
    for entry in sorted(store.list("refs"), key=lambda entry: entry.path):
        ref, _ = read_ref(store, entry.path.split("/", 1)[1].removesuffix(".json"))
        if ref is not None:
            manifest = read_manifest(store, ref.snapshot_id)
            refs.append(RefStatus(ref, manifest, tuple(_damage(store, ref, manifest))))
    commits = Commits(store)
    records = [commits.quarantine_record(stage, key) for stage, key in commits.quarantined()]
    runs = []
    for path in sorted((entry.path for entry in store.list("runs")), reverse=True)[:RUNS_SHOWN]:
        try:
            runs.append(RunRecord.model_validate_json(store.read(path)))
        except (FileNotFoundError, ValidationError):
            continue
    files: Counter[str] = Counter()
    size: Counter[str] = Counter()
    for entry in store.list("") if sizes else ():
        kind = entry.path.split("/", 1)[0]
        files[kind] += 1
        size[kind] += entry.size
    return StoreStatus(
        url=store.url,
        refs=tuple(refs),
        quarantine=tuple(sorted((record for record in records if record), key=lambda record: record.unit_id)),
        runs=tuple(runs),
        unpublished=tuple(sorted({run.ref for run in runs if run.published} - {status.ref.name for status in refs})),
        files=files,
        bytes=size,
    )


def _damage(store: Store, ref: Ref, manifest: SnapshotManifest | None) -> Iterator[str]:
    """Yield lines about what is missing or damaged in a published state. Files of the snapshot and of units are checked
    by name and size only; the index and the pinned tables are read.
    """
    for path in missing_parts(store, ref.snapshot_id):
        yield f"{store.url}/{path} is missing or damaged"
    commits = Commits(store)
    try:
        index = Index.read(store, ref.index)
    except CorruptShardError as error:
        yield f"{error.where}: {error.what}"
    else:
        lost = len(index) - int(Inventory(commits, index).whole.sum())
        if lost:
            yield f"{store.url}/units: files of {lost} scenes are missing or cut"
    if manifest is not None:
        pins = Pins(manifest.pipeline, (), commits, ref.name, published=manifest)
        for path in (*pins.damaged, *pins.damaged_tables()):
            yield f"{store.url}/{path} is missing or damaged"


@dataclass(frozen=True)
class AggregateDrift:
    """Difference between a pinned aggregate and one built from the units published now.

    rows, rows_now : of the pinned table, and of the one built now
    differing : rows that are in only one of the two (each counted)
    units, units_now : how many units it was built from
    """

    name: str
    rows: int
    rows_now: int
    differing: int
    units: int
    units_now: int


def drift(pipeline: Pipeline, store: Store, ref: str = "main") -> tuple[AggregateDrift, ...]:
    """Build the aggregates of ``ref`` over its published units and compare them with the pinned ones.

    Raises ``StoreError`` when nothing is published, ``CorruptShardError`` when a unit's files are damaged.
    """
    commits = Commits(store)
    pins = Pins(pipeline.name, pipeline.aggregates, commits, ref)
    index = Snapshot.open(store, ref).index
    shared = SharedTables(commits, pins.hashes())
    found = []
    for aggregate in pipeline.aggregates:
        pinned = pins.pin.tables.get(aggregate.name)
        if pinned is None or aggregate.name not in shared.hashes:
            continue
        now, units = build_aggregate(aggregate, commits, index.receipts(pipeline))
        before = shared.of((aggregate.name,))[aggregate.name]
        one = Counter(map(repr, before.to_pylist()))
        two = Counter(map(repr, now.to_pylist()))
        differing = sum(((one - two) + (two - one)).values())
        found.append(AggregateDrift(aggregate.name, before.num_rows, now.num_rows, differing, pinned.units, units))
    return tuple(found)
