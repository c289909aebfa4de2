"""The files of a unit: any tool reads the tables before anything is published, and no damage goes unseen."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import toys
from faulty import FaultyStore

from factory.commits import Commits
from factory.run import plan, run
from factory.snapshot import Snapshot
from factory.status import store_status
from factory.store import LocalStore
from schemas.errors import CorruptShardError, StoreError


@pytest.fixture
def unpublished(store: LocalStore) -> LocalStore:
    """A store of a run that died before it wrote a snapshot."""
    with pytest.raises(StoreError, match="injected"):
        run(toys.pipeline(), toys.units(8), FaultyStore(store.root, "snapshot-before-parts=full"))
    assert not (store.root / "refs").exists()
    return store


def test_duckdb_reads_the_tables_of_units_before_anything_is_published(unpublished: LocalStore) -> None:
    rows = sum(unit.inputs[0].size for unit in toys.units(8))
    for name, found in (("squares", rows), ("numbers", rows), ("scratch", 7)):
        (counted,) = duckdb.sql(f"SELECT count(*) FROM '{unpublished.root}/units/**/{name}.parquet'").fetchall()
        assert counted == (found,)
    units = duckdb.sql(f"SELECT unit, sum(n) FROM '{unpublished.root}/units/**/numbers.parquet' GROUP BY unit")
    assert dict(units.fetchall()) == {
        unit.unit_id: sum(range(unit.inputs[0].size)) for unit in toys.units(8) if unit.inputs[0].size
    }


def test_the_same_unit_gives_the_same_bytes(store: LocalStore, tmp_path: Path) -> None:
    other = LocalStore(tmp_path / "other", durable=False)
    for one in (store, other):
        run(toys.pipeline(), toys.units(8), one)

    def tables(one: LocalStore) -> dict[str, bytes]:
        return {str(path.relative_to(one.root)): path.read_bytes() for path in (one.root / "units").rglob("*.parquet")}

    assert tables(store) == tables(other)


def removed(path: Path) -> None:
    path.unlink()


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def other_rows(path: Path) -> None:
    """A sound file of the same columns."""
    table = pq.ParquetFile(path).read()
    pq.write_table(table.slice(0, table.num_rows - 1), path)


DAMAGES = [removed, cut, emptied, other_rows]


@pytest.mark.parametrize("name", ["squares.parquet", "scratch.parquet", "blob.bin", "unit.json"])
@pytest.mark.parametrize("damage", DAMAGES, ids=[damage.__name__ for damage in DAMAGES])
def test_a_damaged_unit_is_stale_and_made_again(store: LocalStore, name: str, damage: Callable[[Path], None]) -> None:
    if damage is other_rows and not name.endswith(".parquet"):
        damage = emptied
    units = toys.units(6)
    before = run(toys.pipeline(), units, store)
    path = next(path for path in (store.root / "units/square").rglob(name) if path.stat().st_size)
    whole = path.read_bytes()
    damage(path)
    assert plan(toys.pipeline(), units, store).reasons == {"damaged": 1}
    assert store_status(store).refs[0].damaged
    again = run(toys.pipeline(), units, store)
    assert (again.snapshot_id, again.stages) == (before.snapshot_id, {"square": 1})
    # A commit holds seconds and is never the same again; the tables are.
    assert path.read_bytes() == whole or name == "unit.json"
    assert plan(toys.pipeline(), units, store).unchanged


def test_every_changed_byte_of_a_table_is_found(store: LocalStore) -> None:
    run(toys.pipeline(), [toys.unit("a/x", 3)], store)
    commits = Commits(store)
    (key,) = [key for stage, key in commits.committed() if stage == "square"]
    whole = commits.table("square", key, "squares")
    path = store.root / commits.folder("square", key) / "squares.parquet"
    data = path.read_bytes()
    for at in range(len(data)):
        path.write_bytes(data[:at] + bytes([data[at] ^ 1 << at % 8]) + data[at + 1 :])
        with pytest.raises(CorruptShardError, match="differ from their recorded hash"):
            commits.table("square", key, "squares")
    path.write_bytes(data)
    assert commits.table("square", key, "squares").equals(whole)
    with pytest.raises(CorruptShardError, match="rows differ"):
        commits.table("square", key, "squares", "0" * 32)
    with pytest.raises(CorruptShardError, match="rows differ"):
        commits.table("square", key, "circles")


def test_a_stage_may_not_write_a_file_in_place_of_a_table(store: LocalStore) -> None:
    class Overwriting(toys.Square):
        def run(self, *arguments: object) -> toys.StageOutput:  # type: ignore[override]
            done = super().run(*arguments)  # type: ignore[arg-type]
            return toys.StageOutput(done.tables, files={"squares.parquet": b""})

    report = run(toys.pipeline(square=Overwriting()), toys.units(1), store)
    (_, failure) = report.failures[0]
    assert "reserved name" in failure.message


@pytest.mark.parametrize("version", [None, 1, 3])
def test_a_store_of_another_release_is_refused(store: LocalStore, version: int | None) -> None:
    run(toys.pipeline(), toys.units(2), store)
    path = store.root / "refs/main.json"
    ref = json.loads(path.read_bytes())
    ref.pop("store_version")
    path.write_text(json.dumps(ref if version is None else {**ref, "store_version": version}))
    before = path.read_bytes()
    for verb in (
        lambda: plan(toys.pipeline(), toys.units(2), store),
        lambda: run(toys.pipeline(), toys.units(2), store),
        lambda: Snapshot.open(store),
        lambda: store_status(store),
    ):
        with pytest.raises(StoreError, match=r"another release.*condvln generate"):
            verb()
    assert path.read_bytes() == before


def test_types_come_back_as_they_were(store: LocalStore) -> None:
    """Of a table without a contract, too, which keeps its own types."""
    rows = pa.table({"n": pa.array([1, None], pa.int8()), "t": pa.array([[["a"], []], None]), "d": [b"x", b""]})

    class Own(toys.Word):
        def run(self, *arguments: object) -> toys.StageOutput:  # type: ignore[override]
            done = super().run(*arguments)  # type: ignore[arg-type]
            return toys.StageOutput({**done.tables, "own": rows})

    pipeline = toys.pipeline(word=Own(tables=("texts", "own")))
    run(pipeline, [toys.unit("a/x", 3)], store)
    assert Snapshot.open(store).unit_table("a/x", pipeline, "own").equals(rows)
