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
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

from pydantic import ValidationError

from factory.index import Index, failed_keys
from factory.snapshot import manifest_path, read_manifest, read_ref
from factory.store import Entry, LocalStore, Store
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
    snapshots.

    unreadable : indexes and manifests of kept states that are gone or damaged: because of them no unit went
    """

    files: Counter[str] = field(default_factory=Counter)
    bytes: Counter[str] = field(default_factory=Counter)
    kept: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    unreadable: tuple[str, ...] = ()


def sweep(store: Store, *, keep: int = 3, grace: float = GRACE_SECONDS, now: float | None = None) -> SweepReport:
    """Remove what no ref needs.

    keep : snapshots kept for each ref, the published one included (at least 1)
    grace : seconds for which whatever was written stays, needed or not
    now : seconds since 1970; the clock by default
    """
    before = (time.time() if now is None else now) - grace
    live, unreadable = _live(store, max(keep, 1))
    kept = sorted(name for kind, name in live if kind == "snapshots")
    report = SweepReport(kept=tuple(kept), unreadable=tuple(unreadable))
    gone = set()
    for kind in _KINDS:
        for folder, entries in _whole(store, kind, before):
            if (kind, folder) in live or (unreadable and kind in ("units", "aggregates", "quarantine")):
                continue
            if kind == "units" and folder.count("/") < 2:  # where no unit stands: a person put it there
                continue
            if kind == "snapshots":
                # Someone may have published it again since we looked, or be about to: its manifest is young then.
                if (
                    any(entry.modified >= before for entry in store.list(f"snapshots/{folder}"))
                    or (kind, folder) in _live(store, max(keep, 1))[0]
                ):
                    continue
                gone.add(folder)
            for entry in entries:
                report.files[kind] += 1
                report.bytes[kind] += entry.size
                store.delete(entry.path)
    report.removed = tuple(sorted(gone))
    if isinstance(store, LocalStore):
        _unfinished(store, before, report)
    return report


def _unfinished(store: LocalStore, before: float, report: SweepReport) -> None:
    for path in [*store.unfinished()]:
        with suppress(FileNotFoundError):  # it was finished meanwhile
            stat = path.stat()
            if stat.st_mtime < before:
                report.files["unfinished"] += 1
                report.bytes["unfinished"] += stat.st_size
                path.unlink()


def _live(store: Store, keep: int) -> tuple[set[tuple[str, str]], list[str]]:
    """Return (kind, name) of everything that is kept, named as ``_whole`` does, and the paths of indexes and manifests
    that can't be read.
    """
    live = {(kind, name) for kind in ("runs", "logs") for name in _latest(store, kind)}
    unreadable = []
    states: list[Published] = []
    for entry in store.list("refs"):
        ref, _ = read_ref(store, entry.path.split("/")[1].removesuffix(".json"))
        if ref is not None:
            states += [ref, *ref.history][:keep]
    for state in states:
        live |= {("snapshots", state.snapshot_id), ("indexes", f"{state.index}.parquet")}
        try:
            index = Index.read(store, state.index)
            live |= {("units", f"{stage}/{key[:2]}/{key}") for stage, key in index.stage_keys()}
            live |= {("quarantine", f"{stage}/{key}.json") for stage, key in failed_keys(index)}
        except CorruptShardError:
            unreadable.append(Index.path(state.index))
        manifest = read_manifest(store, state.snapshot_id)
        if manifest is not None:
            live |= {("aggregates", f"{name}/{found}.parquet") for name, found in manifest.aggregates.items()}
        else:
            unreadable.append(manifest_path(state.snapshot_id))
    for entry in store.list("pins"):
        with suppress(FileNotFoundError, ValidationError):
            pin = Pin.model_validate_json(store.read(entry.path))
            live |= {("aggregates", f"{name}/{pinned.hash}.parquet") for name, pinned in pin.tables.items()}
    return live, unreadable


def _latest(store: Store, kind: str) -> list[str]:
    """Return the names of the files of the latest runs in the folder ``kind``. Sorting by name finds them, since each
    name begins with the start time of its run.
    """
    return sorted(entry.path.split("/")[1] for entry in store.list(kind))[-RUNS_KEPT:]


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
