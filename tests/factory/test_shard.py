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
from factory.shard import SHARD_FILE, shard_bytes, shard_table
from schemas.canonical import digest
from schemas.errors import CorruptShardError
from schemas.tables import TABLES


def shard(rows: pa.Table, name: str = "t") -> tuple[bytes, str]:
    rows_hash, _ = logical_hash(rows)
    return shard_bytes(name, rows, rows_hash), rows_hash


@given(st.lists(row, max_size=8))
def test_rows_and_types_come_back(rows: list[dict[str, Any]]) -> None:
    whole = canonical_table(table(rows), SPEC, "t")
    data, rows_hash = shard(whole)
    read = shard_table(data, "t", "file", rows_hash, "")
    read.validate(full=True)
    assert read.schema.equals(whole.schema, check_metadata=True)
    assert logical_hash(read) == logical_hash(whole)


@pytest.mark.parametrize("name", sorted(TABLES))
def test_no_rows_come_back_with_their_columns(name: str) -> None:
    empty = TABLES[name].remove_metadata().empty_table()
    data, rows_hash = shard(empty, name)
    assert shard_table(data, name, "file", rows_hash, "").equals(empty)


TABLES_OF_ONE: dict[str, pa.Table] = {
    "t": table([{"f": float(n), "s": str(n % 3)} for n in range(40)]),
    "tt": pa.table({"sum": [1.0, 2.0]}),
    "none": pa.table({"n": pa.array([], pa.int64())}),
}


def test_each_table_of_a_shard_is_found_by_its_name() -> None:
    data = b"".join(shard(rows, name)[0] for name, rows in TABLES_OF_ONE.items())
    for name, rows in TABLES_OF_ONE.items():
        assert shard_table(data, name, "file", shard(rows)[1], "").equals(rows)
    for name in ("", "sum", "ttt"):
        with pytest.raises(CorruptShardError, match="checksum"):
            shard_table(data, name, "file", None, "")


def test_any_tool_for_arrow_and_zstd_reads_one_table_after_the_other(tmp_path: Path) -> None:
    path = tmp_path / SHARD_FILE
    path.write_bytes(b"".join(shard(rows, name)[0] for name, rows in TABLES_OF_ONE.items()))
    with pa.input_stream(path) as stream:
        for rows in TABLES_OF_ONE.values():
            assert pa.ipc.open_stream(stream).read_all().equals(rows)


def test_every_changed_byte_and_every_cut_is_found() -> None:
    data, rows_hash = shard(TABLES_OF_ONE["t"])
    for at in range(len(data)):
        flipped = bytearray(data)
        flipped[at] ^= 1 << at % 8
        for bad in (bytes(flipped), data[:at]):
            with pytest.raises(CorruptShardError, match="checksum"):
                shard_table(bad, "t", "file", rows_hash, "")


def test_what_comes_before_a_table_may_be_damaged_but_never_gives_other_rows() -> None:
    first, _ = shard(TABLES_OF_ONE["tt"], "tt")
    second, rows_hash = shard(TABLES_OF_ONE["t"])
    for at in range(len(first)):
        flipped = bytearray(first)
        flipped[at] ^= 1 << at % 8
        try:
            assert shard_table(bytes(flipped) + second, "t", "file", rows_hash, "").equals(TABLES_OF_ONE["t"])
        except CorruptShardError:
            continue


def test_other_rows_are_found_by_their_hash() -> None:
    data, rows_hash = shard(table([{"f": 1.0}]))
    _, other = shard(table([{"f": 2.0}]))
    assert shard_table(data, "t", "file", None, "").equals(shard_table(data, "t", "file", rows_hash, ""))
    with pytest.raises(CorruptShardError, match="rows differ"):
        shard_table(data, "t", "file", other, "")


@pytest.mark.parametrize("size", [0, 7, 1 << 20, 1 << 62])
def test_a_forged_file_with_a_right_checksum_is_refused(size: int) -> None:
    data, rows_hash = shard(table([{"f": 1.0}]))
    facts = data[40:48] + struct.pack("<Q", size) + data[56:73]
    forged = data[:8] + hashlib.sha256(facts + data[73:]).digest() + facts + data[73:]
    with pytest.raises((CorruptShardError, MemoryError)):
        shard_table(forged, "t", "file", rows_hash, "")


def test_tables_that_an_earlier_release_committed_as_parquet_are_read(store: LocalStore) -> None:
    units = toys.units(6)
    first = run(toys.pipeline(), units, store)
    assert first.snapshot_id is not None
    before = toys.files(store, first.snapshot_id)
    for path in [*store.root.glob("units/*/*/*/unit.json")]:
        document = json.loads(path.read_bytes())
        whole = path.with_name(SHARD_FILE)
        for name, record in document["tables"].items():
            rows = shard_table(whole.read_bytes(), name, "file", record["logical_hash"], "")
            data = parquet_bytes(rows).to_pybytes()
            path.with_name(f"{name}.parquet").write_bytes(data)
            record |= {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
        whole.unlink()
        del document["checksum"], document["shard"]
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
