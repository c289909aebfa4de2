"""Find out by names and sizes which files of a published state exist: the files of the units and of the snapshot.

A ref names a snapshot and a unit index; what these name must be in the store. A unit whose files are missing or cut is
made again, a missing file of the snapshot is packed again. Bytes that changed while a file's size stayed are found
where the file is read, and by a run with ``verify``.
"""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Iterator
from itertools import islice
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factory.commits import UNIT_FILE, Commits
from factory.flags import Flags
from factory.index import Index
from factory.scratch import batches
from factory.snapshot import manifest_path, read_manifest, read_ref
from factory.store import Store
from factory.temporary import close_files, temporary_space

__all__ = ["Inventory", "glance", "missing_parts"]

_BATCH: Final = 2048
"""Number of folders that are compared with the index at a time."""

SHARES: Final = 64
"""Number of shares into which keys are divided to be compared."""

_UNWRITTEN: Final = 1 << 13
"""Bytes of a share up to which it never touches the disk."""

_ROW: Final = [("high", "<u8"), ("low", "<u8"), ("row", "<i8"), ("stored", "<i8")]
_FOLDER: Final = [("high", "<u8"), ("low", "<u8"), ("bytes", "<i8")]

FOLDERS_LOOKED_INTO: Final = 10_000
"""Number of unit folders up to which a glance lists every file (about 0.2 s). Beyond, it looks only at their parent
folders."""


class Inventory:
    """Compares the units of an index with the files of the store.

    On disk it takes one listing of each unit's folder, on an object store one request for a thousand files.

    whole : for each row of the index whether every stage of the unit is there with the bytes it was committed with
    """

    def __init__(self, commits: Commits, index: Index) -> None:
        self._lost: dict[str, Flags] = {}
        self.whole = Flags(len(index), True)
        if not len(index):
            return
        for name in index.rows.schema.names:
            stage, _, last = name.rpartition(".")
            if last == "key" and stage != "failure":
                self._lost[stage] = _lost(commits, index, stage)
                self.whole.without(self._lost[stage])

    def lost(self, stage: str, row: int) -> bool:
        """Whether files that this stage made for the unit in ``row`` are missing or truncated."""
        return stage in self._lost and self._lost[stage][row]


def _lost(commits: Commits, index: Index, stage: str) -> Flags:
    """Return for each row of ``index`` whether any file that the stage made for the row's unit is missing or
    truncated.
    """
    lost = Flags(len(index))
    rows, folders = _Shares(_ROW), _Shares(_FOLDER)
    sizes = [name for name in (f"{stage}.stored",) if name in index.rows.schema.names]
    for start, batch in batches(index.rows, [f"{stage}.key", *sizes]):
        column = batch.column(0)
        made = np.flatnonzero(column.is_valid().to_numpy(zero_copy_only=False))
        raw = np.frombuffer(column.buffers()[1], ">u8", count=2 * len(column), offset=16 * column.offset)
        stored = batch.column(1).fill_null(-1).to_numpy() if sizes else np.full(len(column), -1)
        rows.add(raw.reshape(-1, 2)[made], start + made, stored[made])
    if not len(rows):
        return lost
    stream = _unit_folders(commits.store, stage)
    while found := [*islice(stream, _BATCH)]:
        keys = np.frombuffer(b"".join(key for key, _ in found), ">u8").reshape(-1, 2)
        folders.add(keys, np.fromiter((size for _, size in found), np.int64, len(found)))
    doubtful: list[int] = []
    for ours, theirs in zip(rows, folders, strict=True):
        theirs.sort(order="high")
        place = np.searchsorted(theirs["high"], ours["high"])
        there = place < len(theirs)
        place[~there] = 0
        if len(theirs):
            there &= (theirs["high"][place] == ours["high"]) & (theirs["low"][place] == ours["low"])
            differs = there & (ours["stored"] >= 0) & (theirs["bytes"][place] != ours["stored"])
            doubtful += ours["row"][differs].tolist()
        lost[ours["row"][~there]] = True
    # Another size may be due to a file that a person put there: the commit itself decides. Where an older version
    # wrote the index, sizes are not known, and the presence of the commit must do.
    for row in sorted(doubtful):
        lost[row] = commits.find(stage, index.value(row, f"{stage}.key").hex(), discard=False) is None
    return lost


class _Shares:
    """Records of 16-byte keys, divided by the first bits of their keys, which are as good as random: two sets are
    compared share by share, so that neither is in memory as a whole.
    """

    def __init__(self, dtype: list[tuple[str, str]]) -> None:
        self._dtype = np.dtype(dtype)
        self._files: list[Any] = []
        for _ in range(SHARES):
            self._files.append(tempfile.SpooledTemporaryFile(max_size=_UNWRITTEN))  # noqa: SIM115 - closed with this object
            weakref.finalize(self, close_files, self._files[-1])
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, keys: npt.NDArray[Any], *columns: npt.NDArray[Any]) -> None:
        """Add records: keys as (n, 2) big-endian halves, and (n,) columns."""
        records = np.empty(len(keys), self._dtype)
        for name, column in zip(self._dtype.names or (), (keys[:, 0], keys[:, 1], *columns), strict=True):
            records[name] = column
        share = records["high"] // np.uint64(2**64 // SHARES)
        with temporary_space():
            for number in np.unique(share).tolist():
                self._files[number].write(records[share == number].tobytes())
        self._count += len(records)

    def __iter__(self) -> Iterator[npt.NDArray[Any]]:
        """Yield the records of each share."""
        for file in self._files:
            file.seek(0)
            yield np.frombuffer(bytearray(file.read()), self._dtype)


def _unit_folders(store: Store, stage: str) -> Iterator[tuple[bytes, int]]:
    """Yield (key, total bytes of all files) for every committed unit of a stage. Folders that do not belong to a unit
    are skipped.
    """
    for folder, files in store.folders(f"units/{stage}"):
        parts = folder.split("/")
        if len(parts) == 2 and UNIT_FILE in files:
            try:
                key = bytes.fromhex(parts[1])
            except ValueError:
                continue
            if len(key) == 16:
                yield key, sum(files.values())


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

    It reads two small files, however many units there are.
    Covered are the ref, the snapshot's files, the index, the pins and their tables, each by size and time; and on disk
    the units, see ``_units_at_a_glance``. On an object store units are left to the next plan: listing them takes a
    request for a thousand files.
    """
    found, token = read_ref(store, ref)
    if found is None:
        return [token]
    folders = (f"snapshots/{found.snapshot_id}", "pins", "aggregates")
    listed = [[e.path, e.size, e.modified] for folder in folders for e in store.list(folder)]
    listed += [[e.path, e.size, e.modified] for e in store.list("indexes") if e.path == Index.path(found.index)]
    whole = read_manifest(store, found.snapshot_id) is not None
    return [token, whole, sorted(listed), _units_at_a_glance(store)]


def _units_at_a_glance(store: Store) -> list[Any]:
    """List the folders ``units/<stage>/<key[:2]>`` of a store on disk (about 256 per stage), each with its modification
    time and number of links, both of which change when a unit is added or removed. For a small store, also list every
    file with its size.
    """
    root = store.local_path("units")
    if root is None:
        return []
    found: list[Any] = []
    units = 0
    stages = _folders(str(root))
    for shard in (shard for stage in stages for shard in _folders(stage)):
        stat = os.stat(shard)
        found.append([shard[len(str(root)) :], stat.st_mtime_ns, stat.st_nlink])
        units += max(stat.st_nlink - 2, 0)
    if units <= FOLDERS_LOOKED_INTO:
        for stage in map(os.path.basename, stages):
            found += sorted([stage, folder, sorted(files.items())] for folder, files in store.folders(f"units/{stage}"))
    return found


def _folders(folder: str) -> list[str]:
    try:
        with os.scandir(folder) as entries:
            return sorted(entry.path for entry in entries if entry.is_dir(follow_symlinks=False))
    except (FileNotFoundError, NotADirectoryError):
        return []
