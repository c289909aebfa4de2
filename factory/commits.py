"""Committed outputs of stages, and records of stages that failed.

``units/<stage>/<key[:2]>/<key>/<table>.parquet``, further files beside them, and ``unit.json`` last: it holds the
SHA-256 and the size of each file, and a key whose ``unit.json`` is there is done. ``quarantine/<stage>/<key>.json``
says why one is not.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeVar

import orjson
import pyarrow as pa
from pydantic import BaseModel, ValidationError

from factory.rows import parquet_bytes, parquet_table
from factory.store import Store
from schemas.canonical import digest
from schemas.errors import CorruptShardError
from schemas.unit import FileRecord, QuarantineRecord, TableRecord, UnitCommit

__all__ = [
    "LISTING",
    "REBUILD_VERIFIED",
    "UNIT_FILE",
    "Commits",
    "Committed",
    "sealed",
    "table_file",
    "unsealed",
    "verified",
]

LISTING = "listing"
"""Stage name under which units are quarantined that could not even be listed."""

REBUILD_VERIFIED: Final = "Run condvln generate CONFIG --verify, which rebuilds damaged files."
"""The remedy for every damaged file that can be rebuilt."""

UNIT_FILE: Final = "unit.json"
"""File name of the commit of a unit's stage. It is written last."""


Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Committed:
    """One committed stage of one unit.

    stored : bytes of all its files, ``unit.json`` included: a listing tells by it that one is missing or cut
    """

    commit: UnitCommit
    stored: int


class Commits:
    """The units and the quarantine of one store."""

    def __init__(self, store: Store) -> None:
        self.store = store

    @staticmethod
    def folder(stage: str, key: str) -> str:
        """Return the folder that holds the files of a key."""
        return f"units/{stage}/{key[:2]}/{key}"

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
            commit, size = self._read(stage, key)
        except FileNotFoundError:
            return None
        except ValueError:
            pass
        else:
            sizes = {entry.path.rpartition("/")[2]: entry.size for entry in self.store.list(folder)}
            records = _files(commit)
            if all(sizes.get(name) == record.bytes for name, record in records.items()):
                return Committed(commit, size + sum(record.bytes for record in records.values()))
        if discard:
            self.discard(stage, key)
        return None

    def _read(self, stage: str, key: str) -> tuple[UnitCommit, int]:
        """Return (the commit under this key, bytes of its file). Raises ``FileNotFoundError`` where there is none,
        ``ValueError`` where it is damaged.
        """
        data = self.store.read(f"{self.folder(stage, key)}/{UNIT_FILE}")
        commit = unsealed(UnitCommit, data)
        if (commit.key, commit.stage) != (key, stage):
            raise ValueError("it is the commit of another key")
        return commit, len(data)

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
                verified(self.store, f"{folder}/{name}", record.sha256)
            except CorruptShardError:
                return f"{folder}/{name}"
        return None

    def save(self, commit: UnitCommit, tables: Mapping[str, pa.Table], files: Mapping[str, bytes]) -> Committed:
        """Write the files of a stage, then its ``unit.json``; return the commit with the files' hashes and sizes.

        tables : canonical tables, whose ``rows`` and ``logical_hash`` are in ``commit`` already
        """
        folder = self.folder(commit.stage, commit.key)
        records: dict[str, TableRecord] = {}
        for name, table in tables.items():
            file = self._write(folder, table_file(name), parquet_bytes(table))
            records[name] = commit.tables[name].model_copy(update=file.model_dump())
        kept = {name: self._write(folder, name, content) for name, content in files.items()}
        commit = commit.model_copy(update={"tables": records, "files": kept})
        content = sealed(commit)
        self.store.write(f"{folder}/{UNIT_FILE}", content)
        return Committed(commit, len(content) + sum(record.bytes for record in _files(commit).values()))

    def _write(self, folder: str, name: str, data: bytes) -> FileRecord:
        self.store.write(f"{folder}/{name}", data, settle=False)
        return FileRecord(sha256=hashlib.sha256(data).hexdigest(), bytes=len(data))

    def table(self, stage: str, key: str, name: str, rows_hash: str | None = None) -> pa.Table:
        """Read one table of a commit.

        rows_hash : logical hash that its rows must have

        Raises ``CorruptShardError`` when the commit or the file is gone, cut or changed, or the rows are others.
        """
        path = f"{self.folder(stage, key)}/{table_file(name)}"
        record = self.commit(stage, key).tables.get(name)
        if record is None or rows_hash not in (None, record.logical_hash):
            raise CorruptShardError(
                "the rows differ from the hash of their commit", where=self._where(path), remedy=REBUILD_VERIFIED
            )
        return parquet_table(verified(self.store, path, record.sha256), self._where(path))

    def commit(self, stage: str, key: str) -> UnitCommit:
        """Read a commit. Raises ``CorruptShardError`` where it is missing or damaged."""
        try:
            return self._read(stage, key)[0]
        except (FileNotFoundError, ValueError) as error:
            where = self._where(f"{self.folder(stage, key)}/{UNIT_FILE}")
            raise CorruptShardError(
                "the commit of a unit is missing or damaged", where=where, remedy=REBUILD_VERIFIED
            ) from error

    def file(self, commit: UnitCommit, name: str) -> bytes:
        """Read a file of a commit that is not a table. Raises ``CorruptShardError`` as ``table`` does."""
        return verified(self.store, f"{self.folder(commit.stage, commit.key)}/{name}", commit.files[name].sha256)

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


def verified(store: Store, path: str, sha256: str) -> bytes:
    """Read a file of the store. Raises ``CorruptShardError`` when it is missing or its bytes have another hash."""
    try:
        data = store.read(path)
    except FileNotFoundError as error:
        raise CorruptShardError("the file is missing", where=f"{store.url}/{path}", remedy=REBUILD_VERIFIED) from error
    if hashlib.sha256(data).hexdigest() != sha256:
        raise CorruptShardError(
            "the bytes differ from their recorded hash", where=f"{store.url}/{path}", remedy=REBUILD_VERIFIED
        )
    return data


def table_file(name: str) -> str:
    """Return the file name of a table of a unit."""
    return f"{name}.parquet"


def _files(commit: UnitCommit) -> dict[str, FileRecord]:
    """Return all files of a commit except ``unit.json``, by name."""
    return {**{table_file(name): record for name, record in commit.tables.items()}, **commit.files}


def sealed(document: BaseModel) -> bytes:
    """Encode a document of the store as JSON with its field ``checksum`` set, which reveals damage even where the
    document is still valid JSON.
    """
    content = document.model_dump(mode="json", exclude={"checksum"})
    return orjson.dumps({**content, "checksum": digest(content)}, option=orjson.OPT_INDENT_2)


def unsealed(kind: type[Model], data: bytes) -> Model:
    """Decode the document in ``data``. Raises ``ValueError`` when it is malformed or differs from its checksum."""
    document = kind.model_validate_json(data)
    content = json.loads(data)
    if digest({name: value for name, value in content.items() if name != "checksum"}) != content.get("checksum"):
        raise ValueError("the document differs from its checksum")
    return document
