"""The files of a unit's tables: what they hold comes back, and no damage goes unseen."""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st
from test_rows import SPEC, row, table

from factory import LocalStore, Snapshot, run
from factory.rows import canonical_table, logical_hash, parquet_bytes
from factory.shard import SUFFIX, shard_bytes, shard_table
from schemas.canonical import digest
from schemas.errors import CorruptShardError
from schemas.tables import TABLES


def shard(rows: pa.Table) -> tuple[bytes, str]:
    rows_hash, _ = logical_hash(rows)
    return shard_bytes(rows, rows_hash), rows_hash


@given(st.lists(row, max_size=8))
def test_rows_and_types_come_back(rows: list[dict[str, Any]]) -> None:
    whole = canonical_table(table(rows), SPEC, "t")
    data, rows_hash = shard(whole)
    read = shard_table(data, "file", rows_hash, "")
    read.validate(full=True)
    assert read.schema.equals(whole.schema, check_metadata=True)
    assert logical_hash(read) == logical_hash(whole)


@pytest.mark.parametrize("name", sorted(TABLES))
def test_no_rows_come_back_with_their_columns(name: str) -> None:
    empty = TABLES[name].remove_metadata().empty_table()
    data, rows_hash = shard(empty)
    assert shard_table(data, name, rows_hash, "").equals(empty)


def test_any_tool_for_arrow_and_zstd_reads_it(tmp_path: Path) -> None:
    rows = table([{"f": float(n), "s": str(n)} for n in range(100)])
    path = tmp_path / f"t{SUFFIX}"
    path.write_bytes(shard(rows)[0])
    assert pa.ipc.open_stream(pa.input_stream(path)).read_all().equals(rows)


def test_every_changed_byte_and_every_cut_is_found() -> None:
    rows = table([{"f": float(n), "s": str(n % 3)} for n in range(40)])
    data, rows_hash = shard(rows)
    for at in range(len(data)):
        flipped = bytearray(data)
        flipped[at] ^= 1 << at % 8
        for bad in (bytes(flipped), data[:at]):
            with pytest.raises(CorruptShardError, match="checksum"):
                shard_table(bad, "file", rows_hash, "")
    with pytest.raises(CorruptShardError, match="checksum"):
        shard_table(data + b"\0", "file", rows_hash, "")


def test_other_rows_are_found_by_their_hash() -> None:
    data, rows_hash = shard(table([{"f": 1.0}]))
    _, other = shard(table([{"f": 2.0}]))
    assert shard_table(data, "file", None, "").equals(shard_table(data, "file", rows_hash, ""))
    with pytest.raises(CorruptShardError, match="rows differ"):
        shard_table(data, "file", other, "")


@pytest.mark.parametrize("size", [0, 7, 1 << 20, 1 << 62])
def test_a_forged_file_with_a_right_checksum_is_refused(size: int) -> None:
    data, rows_hash = shard(table([{"f": 1.0}]))
    facts = struct.pack("<Q", size) + data[48:64]
    forged = data[:8] + hashlib.sha256(facts + data[64:]).digest() + facts + data[64:]
    with pytest.raises((CorruptShardError, MemoryError)):
        shard_table(forged, "file", rows_hash, "")


def test_tables_that_an_earlier_release_committed_as_parquet_are_read(store: LocalStore) -> None:
    units = toys.units(6)
    first = run(toys.pipeline(), units, store)
    assert first.snapshot_id is not None
    before = toys.files(store, first.snapshot_id)
    for path in [*store.root.glob("units/*/*/*/unit.json")]:
        document = json.loads(path.read_bytes())
        for name, record in document["tables"].items():
            old = path.parent / f"{name}{SUFFIX}"
            data = parquet_bytes(shard_table(old.read_bytes(), "file", record["logical_hash"], "")).to_pybytes()
            old.with_name(f"{name}.parquet").write_bytes(data)
            old.unlink()
            record |= {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
            assert record.pop("encoding") == "arrow"
        del document["checksum"]
        path.write_text(json.dumps({**document, "checksum": digest(document)}))
    (store.root / "snapshots" / first.snapshot_id / "manifest.json").unlink()
    (store.root / "refs" / "main.json").unlink()
    again = run(toys.pipeline(), units, store)
    assert (again.snapshot_id, again.stages) == (first.snapshot_id, {})
    assert toys.files(store, first.snapshot_id) == before
    assert Snapshot.open(store).unit_table("a/u00004", toys.pipeline(), "scratch").num_rows == 1
    assert run(toys.pipeline(), units, store, verify=True).stages == {}
    lost = next(store.root.glob("units/square/*/*/squares.parquet"))
    lost.write_bytes(np.random.default_rng(0).bytes(100))
    assert run(toys.pipeline(), units, store, verify=True).stages == {"square": 1}
