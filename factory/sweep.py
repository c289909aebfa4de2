"""Garbage collection: removes what no ref needs, after a grace period.

Kept for each ref are its snapshot and the ones before it, ``keep`` in all, with their unit indexes, the units that
these list, the shared tables they were made with or that are pinned, and the quarantine of what they list; and the
records of the latest runs. Everything else that was last written before the grace period goes; a unit is unmade from
its ``unit.json``, a snapshot from its manifest, so that nobody takes what is left for whole. Should a run be using an
old unit at that very moment, it finds the unit damaged and makes it again. Where the index or the manifest of a kept
state can't be read, nobody knows what it needs, and no unit goes.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from pydantic import ValidationError

from factory.index import Index, failed_keys
from factory.local_store import LocalStore
from factory.scratch import BatchedTable, batches
from factory.snapshot import manifest_path, read_manifest, read_ref
from factory.store import Entry, Store
from schemas.errors import CorruptShardError
from schemas.snapshot import Pin, Published

__all__ = ["GRACE_SECONDS", "SweepReport", "sweep"]

GRACE_SECONDS: Final = 24 * 3600.0
"""Seconds for which the commits of a killed run are kept: such a run is commonly started again within a day."""

RUNS_KEPT: Final = 200
"""Number of records of runs, and their logs, that are kept; each has some kilobytes."""

_KINDS: Final = ("snapshots", "indexes", "units", "aggregates", "quarantine", "runs", "logs")


@dataclass
class SweepReport:
    """The result of a sweep: number and bytes of the removed files by folder, and the ids of the kept and the removed
    snapshots. After a dry run, "removed" means what a sweep would remove.

    unreadable : indexes and manifests of kept states that are gone or damaged: because of them no unit went
    """

    files: Counter[str] = field(default_factory=Counter)
    bytes: Counter[str] = field(default_factory=Counter)
    kept: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    unreadable: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Live:
    snapshots: frozenset[str]
    indexes: frozenset[str]
    units: frozenset[tuple[str, str]]
    aggregates: frozenset[tuple[str, str]]
    quarantine: frozenset[tuple[str, str]]
    runs: frozenset[str]
    logs: frozenset[str]
    unreadable: tuple[str, ...]


def sweep(
    store: Store, *, keep: int = 3, grace: float = GRACE_SECONDS, dry_run: bool = False, now: float | None = None
) -> SweepReport:
    """Remove what no ref needs.

    keep : snapshots kept for each ref, the published one included (at least 1)
    grace : seconds for which whatever was written stays, needed or not
    dry_run : only tell
    now : seconds since 1970; the clock by default
    """
    before = (time.time() if now is None else now) - grace
    live = _live(store, max(keep, 1))
    report = SweepReport(kept=tuple(sorted(live.snapshots)), unreadable=live.unreadable)
    gone = set()
    for kind in _KINDS:
        for folder, entries in _whole(store, kind, before):
            if _is_live(kind, folder, live):
                continue
            if kind == "snapshots":
                # Someone may have published it again since we looked, or be about to: its manifest is young then.
                if not dry_run and (
                    any(entry.modified >= before for entry in store.list(f"snapshots/{folder}"))
                    or folder in _live(store, max(keep, 1)).snapshots
                ):
                    continue
                gone.add(folder)
            for entry in entries:
                report.files[kind] += 1
                report.bytes[kind] += entry.size
                if not dry_run:
                    store.delete(entry.path)
    report.removed = tuple(sorted(gone))
    if isinstance(store, LocalStore):
        _unfinished(store, before, dry_run, report)
    return report


def _unfinished(store: LocalStore, before: float, dry_run: bool, report: SweepReport) -> None:
    for path in [*store.unfinished()]:
        try:
            stat = path.stat()
            if stat.st_mtime < before:
                report.files["unfinished"] += 1
                report.bytes["unfinished"] += stat.st_size
                if not dry_run:
                    path.unlink()
        except FileNotFoundError:
            continue


def _live(store: Store, keep: int) -> _Live:
    states: list[Published] = []
    for entry in store.list("refs"):
        ref, _ = read_ref(store, entry.path.split("/")[1].removesuffix(".json"))
        if ref is not None:
            states += [ref, *ref.history][:keep]
    units: set[tuple[str, str]] = set()
    quarantine: set[tuple[str, str]] = set()
    aggregates: set[tuple[str, str]] = set()
    unreadable = []
    for state in states:
        try:
            index = Index.read(store, state.index).rows
            units |= {*_keys(index)}
            quarantine |= failed_keys(index)
        except CorruptShardError:
            unreadable.append(Index.path(state.index))
        manifest = read_manifest(store, state.snapshot_id)
        if manifest is not None:
            aggregates |= {*manifest.aggregates.items()}
        else:
            unreadable.append(manifest_path(state.snapshot_id))
    for entry in store.list("pins"):
        try:
            pin = Pin.model_validate_json(store.read(entry.path))
        except (FileNotFoundError, ValidationError):
            continue
        aggregates |= {(name, pinned.hash) for name, pinned in pin.tables.items()}
    return _Live(
        snapshots=frozenset(state.snapshot_id for state in states),
        indexes=frozenset(state.index for state in states),
        units=frozenset(units),
        aggregates=frozenset(aggregates),
        quarantine=frozenset(quarantine),
        runs=_latest(store, "runs"),
        logs=_latest(store, "logs"),
        unreadable=tuple(unreadable),
    )


def _latest(store: Store, kind: str) -> frozenset[str]:
    """Return the names of the files of the latest runs in the folder ``kind``. Sorting by name finds them, since each
    name begins with the start time of its run.
    """
    return frozenset(sorted(entry.path.split("/")[1] for entry in store.list(kind))[-RUNS_KEPT:])


def _keys(index: BatchedTable) -> Iterator[tuple[str, str]]:
    for name in index.schema.names:
        stage, _, last = name.rpartition(".")
        if last == "key" and stage != "failure":
            for _, batch in batches(index, [name]):
                for key in batch.column(0).drop_null().to_pylist():
                    yield stage, key.hex()


def _whole(store: Store, kind: str, before: float) -> Iterator[tuple[str, list[Entry]]]:
    """Yield (name, files) of every unit or snapshot whose files are all older than ``before``. The first of ``files``
    is the commit file (``unit.json`` or ``manifest.json``).
    """
    groups: dict[str, list[Entry]] = {}
    for entry in store.list(kind):
        parts = entry.path.split("/")
        name = {"snapshots": parts[1], "units": "/".join(parts[1:4])}.get(kind, "/".join(parts[1:]))
        groups.setdefault(name, []).append(entry)
    for name, entries in groups.items():
        if max(entry.modified for entry in entries) < before:
            entries.sort(key=lambda entry: not entry.path.endswith(("/unit.json", "/manifest.json")))
            yield name, entries


def _is_live(kind: str, name: str, live: _Live) -> bool:
    parts = name.split("/")
    if kind == "snapshots":
        return name in live.snapshots
    if kind == "indexes":
        return name.removesuffix(".parquet") in live.indexes
    if live.unreadable and kind in ("units", "aggregates", "quarantine"):
        return True
    if kind == "units":
        # What stands elsewhere than a unit does was put there by hand.
        return len(parts) < 3 or (parts[0], parts[2]) in live.units
    if kind in ("aggregates", "quarantine"):
        stem = parts[-1].rsplit(".", 1)[0]
        return (parts[0], stem) in (live.aggregates if kind == "aggregates" else live.quarantine)
    return name in (live.runs if kind == "runs" else live.logs)
