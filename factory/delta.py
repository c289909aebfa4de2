"""A snapshot as Delta tables, with no copy of its rows: a log for each table, whose files are the snapshot's own.

``<folder>/<table>/_delta_log/<version>.json`` name the Parquet files by absolute URI (Delta protocol, "Add File and
Remove File": a path is relative to the table or absolute). A later snapshot is the next version. Its files lie in a
folder of their own even where their rows are the old ones, so all are named anew; the actions on equal rows say
``dataChange: false``, and whoever follows the table's changes sees only the files that did change.

A version says nothing that the store does not: times are those at which the ref moved, ids are hashes of names. So two
exports of one snapshot write the same bytes, and the second one nothing.
"""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final
from urllib.parse import quote

import pyarrow as pa
import pyarrow.parquet as pq

from factory.delta_types import delta_schema
from factory.snapshot import Snapshot
from factory.store import Store
from schemas.errors import CorruptShardError, PublishConflictError, StoreError, UsageError
from schemas.snapshot import TableManifest

__all__ = ["PARTITION", "DeltaVersion", "file_uri", "write_delta"]

PARTITION: Final = "source"
"""The partition column: it is in the folders' names and in no file."""

READER_VERSION: Final = 1
WRITER_VERSION: Final = 2
"""Of the protocol: the first that knows columns without nulls."""

TRIES: Final = 20
"""How often a version's number may be taken by another writer before this one gives up."""

_NAMESPACE: Final = uuid.UUID("6f0d6a0e-5d1c-5c0b-9d57-2f7f3b1f6d11")
_ENTRY: Final = re.compile(r"\d{20}\.json")


@dataclass(frozen=True)
class DeltaVersion:
    """What a table's log holds after an export.

    version : the version that is the snapshot
    written : False where it was there already
    added, removed : files whose rows came and went; those that only lie elsewhere now are in neither
    """

    table: str
    version: int
    written: bool
    rows: int
    files: int
    added: int
    removed: int


@dataclass
class _State:
    """A table as its log tells it: the newest version (-1: no table), and the files by their URI."""

    version: int = -1
    table_id: str = ""
    schema: str = ""
    partitions: list[str] = field(default_factory=list)
    created: int = 0
    files: dict[str, dict[str, Any]] = field(default_factory=dict)


def write_delta(
    snapshot: Snapshot, target: Store, *, ref: str, milliseconds: int, schemas: Mapping[str, pa.Schema]
) -> list[DeltaVersion]:
    """Make the newest version of each Delta table below ``target`` the snapshot.

    Each table's version is there whole or not at all; what an export that was killed left out, the next one adds.

    target : where the tables' folders are; no part of a store's own folders
    ref : name under which the snapshot is published; tables of different refs are different tables
    milliseconds : when it was published, since 1970
    schemas : of tables that have no file to tell theirs

    Raises
    ------
    UsageError : a column's type is none of Delta's, or the folder holds some other Delta table
    StoreError : a log can't be read; ``CorruptShardError`` where a file of the snapshot can't
    PublishConflictError : others kept writing versions
    """
    # All that may be refused is refused before the first log is written.
    texts = {
        name: json.dumps(delta_schema(_schema(snapshot, name, schemas), PARTITION), separators=(",", ":"))
        for name in sorted(snapshot.manifest.tables)
    }
    return [_export(snapshot, target, name, text, ref, milliseconds) for name, text in texts.items()]


def file_uri(store: Store, path: str) -> str:
    """Absolute URI of a stored file, ``file:///…`` or ``s3://bucket/…``; what URIs don't hold is percent-encoded."""
    place = store.local_path(path)
    if place is not None:
        return "file://" + quote(place.resolve().as_posix(), safe="/=")
    scheme, _, rest = f"{store.url}/{path}".partition("://")
    return f"{scheme}://{quote(rest, safe='/=')}"


def _schema(snapshot: Snapshot, name: str, schemas: Mapping[str, pa.Schema]) -> pa.Schema:
    """As the files have it; all files of a table have the same, which is part of the snapshot's id."""
    parts = [part for partition in snapshot.manifest.tables[name].partitions.values() for part in partition.parts]
    if not parts:
        return schemas[name]
    path = f"snapshots/{snapshot.snapshot_id}/{min(parts, key=lambda part: (part.bytes, part.path)).path}"
    try:
        return pq.read_schema(pa.BufferReader(snapshot.store.read(path)))
    except (FileNotFoundError, pa.ArrowException) as error:
        remedy = "Rebuild with --verify to mend it."
        raise CorruptShardError("a file of the snapshot can't be read", where=path, remedy=remedy) from error


def _export(snapshot: Snapshot, target: Store, name: str, schema: str, ref: str, milliseconds: int) -> DeltaVersion:
    record = snapshot.manifest.tables[name]
    table_id = str(uuid.uuid5(_NAMESPACE, f"{snapshot.manifest.pipeline}/{ref}/{name}"))
    files = _files(snapshot, record, milliseconds)
    for _ in range(TRIES):
        state = _replay(target, name)
        if state.version >= 0 and (state.table_id, state.partitions) != (table_id, [PARTITION]):
            raise UsageError(
                f"another Delta table is there, which is not {name!r} of the ref {ref!r}",
                where=f"{target.url}/{name}",
                remedy="Name a folder of its own for each ref.",
            )
        if state.version >= 0 and state.files.keys() == files.keys() and state.schema == schema:
            return DeltaVersion(name, state.version, False, record.rows, len(files), 0, 0)
        actions, added, removed = _actions(state, files, milliseconds)
        head: list[dict[str, Any]] = [_commit_info(snapshot, state.version, milliseconds)]
        if state.version < 0:
            head.append({"protocol": {"minReaderVersion": READER_VERSION, "minWriterVersion": WRITER_VERSION}})
        if state.schema != schema:
            head.append({"metaData": _metadata(name, table_id, schema, state, milliseconds)})
        entry = "".join(json.dumps(action, separators=(",", ":")) + "\n" for action in [*head, *actions])
        version = state.version + 1
        # Only one writer gets the number: the protocol asks for this, and both kinds of store can do it.
        if target.create(_entry(name, version), entry.encode()):
            return DeltaVersion(name, version, True, record.rows, len(files), added, removed)
    raise PublishConflictError(
        "others keep writing versions of the Delta table", where=f"{target.url}/{name}", remedy="Run again."
    )


def _entry(name: str, version: int) -> str:
    return f"{name}/_delta_log/{version:020d}.json"


def _files(snapshot: Snapshot, record: TableManifest, milliseconds: int) -> dict[str, dict[str, Any]]:
    """The add actions of the snapshot's files, by URI; ``dataChange`` is still open."""
    found = {}
    for partition, held in sorted(record.partitions.items()):
        for part in held.parts:
            uri = file_uri(snapshot.store, f"snapshots/{snapshot.snapshot_id}/{part.path}")
            found[uri] = {
                "path": uri,
                "partitionValues": {PARTITION: partition},
                "size": part.bytes,
                "modificationTime": milliseconds,
                "dataChange": True,
                "stats": json.dumps({"numRecords": part.rows}, separators=(",", ":")),
                "tags": {"content": part.content},
            }
    return found


def _content(add: Mapping[str, Any]) -> tuple[Any, Any] | None:
    """What two files of equal rows have in common; None for a file that is not ours."""
    content = (add.get("tags") or {}).get("content")
    return None if content is None else (add["partitionValues"].get(PARTITION), content)


def _actions(
    state: _State, files: Mapping[str, dict[str, Any]], milliseconds: int
) -> tuple[list[dict[str, Any]], int, int]:
    """(remove and add actions from ``state`` to ``files``, files with new rows, files whose rows went)."""
    before = {_content(add) for add in state.files.values()}
    after = {_content(add) for add in files.values()}
    actions: list[dict[str, Any]] = []
    added = removed = 0
    for uri, old in sorted(state.files.items()):
        if uri not in files:
            change = _content(old) not in after
            removed += change
            remove = {"path": uri, "deletionTimestamp": milliseconds, "dataChange": change}
            known = {key: old[key] for key in ("partitionValues", "size") if key in old}
            actions.append({"remove": {**remove, "extendedFileMetadata": True, **known}})
    for uri, new in files.items():
        if uri not in state.files:
            change = _content(new) not in before
            added += change
            actions.append({"add": {**new, "dataChange": change}})
    return actions, added, removed


def _commit_info(snapshot: Snapshot, read: int, milliseconds: int) -> dict[str, Any]:
    info: dict[str, Any] = {
        "timestamp": milliseconds,
        "operation": "WRITE",
        "operationParameters": {"mode": "Overwrite", "partitionBy": json.dumps([PARTITION])},
        "isBlindAppend": False,
        "engineInfo": "condvln",
        "userMetadata": snapshot.snapshot_id,
    }
    return {"commitInfo": info if read < 0 else {**info, "readVersion": read}}


def _metadata(name: str, table_id: str, schema: str, state: _State, milliseconds: int) -> dict[str, Any]:
    return {
        "id": table_id,
        "name": name,
        "format": {"provider": "parquet", "options": {}},
        "schemaString": schema,
        "partitionColumns": [PARTITION],
        "configuration": {},
        "createdTime": milliseconds if state.version < 0 else state.created,
    }


def _replay(target: Store, name: str) -> _State:
    """The table that the log of ``name`` tells, from its first version on (checkpoints are never written here)."""
    folder = f"{name}/_delta_log"
    entries = (entry.path.rpartition("/")[2] for entry in target.list(folder))
    versions = sorted(int(entry[:20]) for entry in entries if _ENTRY.fullmatch(entry))
    if versions != [*range(len(versions))]:
        raise StoreError(
            "versions of the Delta table are missing", where=f"{target.url}/{folder}", remedy="Export to a new folder."
        )
    state = _State()
    for version in versions:
        path = _entry(name, version)
        try:
            for line in target.read(path).splitlines():
                if line.strip():
                    _apply(state, json.loads(line))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise StoreError(
                f"the log can't be followed: {error}", where=f"{target.url}/{path}", remedy="Export to a new folder."
            ) from error
        state.version = version
    return state


def _apply(state: _State, action: Any) -> None:
    """One line of the log. Raises ``ValueError`` and its like on what is not one that this writer may go on from."""
    if not isinstance(action, dict):
        raise ValueError("a line is no action")
    if "protocol" in action:
        needs = (action["protocol"]["minReaderVersion"], action["protocol"]["minWriterVersion"])
        if needs[0] > READER_VERSION or needs[1] > WRITER_VERSION:
            raise ValueError(f"someone raised its protocol to reader {needs[0]}, writer {needs[1]}")
    elif "metaData" in action:
        told = action["metaData"]
        state.table_id, state.schema, state.partitions = told["id"], told["schemaString"], told["partitionColumns"]
        state.created = int(told.get("createdTime") or 0)
    elif "add" in action:
        add = action["add"]
        _content(add)
        state.files[str(add["path"])] = add
    elif "remove" in action:
        state.files.pop(action["remove"]["path"], None)
