"""Find out by names and sizes which files of a published state exist: the files of the units and of the snapshot.

A ref names a snapshot and a unit index; what these name must be in the store. A unit whose files are missing or cut is
made again, a missing file of the snapshot is packed again. Bytes that changed while a file's size stayed are found
where the file is read, and by a run with ``verify``.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import numpy.typing as npt

from factory.commits import UNIT_FILE, Commits
from factory.index import Index
from factory.snapshot import manifest_path, read_manifest, read_ref
from factory.store import Store

__all__ = ["Inventory", "glance", "missing_parts"]


class Inventory:
    """Compares the units of an index with the files of the store.

    On disk it takes one listing of each unit's folder, on an object store one request for a thousand files.

    whole : (n,) for each row of the index whether every stage of the unit is there with the bytes it was committed with
    """

    def __init__(self, commits: Commits, index: Index) -> None:
        self._lost: dict[str, npt.NDArray[np.bool_]] = {}
        self.whole = np.ones(len(index), bool)
        for stage in index.stages:
            self._lost[stage] = _lost(commits, index, stage)
            self.whole &= ~self._lost[stage]

    def lost(self, stage: str, row: int) -> bool:
        """Whether files that this stage made for the unit in ``row`` are missing or truncated."""
        return stage in self._lost and bool(self._lost[stage][row])


def _lost(commits: Commits, index: Index, stage: str) -> npt.NDArray[np.bool_]:
    """Return for each row of ``index`` whether any file that the stage made for the row's unit is missing or
    truncated.
    """
    lost = np.zeros(len(index), bool)
    keys = index.table.column(f"{stage}.key").to_pylist()
    if not any(keys):
        return lost
    sizes = index.table.column(f"{stage}.stored").to_pylist()
    there = _unit_sizes(commits.store, stage)
    for row, (key, stored) in enumerate(zip(keys, sizes, strict=True)):
        if key is None or there.get(key.hex()) == stored:
            continue
        # Another size may be due to a file that a person put there: the commit itself decides.
        lost[row] = key.hex() not in there or commits.find(stage, key.hex(), discard=False) is None
    return lost


def _unit_sizes(store: Store, stage: str) -> dict[str, int]:
    """Return the total bytes of all files of every committed unit of a stage, by key."""
    sizes: Counter[str] = Counter()
    committed = set()
    for entry in store.list(f"units/{stage}"):
        folder, _, name = entry.path.rpartition("/")
        sizes[folder] += entry.size
        if name == UNIT_FILE:
            committed.add(folder)
    return {folder.rpartition("/")[2]: sizes[folder] for folder in committed}


def missing_parts(store: Store, snapshot_id: str) -> list[str]:
    """Return the paths of a snapshot's files that are missing or differ in size from its manifest. If the manifest
    can't be read, return only the manifest's path.
    """
    manifest = read_manifest(store, snapshot_id)
    if manifest is None:
        return [manifest_path(snapshot_id)]
    folder = f"snapshots/{snapshot_id}"
    there = {entry.path: entry.size for entry in store.list(folder)}
    sizes = {f"{folder}/{file.path}": file.bytes for file in manifest.files()}
    return [path for path, size in sorted(sizes.items()) if there.get(path) != size]


def glance(store: Store, ref: str) -> list[Any]:
    """Return a cheap fingerprint of everything that a ref names. Equal fingerprints mean that nothing was added,
    removed or rewritten.

    Covered are the ref, the snapshot's files, the index, the pins and their tables, each by size and time; and on disk
    the files of the units, by size. On an object store units are left to the next plan: listing them takes a request
    for a thousand files.
    """
    found, token = read_ref(store, ref)
    if found is None:
        return [token]
    folders = (f"snapshots/{found.snapshot_id}", "pins", "aggregates")
    listed = [[e.path, e.size, e.modified] for folder in folders for e in store.list(folder)]
    listed += [[e.path, e.size, e.modified] for e in store.list("indexes") if e.path == Index.path(found.index)]
    units = [[e.path, e.size] for e in store.list("units")] if store.local_path("units") else []
    return [token, read_manifest(store, found.snapshot_id) is not None, sorted(listed), sorted(units)]
