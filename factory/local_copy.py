"""Find a published snapshot on this machine's disk: in the store's own folder, or in a copy if the store is elsewhere.

Readers that want files (DuckDB, an export) get them here whatever the store is, and each file as it was published: its
hash is compared with the manifest, once for each size and time that the file has. A copy is laid out as the original,
and a file that is there already is not fetched again.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Final

from factory.commits import REBUILD_VERIFIED
from factory.files import FileHashes
from factory.local_store import LocalStore
from factory.snapshot import Snapshot
from schemas.errors import CorruptShardError, MissingFileError
from schemas.snapshot import PartRecord

__all__ = ["COPIES_KEPT", "local_copy"]

FETCHERS: Final = 4
"""Number of files that are fetched at once: each may take some tens of megabytes of memory."""

COPIES_KEPT: Final = 3
"""Number of copies of snapshots that are kept, the requested one included. Others are removed after a day without
use."""

IDLE_SECONDS: Final = 24 * 3600.0


def local_copy(
    snapshot: Snapshot, cache: Path, tables: Iterable[str] | None = None, hashes: FileHashes | None = None
) -> Path:
    """Return the folder of ``snapshot`` on this disk, with ``<table>/source=<partition>/part-*.parquet`` below it.

    cache : where copies of snapshots stand, in ``snapshots/<id>``; not touched when the store itself is on this disk
    tables : those that are needed; all by default
    hashes : memory of the files' hashes; without one every file is read

    Raises ``CorruptShardError`` when a file is missing or differs from the manifest.
    """
    hashes = hashes or FileHashes()
    manifest = snapshot.manifest
    wanted = manifest.tables if tables is None else [name for name in manifest.tables if name in set(tables)]
    parts = [
        part for name in wanted for partition in manifest.tables[name].partitions.values() for part in partition.parts
    ]
    folder = f"snapshots/{snapshot.snapshot_id}"
    own = snapshot.store.local_path(folder)
    if own is not None:
        for part in parts:
            snapshot.store.local_path(f"{folder}/{part.path}")  # a path that leads out of the folder ends here
            try:
                found = hashes.file(own, part.path)
            except MissingFileError as error:
                raise CorruptShardError(
                    "a published file is missing", where=own / part.path, remedy=REBUILD_VERIFIED
                ) from error
            if found.sha256 != part.sha256:
                raise CorruptShardError(
                    "the file differs from the manifest", where=own / part.path, remedy=REBUILD_VERIFIED
                )
        hashes.save()
        return own
    copies = LocalStore(cache, durable=False)

    def fetch(part: PartRecord) -> None:
        path = f"{folder}/{part.path}"
        copies.local_path(path)  # a manifest's path that leads out of the folder ends here
        with suppress(MissingFileError):
            if hashes.file(cache, path).sha256 == part.sha256:
                return
        try:
            data = snapshot.store.read(path)
        except FileNotFoundError as error:
            raise CorruptShardError(
                "a published file is missing", where=f"{snapshot.store.url}/{path}", remedy=REBUILD_VERIFIED
            ) from error
        if hashlib.sha256(data).hexdigest() != part.sha256:
            raise CorruptShardError(
                "the file differs from the manifest", where=f"{snapshot.store.url}/{path}", remedy=REBUILD_VERIFIED
            )
        copies.write(path, data)

    with ThreadPoolExecutor(FETCHERS) as pool:
        for _ in pool.map(fetch, parts):
            pass
    hashes.save()
    copies.write(f"{folder}/manifest.json", manifest.model_dump_json(indent=1).encode())
    _forget(cache / "snapshots", snapshot.snapshot_id)
    return cache / folder


def _forget(folder: Path, used: str) -> None:
    """Remove copies of snapshots that were not used recently."""

    def last_use(copy: Path) -> float:
        try:
            return (copy / "manifest.json").stat().st_mtime
        except OSError:
            return 0.0

    others = sorted((copy for copy in folder.iterdir() if copy.name != used), key=last_use, reverse=True)
    for copy in others[COPIES_KEPT - 1 :]:
        if time.time() - max(last_use(copy), os.stat(copy).st_mtime) > IDLE_SECONDS:
            shutil.rmtree(copy, ignore_errors=True)
