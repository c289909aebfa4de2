"""Delta logs over a store's own files: what they hold by the protocol, and what delta-rs reads by them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
import toys

from factory import LocalStore, Snapshot, Store, run
from factory.delta import DeltaVersion, file_uri, write_delta
from factory.delta_types import delta_schema
from factory.object_store import ObjectStore
from factory.sweep import sweep
from schemas.errors import PublishConflictError, StoreError, UsageError
from tests.read_delta import read_delta

SCHEMAS = {"numbers": toys.NUMBERS, "states": toys.STATES, "squares": toys.SQUARES, "texts": toys.TEXTS}
KEYS = {"numbers": ["unit", "n"], "states": ["unit"], "squares": ["unit", "n"], "texts": ["unit"]}


@pytest.fixture(params=["local", "s3"])
def pair(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Store, Store]:
    """An empty store and an empty folder for logs."""
    if request.param == "local":
        return LocalStore(tmp_path / "st öre", durable=False), LocalStore(tmp_path / "delta", durable=False)
    store: ObjectStore = request.getfixturevalue("object_store")
    return store, ObjectStore("bucket", f"{store.prefix}-delta", endpoint=store.endpoint)


def publish(store: Store, *names: toys.Unit) -> Snapshot:
    run(toys.pipeline(), [*names], store, "main")
    return Snapshot.open(store)


def export(snapshot: Snapshot, target: Store, milliseconds: int = 5, ref: str = "main") -> dict[str, DeltaVersion]:
    found = write_delta(snapshot, target, ref=ref, milliseconds=milliseconds, schemas=SCHEMAS)
    return {version.table: version for version in found}


def first(store: Store) -> Snapshot:
    return publish(store, toys.unit("a/1", 3), toys.unit("b/1", 4, partition="b"), toys.unit("b/2", 2, partition="b"))


def second(store: Store) -> Snapshot:
    """The units of ``a`` as they were; in ``b`` one changed and one went."""
    return publish(store, toys.unit("a/1", 3), toys.unit("b/1", 5, partition="b"))


def log(target: Store, table: str, version: int) -> list[dict[str, Any]]:
    text = target.read(f"{table}/_delta_log/{version:020d}.json").decode()
    return [json.loads(line) for line in text.splitlines()]


def of_kind(actions: list[dict[str, Any]], kind: str) -> list[Any]:
    return [action[kind] for action in actions if kind in action]


def read_back(target: Store, table: str, version: int | None = None) -> pa.Table:
    """As delta-rs reads the table."""
    deltalake = pytest.importorskip("deltalake")
    found = deltalake.DeltaTable(str(target.local_path(table)), version=version)
    return pa.table(deltalake.QueryBuilder().register("t", found).execute("SELECT * FROM t").read_all())


def same_rows(found: pa.Table, expected: pa.Table, keys: list[str]) -> bool:
    """Equal rows, columns and values; the engine chooses how texts are laid out in memory, and gives no order."""
    order = [(key, "ascending") for key in ["source", *keys]]
    cast = found.select(expected.column_names).cast(expected.schema)
    return bool(cast.sort_by(order).combine_chunks() == expected.sort_by(order).combine_chunks())


def everything(store: Store) -> Mapping[str, tuple[int, float]]:
    return {entry.path: (entry.size, entry.modified) for entry in store.list("")}


def test_delta_rs_reads_every_version(pair: tuple[Store, Store], tmp_path: Path) -> None:
    pytest.importorskip("deltalake")
    store, target = pair
    versions = []
    for number, made in enumerate((first, second)):
        snapshot = made(store)
        before = everything(store)
        assert {v.version for v in export(snapshot, target).values()} == {number}
        assert everything(store) == before, "the store is only read"
        versions.append(snapshot)
    assert all("/_delta_log/" in entry.path for entry in target.list("")), "no row is copied"
    root = target.url
    options = {}
    if isinstance(target, ObjectStore):
        options = {"AWS_ENDPOINT_URL": str(target.endpoint), "AWS_ALLOW_HTTP": "true"}
    asked = [(name, number) for name in SCHEMAS for number in (0, 1, None)]
    found = read_delta(tmp_path, [(f"{root}/{name}", number) for name, number in asked], options)
    for (name, number), rows in zip(asked, found, strict=True):
        expected = versions[-1 if number is None else number].table(name)
        assert expected.num_rows
        assert same_rows(rows, expected, KEYS[name]), (name, number)
    assert not same_rows(versions[0].table("numbers"), versions[1].table("numbers"), KEYS["numbers"])


def test_delta_rs_tells_the_history(store: LocalStore, tmp_path: Path) -> None:
    deltalake = pytest.importorskip("deltalake")
    target = LocalStore(tmp_path / "delta", durable=False)
    ids = []
    for milliseconds, made in ((1000, first), (2000, second)):
        snapshot = made(store)
        export(snapshot, target, milliseconds)
        ids.append(snapshot.snapshot_id)
    table = deltalake.DeltaTable(str(tmp_path / "delta" / "squares"))
    history = sorted(table.history(), key=lambda entry: entry["version"])
    assert [(e["timestamp"], e["userMetadata"], e["operation"]) for e in history] == [
        (1000, ids[0], "WRITE"),
        (2000, ids[1], "WRITE"),
    ]
    assert (table.metadata().partition_columns, table.metadata().name) == (["source"], "squares")
    assert (table.protocol().min_reader_version, table.protocol().min_writer_version) == (1, 2)
    before = everything(store)
    table.vacuum(retention_hours=0, enforce_retention_duration=False, dry_run=False)
    assert everything(store) == before, "a vacuum takes no file of the store"


def test_the_log_is_that_of_the_protocol(pair: tuple[Store, Store]) -> None:
    store, target = pair
    one = first(store)
    export(one, target, 1234)
    for name in SCHEMAS:
        actions = log(target, name, 0)
        assert [next(iter(action)) for action in actions[:3]] == ["commitInfo", "protocol", "metaData"]
        assert of_kind(actions, "protocol") == [{"minReaderVersion": 1, "minWriterVersion": 2}]
        (told,) = of_kind(actions, "metaData")
        assert (told["partitionColumns"], told["createdTime"]) == (["source"], 1234)
        assert json.loads(told["schemaString"]) == delta_schema(SCHEMAS[name], "source")
        adds = of_kind(actions, "add")
        assert len(actions) == 3 + len(adds)
        parts = {
            file_uri(store, f"snapshots/{one.snapshot_id}/{part.path}"): (source, part)
            for source, held in one.manifest.tables[name].partitions.items()
            for part in held.parts
        }
        assert {add["path"] for add in adds} == parts.keys()
        for add in adds:
            source, part = parts[add["path"]]
            assert add["partitionValues"] == {"source": source}
            assert (add["size"], add["modificationTime"], add["dataChange"]) == (part.bytes, 1234, True)
            assert json.loads(add["stats"]) == {"numRecords": part.rows}
    scheme = "s3://bucket/" if isinstance(store, ObjectStore) else "file:///"
    assert all(path.startswith(scheme) and path.isascii() and " " not in path for path in parts)


def test_a_new_snapshot_is_a_version_that_changes_only_what_changed(pair: tuple[Store, Store]) -> None:
    store, target = pair
    one = first(store)
    export(one, target, 1)
    before = {entry.path: target.read(entry.path) for entry in target.list("")}
    two = second(store)
    done = export(two, target, 2)
    assert {path: target.read(path) for path in before} == before, "a version that is written stays"
    for name in SCHEMAS:
        actions = log(target, name, 1)
        assert not of_kind(actions, "metaData")
        adds, removes = of_kind(actions, "add"), of_kind(actions, "remove")
        assert {(add["partitionValues"]["source"], add["dataChange"]) for add in adds} == {("a", False), ("b", True)}
        assert {(r["partitionValues"]["source"], r["dataChange"]) for r in removes} == {("a", False), ("b", True)}
        assert {r["path"] for r in removes} == {add["path"] for add in of_kind(log(target, name, 0), "add")}
        assert all(r["deletionTimestamp"] == 2 for r in removes)
        assert (done[name].added, done[name].removed) == (1, 1)
    # Back to the first: a third version with the files of the first.
    back = first(store)
    assert back.snapshot_id == one.snapshot_id
    assert {version.version for version in export(back, target, 3).values()} == {2}
    assert {a["path"] for a in of_kind(log(target, "texts", 2), "add")} == {
        a["path"] for a in of_kind(log(target, "texts", 0), "add")
    }


def test_the_same_snapshot_again_writes_nothing(pair: tuple[Store, Store], tmp_path: Path) -> None:
    store, target = pair
    snapshot = first(store)
    assert all(version.written for version in export(snapshot, target).values())
    before = everything(target)
    again = export(snapshot, target, milliseconds=99)
    assert everything(target) == before
    assert {(v.version, v.written) for v in again.values()} == {(0, False)}
    # Elsewhere, it is the same bytes.
    other = LocalStore(tmp_path / "other", durable=False)
    export(snapshot, other)
    assert {e.path: other.read(e.path) for e in other.list("")} == {
        e.path: target.read(e.path) for e in target.list("")
    }


def test_a_killed_export_is_ended_by_the_next(store: LocalStore, tmp_path: Path) -> None:
    target = LocalStore(tmp_path / "delta", durable=False)
    snapshot = first(store)
    export(snapshot, target)
    whole = {entry.path: target.read(entry.path) for entry in target.list("")}
    for name in ("squares", "texts"):
        target.delete(f"{name}/_delta_log/{0:020d}.json")
    assert {name for name, version in export(snapshot, target).items() if version.written} == {"squares", "texts"}
    assert {entry.path: target.read(entry.path) for entry in target.list("")} == whole


class _Raced(LocalStore):
    """Another writer takes each of the first ``wins`` numbers just before this one."""

    wins = 1

    def create(self, path: str, data: Any) -> bool:
        if self.wins:
            self.wins -= 1
            name, _, version = path.partition("/_delta_log/")
            entry: dict[str, Any] = {"commitInfo": {"timestamp": 0, "operation": "OPTIMIZE"}}
            if version.startswith("0" * 20):
                lines = data.splitlines()[:3]
            else:
                lines = [json.dumps(entry).encode()]
            super().create(f"{name}/_delta_log/{version}", b"\n".join(lines) + b"\n")
        return super().create(path, data)


def test_a_number_belongs_to_one_writer(store: LocalStore, tmp_path: Path) -> None:
    target = _Raced(tmp_path / "delta", durable=False)
    snapshot = first(store)
    done = export(snapshot, target)
    assert {name: version.version for name, version in done.items()} == {
        "numbers": 1,
        "squares": 0,
        "states": 0,
        "texts": 0,
    }
    assert not of_kind(log(target, "numbers", 1), "protocol")
    assert same_rows(read_back(target, "numbers"), snapshot.table("numbers"), KEYS["numbers"])
    target.wins = 1000
    with pytest.raises(PublishConflictError):
        export(second(store), target)


def test_other_tables_and_broken_logs_are_left_alone(store: LocalStore, tmp_path: Path) -> None:
    target = LocalStore(tmp_path / "delta", durable=False)
    snapshot = first(store)
    export(snapshot, target)
    before = everything(target)
    with pytest.raises(UsageError, match="another Delta table"):
        export(snapshot, target, ref="nightly")
    assert everything(target) == before
    zero = f"numbers/_delta_log/{0:020d}.json"
    sound = target.read(zero)
    hostile = [b"{", b"[]", b"7", b'{"add": {}}', b'{"add": {"path": "x", "tags": 7}}', b"[" * 100_000, b"\xff"]
    hostile += [b'{"protocol": {"minReaderVersion": 3, "minWriterVersion": 7}}', b'{"metaData": {}}']
    for line in hostile:
        target.write(zero, sound + line + b"\n")
        with pytest.raises(StoreError, match="can't be followed"):
            export(snapshot, target)
    target.write(zero, sound)
    target.write(f"numbers/_delta_log/{2:020d}.json", sound)
    with pytest.raises(StoreError, match="missing"):
        export(snapshot, target)


def test_versions_last_as_long_as_their_snapshots(store: LocalStore, tmp_path: Path) -> None:
    pytest.importorskip("deltalake")
    target = LocalStore(tmp_path / "delta", durable=False)
    export(first(store), target)
    last = second(store)
    export(last, target)
    sweep(store, keep=1, now=4e9)
    assert same_rows(read_back(target, "texts"), last.table("texts"), KEYS["texts"])
    with pytest.raises(Exception, match=r"(?i)not found|no such file"):
        read_back(target, "texts", 0)


@pytest.mark.parametrize(
    ("kind", "named"),
    [
        (pa.large_string(), "string"),
        (pa.dictionary(pa.int32(), pa.string()), "string"),
        (pa.int8(), "byte"),
        (pa.int64(), "long"),
        (pa.date32(), "date"),
        (pa.decimal128(12, 3), "decimal(12,3)"),
        (pa.timestamp("us", "UTC"), "timestamp"),
        (pa.list_(pa.float32(), 3), {"type": "array", "elementType": "float", "containsNull": True}),
        (
            pa.large_list(pa.field("item", pa.bool_(), nullable=False)),
            {"type": "array", "elementType": "boolean", "containsNull": False},
        ),
        (
            pa.map_(pa.string(), pa.int16()),
            {"type": "map", "keyType": "string", "valueType": "short", "valueContainsNull": True},
        ),
    ],
    ids=str,
)
def test_types_have_delta_names(kind: pa.DataType, named: Any) -> None:
    schema = delta_schema(pa.schema([pa.field("x", kind, nullable=False)]), "source")
    assert schema["fields"][0] == {"name": "x", "type": named, "nullable": False, "metadata": {}}
    assert schema["fields"][1] == {"name": "source", "type": "string", "nullable": True, "metadata": {}}


@pytest.mark.parametrize(
    "kind",
    [pa.uint8(), pa.uint64(), pa.float16(), pa.timestamp("ns", "UTC"), pa.timestamp("us"), pa.time64("us"), pa.null()],
    ids=str,
)
def test_what_delta_has_not_is_refused_by_its_place(kind: pa.DataType) -> None:
    schema = pa.schema([pa.field("a", pa.list_(pa.struct([pa.field("b", kind)])))])
    with pytest.raises(UsageError, match=r"a\[\]\.b: Delta has no type"):
        delta_schema(schema, "source")


@pytest.mark.parametrize("names", [["source"], ["a b"], ["a", "A"], ["x;"]], ids=",".join)
def test_names_that_delta_has_not_are_refused(names: list[str]) -> None:
    with pytest.raises(UsageError):
        delta_schema(pa.schema([(name, pa.int32()) for name in names]), "source")
