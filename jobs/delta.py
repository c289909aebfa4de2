"""``condvln delta``: the published tables as Delta tables, by their logs alone."""

from __future__ import annotations

import calendar
import time
from pathlib import Path
from typing import Final

from factory.address import open_store
from factory.delta import write_delta
from factory.snapshot import Snapshot, read_ref
from factory.store import Store
from jobs.report import Report, Section
from jobs.target import Target
from schemas.errors import UsageError
from schemas.tables import TABLES

__all__ = ["export_delta"]

_OWN: Final = ("aggregates", "indexes", "logs", "pins", "probe", "quarantine", "refs", "runs", "snapshots", "units")
"""Folders of a store, in which nobody else writes."""


def export_delta(target: Target, address: str) -> Report:
    """Make the newest version of the Delta tables at `address` (a folder, or s3://…) what is published.

    Raises UsageError on a place where logs can't stand, StoreError when nothing is published.
    """
    snapshot = target.snapshot()
    ref = target.ref()
    folder = open_store(address)
    _refuse(snapshot.store, folder)
    published = _published(snapshot, ref)
    found = write_delta(snapshot, folder, ref=ref, milliseconds=published, schemas=TABLES)
    written = sum(version.written for version in found)
    state = f"{written} of {len(found)} tables have a new version" if written else "it was there already"
    columns = ("table", "version", "rows", "files", "added", "removed")
    return Report(
        {
            "snapshot_id": snapshot.snapshot_id,
            "delta": folder.url,
            "written": written,
            "tables": {version.table: {c: getattr(version, c) for c in columns[1:]} for version in found},
        },
        [f"snapshot {snapshot.snapshot_id} as Delta tables in {folder.url}: {state}"],
        [Section("Delta tables", columns, [[getattr(version, c) for c in columns] for version in found])],
    )


def _published(snapshot: Snapshot, name: str) -> int:
    """Milliseconds since 1970 at which the ref moved to the snapshot; 0 where the store doesn't know."""
    ref, _ = read_ref(snapshot.store, name)
    states = [ref, *ref.history] if ref is not None else []
    at = next((state.published_at for state in states if state.snapshot_id == snapshot.snapshot_id), "")
    try:
        return calendar.timegm(time.strptime(at, "%Y-%m-%dT%H:%M:%SZ")) * 1000
    except ValueError:
        return 0


def _refuse(store: Store, folder: Store) -> None:
    """Logs stand beside what the store keeps, or elsewhere."""
    local = store.local_path("snapshots"), folder.local_path("snapshots")
    if local[0] is not None and local[1] is None:
        raise UsageError(
            "the published files are on this machine's disk, where readers of a bucket don't find them",
            where=folder.url,
            remedy="Name a folder.",
        )
    if local[0] is not None and local[1] is not None:
        root, place = (str(Path(path).parent.resolve()) for path in (local[0], local[1]))
    else:
        root, place = store.url, folder.url
    inside = place == root or any(f"{place}/".startswith(f"{root}/{name}/") for name in _OWN)
    if inside:
        raise UsageError(
            "the store keeps its own files there", where=place, remedy=f"Name a folder of its own, say {root}/delta."
        )
