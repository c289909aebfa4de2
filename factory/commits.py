"""Committed outputs of stages, and records of stages that failed.

``units/<stage>/<key[:2]>/<key>/tables.arrows.zst``, further files beside it, and ``unit.json`` last: a key whose
``unit.json`` is there is done. ``quarantine/<stage>/<key>.json`` says why one is not. Earlier releases wrote each table
as ``<table>.parquet``, which is still read.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import pyarrow as pa
from pydantic import ValidationError

from factory.faults import FaultPlan
from factory.kept_tables import KeptTables
from factory.rows import logical_hash, parquet_table
from factory.seal import sealed, unsealed
from factory.shard import SHARD_FILE, shard_bytes, shard_table
from factory.store import Store
from schemas.errors import CorruptShardError
from schemas.unit import QuarantineRecord, ShardRecord, TableRecord, UnitCommit

__all__ = ["LISTING", "REBUILD_VERIFIED", "UNIT_FILE", "Commits", "Committed"]

LISTING = "listing"
"""Stage name under which units are quarantined that could not even be listed."""

REBUILD_VERIFIED: Final = "Run condvln rebuild CONFIG --verify, which rebuilds damaged files."
"""The remedy for every damaged file that can be rebuilt."""

PARQUET: Final = ".parquet"
"""End of the names of tables that earlier releases committed."""

UNIT_FILE: Final = "unit.json"
"""File name of the commit of a unit's stage. It is written last."""


@dataclass(frozen=True, slots=True)
class Committed:
    """One committed stage of one unit.

    stored : bytes of all its files, ``unit.json`` included: a listing tells by it that one is missing or cut
    """

    commit: UnitCommit
    stored: int


class Commits:
    """The units and the quarantine of one store.

    kept : tables that this process made, so that it need not read them
    """

    def __init__(self, store: Store, faults: FaultPlan | None = None, kept: KeptTables | None = None) -> None:
        self.store = store
        self._faults = faults or FaultPlan()
        self._kept = kept or KeptTables()

    @staticmethod
    def folder(stage: str, key: str) -> str:
        """Return the folder that holds the files of a key."""
        return f"units/{stage}/{key[:2]}/{key}"

    def exists(self, stage: str, key: str) -> bool:
        """Whether the stage was committed under this key."""
        return self.store.exists(f"{self.folder(stage, key)}/unit.json")

    def committed(self) -> Iterator[tuple[str, str]]:
        """Yield (stage, key) of every commit."""
        for entry in self.store.list("units"):
            parts = entry.path.split("/")
            if parts[-1] == "unit.json" and len(parts) == 5:
                yield parts[1], parts[3]

    def find(self, stage: str, key: str, *, discard: bool = True) -> Committed | None:
        """Return the commit under this key, or None if the commit or one of its files is missing, truncated or
        unreadable.

        discard : remove a damaged one, so that it is rebuilt; False where nothing may be written
        """
        folder = self.folder(stage, key)
        try:
            data = self.store.read(f"{folder}/{UNIT_FILE}")
        except FileNotFoundError:
            return None
        try:
            commit = unsealed(UnitCommit, data)
        except ValueError:
            commit = None
        if commit is not None and (commit.key, commit.stage) == (key, stage):
            sizes = {entry.path.rpartition("/")[2]: entry.size for entry in self.store.list(folder)}
            records = _files(commit)
            if all(sizes.get(name) == record.bytes for name, record in records.items()):
                return Committed(commit, len(data) + sum(record.bytes for record in records.values()))
        if discard:
            self.discard(stage, key)
        return None

    def damaged_file(self, stage: str, key: str) -> str | None:
        """Return the path of the first file of a commit whose bytes differ from the hash in the commit, or None if all
        agree. All files of the commit are read.
        """
        folder = self.folder(stage, key)
        found = self.find(stage, key, discard=False)
        if found is None:
            return f"{folder}/{UNIT_FILE}"
        for name, record in _files(found.commit).items():
            try:
                self._verified(f"{folder}/{name}", record.sha256)
            except CorruptShardError:
                return f"{folder}/{name}"
        return None

    def save(self, commit: UnitCommit, tables: Mapping[str, pa.Table], files: Mapping[str, bytes]) -> Committed:
        """Write the files of a stage, then its ``unit.json``; return the commit with the files' hashes and sizes.

        tables : canonical tables, whose ``rows`` and ``logical_hash`` are in ``commit`` already
        """
        folder = self.folder(commit.stage, commit.key)
        self._faults.reach("unit-before-data")
        records: dict[str, TableRecord] = {}
        parts: list[bytes] = []
        for name, table in tables.items():
            data = shard_bytes(name, table, commit.tables[name].logical_hash)
            parts.append(data)
            records[name] = commit.tables[name].model_copy(
                update={"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
            )
        whole: ShardRecord | None = None
        if parts:
            shard = b"".join(parts)
            self.store.write(f"{folder}/{SHARD_FILE}", shard, settle=False)
            self._faults.reach("unit-between-data")
            whole = ShardRecord(sha256=hashlib.sha256(shard).hexdigest(), bytes=len(shard))
        kept = {}
        for name, content in files.items():
            self.store.write(f"{folder}/{name}", content, settle=False)
            kept[name] = ShardRecord(sha256=hashlib.sha256(content).hexdigest(), bytes=len(content))
        commit = commit.model_copy(update={"tables": records, "shard": whole, "files": kept})
        self._faults.reach("unit-before-commit")
        content = sealed(commit)
        self.store.write(f"{folder}/{UNIT_FILE}", content)
        self._faults.reach("unit-after-commit")
        return Committed(commit, len(content) + sum(record.bytes for record in _files(commit).values()))

    def keep(self, commit: UnitCommit, name: str, table: pa.Table) -> None:
        """Keep a table of a commit in memory for the next one who asks for it."""
        path = f"{self.folder(commit.stage, commit.key)}/{name}"
        self._kept.put(path, commit.tables[name].logical_hash, table)

    def table(self, stage: str, key: str, name: str, rows_hash: str | None = None) -> pa.Table:
        """Read one table of a commit.

        rows_hash : logical hash that its rows must have

        Raises ``CorruptShardError`` when the file is gone, cut, or its rows differ from the hash.
        """
        path = f"{self.folder(stage, key)}/{name}"
        kept = None if rows_hash is None else self._kept.take(path, rows_hash)
        if kept is not None:
            return kept
        shard = f"{self.folder(stage, key)}/{SHARD_FILE}"
        try:
            return shard_table(self._verified(shard, None), name, self._where(shard), rows_hash, REBUILD_VERIFIED)
        except CorruptShardError as error:
            if isinstance(error.__cause__, FileNotFoundError) and self.store.exists(f"{path}{PARQUET}"):
                return self._parquet(f"{path}{PARQUET}", rows_hash)
            raise

    def _parquet(self, path: str, rows_hash: str | None) -> pa.Table:
        table = parquet_table(self._verified(path, None), self._where(path))
        # A flipped bit inside a page may well decode: only the rows' own hash tells.
        if rows_hash is not None and logical_hash(table)[0] != rows_hash:
            raise CorruptShardError(
                "the rows differ from the hash of their commit", where=self._where(path), remedy=REBUILD_VERIFIED
            )
        return table

    def file(self, commit: UnitCommit, name: str) -> bytes:
        """Read a file of a commit that is not a table. Raises ``CorruptShardError`` as ``table`` does."""
        return bytes(self._verified(f"{self.folder(commit.stage, commit.key)}/{name}", commit.files[name].sha256))

    def _verified(self, path: str, sha256: str | None) -> Any:
        try:
            data = self.store.read(path)
        except FileNotFoundError as error:
            raise CorruptShardError(
                "a committed file is missing", where=self._where(path), remedy=REBUILD_VERIFIED
            ) from error
        if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256:
            raise CorruptShardError(
                "the bytes differ from the hash of their commit", where=self._where(path), remedy=REBUILD_VERIFIED
            )
        return data

    def _where(self, path: str) -> str:
        return f"{self.store.url}/{path}"

    def discard(self, stage: str, key: str) -> None:
        """Delete a commit. ``unit.json`` is deleted first, so that a ``unit.json`` never remains without the other
        files.
        """
        folder = self.folder(stage, key)
        self.store.delete(f"{folder}/unit.json")
        for entry in [*self.store.list(folder)]:
            self.store.delete(entry.path)

    def quarantine(self, record: QuarantineRecord) -> None:
        """Record why a unit failed, in place of an older record of the same key."""
        self._faults.reach("quarantine-before-record")
        path = f"quarantine/{record.stage}/{record.key}.json"
        self.store.write(path, record.model_dump_json(indent=1).encode())

    def quarantine_record(self, stage: str, key: str) -> QuarantineRecord | None:
        """Return the quarantine record under this key, or None if there is none. A damaged record is deleted, so that
        the unit is tried again.
        """
        path = f"quarantine/{stage}/{key}.json"
        try:
            return QuarantineRecord.model_validate_json(self.store.read(path))
        except FileNotFoundError:
            return None
        except ValidationError:
            self.store.delete(path)
            return None

    def release(self, stage: str, key: str) -> None:
        """Take a key out of quarantine."""
        self.store.delete(f"quarantine/{stage}/{key}.json")

    def quarantined(self) -> Iterator[tuple[str, str]]:
        """Yield (stage, key) of every quarantine record."""
        for entry in self.store.list("quarantine"):
            parts = entry.path.split("/")
            # Whatever else a person put there is not ours.
            if len(parts) == 3 and parts[2].endswith(".json"):
                yield parts[1], parts[2].removesuffix(".json")


def _files(commit: UnitCommit) -> dict[str, ShardRecord]:
    """Return all files of a commit except ``unit.json``, by name."""
    if commit.shard is not None:
        return {SHARD_FILE: commit.shard, **commit.files}
    return {**{f"{name}{PARQUET}": record for name, record in commit.tables.items()}, **commit.files}
