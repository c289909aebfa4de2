"""Snapshots as folders on this disk, whatever the store is."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import toys

from factory.object_store import ObjectStore
from factory.run import run
from factory.snapshot import COPIES_KEPT, Snapshot, local_copy
from factory.store import LocalStore
from schemas.errors import CorruptShardError, PathEscapeError, StoreError


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.glob("*/source=*/*.parquet")}


def test_a_store_on_this_disk_is_its_own_copy(store: LocalStore, tmp_path: Path) -> None:
    run(toys.pipeline(), toys.units(6), store)
    snapshot = Snapshot.open(store)
    assert local_copy(snapshot, tmp_path / "cache") == store.root / "snapshots" / snapshot.snapshot_id
    assert not (tmp_path / "cache").exists()
    (store.root / snapshot.paths("squares")[0]).unlink()
    with pytest.raises(StoreError, match="missing"):
        local_copy(snapshot, tmp_path / "cache")


def test_a_copy_of_an_object_store_has_the_same_files(
    store: LocalStore, object_store: ObjectStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kept in (store, object_store):
        run(toys.pipeline(), toys.units(20), kept, part_bytes=300)
    snapshot = Snapshot.open(object_store)
    cache = tmp_path / "cache"
    only = local_copy(snapshot, cache, ["squares"])
    assert {path.parent.parent.name for path in only.rglob("*.parquet")} == {"squares"}
    folder = local_copy(snapshot, cache)
    assert files(folder) == files(store.root / "snapshots" / snapshot.snapshot_id)
    assert (folder / "manifest.json").is_file()
    # What is there is not fetched again; what was lost is.
    fetched: list[str] = []
    read = ObjectStore.read
    monkeypatch.setattr(ObjectStore, "read", lambda self, path: (fetched.append(path), read(self, path))[1])
    lost = sorted(folder.rglob("*.parquet"))[0]
    lost.unlink()
    local_copy(snapshot, cache)
    assert fetched == [f"snapshots/{snapshot.snapshot_id}/{lost.relative_to(folder)}"]
    assert pq.read_table(lost).num_rows


def test_a_damaged_file_is_not_copied(object_store: ObjectStore, tmp_path: Path) -> None:
    run(toys.pipeline(), toys.units(6), object_store)
    snapshot = Snapshot.open(object_store)
    path = snapshot.paths("squares")[0]
    data = object_store.read(path)
    object_store.write(path, data[:-1] + b"?")
    with pytest.raises(CorruptShardError, match="differ from their recorded hash"):
        local_copy(snapshot, tmp_path)
    assert not (tmp_path / path).exists()
    object_store.delete(path)
    with pytest.raises(StoreError, match="missing"):
        local_copy(snapshot, tmp_path)


def test_a_manifest_can_not_lead_out_of_the_folder(object_store: ObjectStore, tmp_path: Path) -> None:
    run(toys.pipeline(), toys.units(6), object_store)
    snapshot = Snapshot.open(object_store)
    snapshot.manifest.tables["squares"].partitions["a"].parts[0].path = "../../../evil.parquet"
    with pytest.raises(PathEscapeError):
        local_copy(snapshot, tmp_path / "cache")
    assert not [*tmp_path.rglob("evil*")]


def test_copies_that_nobody_uses_go(object_store: ObjectStore, tmp_path: Path) -> None:
    folders = []
    for count in range(1, COPIES_KEPT + 3):
        run(toys.pipeline(), toys.units(count), object_store)
        folders.append(local_copy(Snapshot.open(object_store), tmp_path))
    assert all(folder.is_dir() for folder in folders), "used today"
    old = time.time() - 2 * 24 * 3600
    for at, folder in enumerate(folders[:-1]):
        os.utime(folder / "manifest.json", (old + at, old + at))
        os.utime(folder, (old + at, old + at))
    local_copy(Snapshot.open(object_store), tmp_path)
    assert [folder.is_dir() for folder in folders] == [False, False, True, True, True]
