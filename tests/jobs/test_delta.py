"""The eight published tables as Delta tables, on disk and in a bucket."""

from __future__ import annotations

import json
import secrets
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from factory.delta_types import delta_schema
from factory.snapshot import read_ref
from jobs.command import app
from jobs.delta import export_delta
from jobs.report import Report
from jobs.target import Target
from schemas.config import Config
from schemas.errors import UsageError
from schemas.tables import SORT_KEYS, TABLES
from tests.read_delta import read_delta


def check(target: Target, root: str, folder: Path, options: dict[str, str]) -> None:
    """delta-rs reads of every table what the snapshot holds: columns, types, nulls, nested values."""
    deltalake = pytest.importorskip("deltalake")
    snapshot = target.snapshot()
    assert snapshot.manifest.tables.keys() == TABLES.keys()
    every = read_delta(folder, [(f"{root}/{name}", None) for name in TABLES], options)
    for (name, schema), found in zip(TABLES.items(), every, strict=True):
        table = deltalake.DeltaTable(f"{root}/{name}", storage_options=options)
        assert json.loads(table.schema().to_json()) == delta_schema(schema, "source")
        expected = snapshot.table(name)
        order = [(key, "ascending") for key in ("source", *SORT_KEYS[name])]
        cast = found.select(expected.column_names).cast(expected.schema) if expected.num_rows else found
        assert cast.num_rows == expected.num_rows == snapshot.manifest.tables[name].rows, name
        if expected.num_rows:
            assert cast.sort_by(order).to_pylist() == expected.sort_by(order).to_pylist(), name
    assert snapshot.manifest.tables["episodes"].rows


def test_all_eight_tables_on_disk(made_run: tuple[Config, Report], tmp_path: Path) -> None:
    target = Target(made_run[0].store, None)
    root = tmp_path / "lake house"
    document = export_delta(target, str(root)).document
    assert (document["written"], document["snapshot_id"]) == (8, target.snapshot().snapshot_id)
    check(target, str(root), tmp_path, {})
    assert export_delta(target, str(root)).document["written"] == 0
    ref, _ = read_ref(target.store(), "made")
    assert ref is not None
    entry = (root / "rooms" / "_delta_log" / f"{0:020d}.json").read_text().splitlines()[0]
    deltalake = pytest.importorskip("deltalake")
    assert json.loads(entry)["commitInfo"]["timestamp"] > 1_000_000_000_000
    table = deltalake.DeltaTable(str(root / "rooms"))
    assert table.history()[0]["userMetadata"] == ref.snapshot_id


def test_all_eight_tables_in_a_bucket(made_away: Config, s3_server: str, tmp_path: Path) -> None:
    target = Target(made_away.store, made_away.name)
    folder = f"delta/{secrets.token_hex(6)}"
    export_delta(target, f"s3://bucket/{folder}?endpoint={s3_server}")
    options = {"AWS_ENDPOINT_URL": s3_server, "AWS_ALLOW_HTTP": "true"}
    check(target, f"s3://bucket/{folder}", tmp_path, options)


def test_logs_stand_where_the_store_keeps_nothing(
    made_run: tuple[Config, Report], made_away: Config, s3_server: str
) -> None:
    here, away = Target(made_run[0].store, None), Target(made_away.store, None)
    store = Path(made_run[0].store)
    before = sorted(path for path in store.rglob("*"))
    for place in (store, store / "snapshots", store / "units" / "x", store / "delta" / ".." / "refs"):
        with pytest.raises(UsageError, match="keeps its own files"):
            export_delta(here, str(place))
    with pytest.raises(UsageError, match="on this machine's disk"):
        export_delta(here, f"s3://bucket/x?endpoint={s3_server}")
    address, _, query = str(made_away.store).partition("?")
    for place_away in (address, f"{address}/snapshots/x"):
        with pytest.raises(UsageError, match="keeps its own files"):
            export_delta(away, f"{place_away}?{query}")
    assert sorted(path for path in store.rglob("*")) == before


def test_the_verb_takes_a_store_or_a_configuration(made_run: tuple[Config, Report], tmp_path: Path) -> None:
    def call(*words: str) -> dict[str, Any]:
        result = CliRunner().invoke(app, ["delta", *words, "--json"])
        assert result.exit_code == 0, result.output
        return dict(json.loads(result.output))

    store = str(made_run[0].store)
    told = call(store, str(tmp_path / "delta"))
    assert {name: table["version"] for name, table in told["tables"].items()} == dict.fromkeys(TABLES, 0)
    assert call(store, str(tmp_path / "delta"), "--ref", "made")["written"] == 0
    assert CliRunner().invoke(app, ["delta", store]).exit_code != 0
