"""SQL over what is published: views, named queries, and nothing beyond the snapshot's files; the cookbook runs."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import duckdb
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from condvln.explorer.rejected import REASONS
from factory.object_store import ObjectStore
from factory.snapshot import Snapshot
from jobs.command import app
from jobs.query import QUERIES, VIEWS, connect, list_queries, query_target, views_sql
from jobs.report import Report
from jobs.workspace import Target
from schemas.config import Config
from schemas.errors import UsageError
from schemas.program import SHAPES
from schemas.tables import TABLES

COOKBOOK = Path(__file__).parents[2] / "docs" / "cookbook.md"


@pytest.fixture(scope="module")
def target(made_run: tuple[Config, Report], export: Path) -> Target:
    config, _ = made_run
    return Target(config.store, config.name, config.model_copy(update={"export": export}))


@pytest.fixture(scope="module")
def snapshot(target: Target) -> Snapshot:
    return target.snapshot()


def rows(target: Target, sql: str) -> list[dict[str, Any]]:
    document = query_target(target, sql).document
    return [dict(zip(document["columns"], row, strict=True)) for row in document["rows"]]


def test_tables_hold_what_the_snapshot_does(target: Target, snapshot: Snapshot) -> None:
    for name, schema in TABLES.items():
        (found,) = rows(target, f"SELECT count(*) AS n FROM {name}")
        assert found["n"] == snapshot.manifest.tables[name].rows
        columns = rows(target, f"DESCRIBE {name}")
        assert {column["column_name"] for column in columns} == {*schema.names, "source"}


def test_people_read_wide_rows_as_lines_and_ids_as_ids(target: Target) -> None:
    """A row of many columns becomes a table of its own; the document for scripts has the values as they are."""
    report = query_target(target, "SELECT * FROM episodes LIMIT 2")
    assert [section.title for section in report.sections] == ["row 1", "row 2"]
    for section, row in zip(report.sections, report.document["rows"], strict=True):
        assert [name for name, _ in section.rows] == report.document["columns"]
        nested = [k for k, value in enumerate(row) if isinstance(value, list | dict)]
        assert all(len(section.rows[k][1]) <= 200 for k in nested)
        assert any(section.rows[k][1].endswith(" …") for k in nested)
        number = row[report.document["columns"].index("episode_id")]
        assert isinstance(number, int)
        assert dict(section.rows)["episode_id"] == str(number)
    narrow = query_target(target, "SELECT episode_id, 12345 AS n FROM episodes LIMIT 2")
    (table,) = narrow.sections
    assert [row[1] for row in table.rows] == [12345, 12345]
    assert [row[0] for row in table.rows] == [str(row[0]) for row in narrow.document["rows"]]


def test_a_query_without_rows_says_so(target: Target) -> None:
    assert query_target(target, "skipped").lines == ["0 rows"]
    assert query_target(target, "overview").lines == []


def test_each_reason_of_rejection_has_its_meaning(target: Target) -> None:
    found = rows(target, "rejections")
    assert found
    assert {(row["stage"], row["reason"]): row["meaning"] for row in found} == {
        (row["stage"], row["reason"]): REASONS[row["stage"]][row["reason"]] for row in found
    }


def test_leaves_and_conditions_are_the_nested_ones_one_by_one(target: Target, snapshot: Snapshot) -> None:
    episodes = snapshot.table("episodes").to_pylist()
    instructions = {row["instruction_id"]: row for row in snapshot.table("instructions").to_pylist()}
    found = {(row["episode_id"], row["leaf"]): row for row in rows(target, "SELECT * FROM leaves")}
    assert len(found) == sum(row["n_leaves"] for row in episodes)
    for row in episodes:
        moves = [leaf["moves"][-1] for leaf in instructions[row["instruction_id"]]["leaves"]]
        for leaf in row["leaves"]:
            seen = found[row["episode_id"], leaf["leaf"]]
            assert seen["gold"] == (leaf["leaf"] == row["gold_leaf"])
            assert (seen["object_id"], seen["n_goals"]) == (leaf["object_id"], len(leaf["goals"]))
            assert (seen["label"], seen["room"]) == (
                moves[leaf["leaf"]]["label"],
                moves[leaf["leaf"]]["room"]["label"],
            )
            assert moves[leaf["leaf"]]["object_id"] == leaf["object_id"]
    gold = rows(target, "SELECT episode_id, label FROM leaves WHERE gold")
    assert {row["episode_id"]: row["label"] for row in gold} == {r["episode_id"]: r["gold_label"] for r in episodes}
    conditions = rows(target, "SELECT * FROM conditions ORDER BY instruction_id, condition")
    expected = [
        (name, at, c["label"], c["room"]["label"], c["truth"], (c["qualifier"] or {}).get("predicate"))
        for name, row in sorted(instructions.items())
        for at, c in enumerate(row["conditions"])
    ]
    assert [
        (c["instruction_id"], c["condition"], c["label"], c["room"], c["truth"], c["predicate"]) for c in conditions
    ] == expected


def test_splits_are_those_of_the_manifests(target: Target, export: Path, tmp_path: Path) -> None:
    listed = [
        (json.loads(line)["episode_id"], path.stem)
        for path in (export / "manifest").glob("*.jsonl")
        for line in path.read_text().splitlines()
    ]
    found = rows(
        target, "SELECT episode_id, split, depth, chain, category FROM episodes JOIN splits USING (episode_id)"
    )
    assert sorted((row["episode_id"], row["split"]) for row in found) == sorted(listed)
    for row in found:
        shape = SHAPES[row["category"]]
        assert (row["depth"], row["chain"]) == (shape.depth, shape.chain)
    assert not query_target(target, "SELECT count(*) FROM splits").lines
    (tmp_path / "splits.parquet").write_bytes((export / "splits.parquet").read_bytes())
    assert target.config is not None
    stale = Target(target.address, target.name, target.config.model_copy(update={"export": tmp_path}))
    assert "condvln export" in query_target(stale, "SELECT count(*) FROM splits").lines[0]
    written = query_target(stale, "SELECT * FROM splits", tmp_path / "splits.csv")
    assert "of the export of snapshot" in written.lines[-1]
    # Cut short, it would give smaller numbers without a word.
    for name in ("export.json", "splits.parquet"):
        (tmp_path / name).write_bytes((export / name).read_bytes())
    assert not query_target(stale, "SELECT count(*) FROM splits").lines
    pq.write_table(pq.read_table(export / "splits.parquet").slice(1), tmp_path / "splits.parquet")
    assert "not what the export wrote" in query_target(stale, "SELECT count(*) FROM splits").lines[0]
    with pytest.raises(UsageError, match="condvln export"):
        query_target(Target(target.address, target.name), "SELECT count(*) FROM splits")


def test_published_files_describe_their_columns_and_views_sql_reads_them(target: Target, export: Path) -> None:
    folder = target.folder()
    described = {name: next((folder / name).rglob("*.parquet")) for name in TABLES}
    for name, path in described.items():
        schema = pq.read_schema(path)
        assert {f.name: f.metadata[b"description"] for f in schema} == {
            f.name: f.metadata[b"description"] for f in TABLES[name]
        }
    assert pq.read_schema(export / "splits.parquet").field("split").metadata[b"description"]
    assert {path.name for path in folder.iterdir() if path.is_dir() and not path.name.startswith("_")} == {*TABLES}
    with duckdb.connect() as connection:
        connection.execute(f"SET file_search_path = '{folder}'")
        connection.execute((folder / "views.sql").read_text())
        for name in (*TABLES, *VIEWS):
            (counted,) = connection.execute(f"SELECT count(*) FROM {name}").fetchone() or ()
            assert [{"n": counted}] == rows(target, f"SELECT count(*) AS n FROM {name}")
    with duckdb.connect() as elsewhere:  # the views of a store that is on no disk name its address
        elsewhere.execute(views_sql(f"{folder}/"))
        (counted,) = elsewhere.execute("SELECT count(*) FROM episodes").fetchone() or ()
        assert [{"n": counted}] == rows(target, "SELECT count(*) AS n FROM episodes")


def test_labelled_relations_are_those_between_objects(target: Target) -> None:
    (between,) = rows(target, "SELECT count(*) AS n FROM relations WHERE kind <> 'containment'")
    (labelled,) = rows(target, "SELECT count(*) AS n, count(subject_label) AS s FROM labelled_relations")
    assert labelled == {"n": between["n"], "s": between["n"]}


@pytest.mark.parametrize("name", [*QUERIES])
def test_every_named_query_runs(target: Target, name: str) -> None:
    found = query_target(target, name).document
    assert found["columns"]
    # These tell of exceptions, which a sound made corpus may lack.
    if name not in ("skipped", "warnings", "groups"):
        assert found["rows"]


def test_named_numbers_are_those_of_the_tables(target: Target, snapshot: Snapshot) -> None:
    (overview,) = rows(target, "overview")
    manifest = snapshot.manifest
    assert overview == {
        "source": "replicacad",
        "scenes": manifest.units["ok"],
        "skipped": 0,
        "rooms": manifest.tables["rooms"].rows,
        "objects": manifest.tables["objects"].rows,
        "instructions": manifest.tables["instructions"].rows,
        "episodes": manifest.tables["episodes"].rows,
    }
    assert sum(row["episodes"] for row in rows(target, "categories")) == overview["episodes"]
    assert sum(row["share"] for row in rows(target, "gold-labels")) == pytest.approx(1.0, abs=1e-2)


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT * FROM read_csv('/etc/passwd')",
        "SELECT * FROM read_text('/etc/passwd')",
        "SELECT * FROM glob('/etc/*')",
        "COPY scenes TO 'stolen.csv'",
        "ATTACH 'stolen.db'",
        "SET enable_external_access = true",
        "INSTALL httpfs",
        "SELECT * FROM nothing",
        "SELEC",
        "",
    ],
)
def test_a_query_reads_the_snapshot_and_nothing_else(target: Target, sql: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError):
        query_target(target, sql)
    assert not Path("stolen.csv").exists()


def test_rows_are_written_to_files(target: Target, snapshot: Snapshot, tmp_path: Path) -> None:
    sql = "SELECT episode_id, words FROM episodes ORDER BY episode_id"
    expected = [(row["episode_id"], row["words"]) for row in rows(target, sql)]
    for name in ("a.parquet", "b/c.csv", "d.jsonl"):
        assert query_target(target, sql, tmp_path / name).document["rows"] == len(expected)
    assert [(r["episode_id"], r["words"]) for r in pq.read_table(tmp_path / "a.parquet").to_pylist()] == expected
    with open(tmp_path / "b" / "c.csv", newline="") as handle:
        assert [(int(r["episode_id"]), int(r["words"])) for r in csv.DictReader(handle)] == expected
    lines = [json.loads(line) for line in (tmp_path / "d.jsonl").read_text().splitlines()]
    assert [(r["episode_id"], r["words"]) for r in lines] == expected
    with pytest.raises(UsageError, match="Write to"):
        query_target(target, sql, tmp_path / "x.xlsx")
    with pytest.raises(UsageError, match="nested"):
        query_target(target, "SELECT leaves FROM episodes", tmp_path / "x.csv")


def test_a_store_away_answers_the_same_and_fetches_only_what_is_asked(
    made_away: Config, target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    away = Target(made_away.store, None)
    fetched: list[str] = []
    read = ObjectStore.read
    monkeypatch.setattr(ObjectStore, "read", lambda self, path: (fetched.append(path), read(self, path))[1])
    assert rows(away, "categories") == rows(target, "categories")
    assert {path.split("/")[2] for path in fetched if path.endswith(".parquet")} == {"episodes"}
    sql = "SELECT * FROM leaves ORDER BY episode_id, leaf"
    assert rows(away, sql) == rows(target, sql)
    assert {path.split("/")[2] for path in fetched if path.endswith(".parquet")} == {"episodes", "instructions"}


def test_the_list_tells_everything_there_is(made_run: tuple[Config, Report]) -> None:
    document = list_queries().document
    assert [*document["queries"]] == [*QUERIES]
    assert [*document["views"]] == [*VIEWS]
    result = CliRunner().invoke(app, ["query", str(made_run[0].store), "--list"])
    assert result.exit_code == 0
    assert all(name in result.output for name in (*QUERIES, *VIEWS, *TABLES))
    assert CliRunner().invoke(app, ["query", str(made_run[0].store)]).exit_code != 0


# ---- the cookbook

BLOCKS = re.findall(r"^```(sql|python)\n(.*?)^```", COOKBOOK.read_text(encoding="utf-8"), re.M | re.S)


@pytest.mark.parametrize("at", range(len(BLOCKS)))
def test_every_recipe_runs(
    at: int, target: Target, made_away: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    language, text = BLOCKS[at]
    if language == "sql":
        document = query_target(target, text).document
        assert document["columns"]
        assert document["rows"] or "-- may be empty" in text
        return
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"SNAPSHOT": target.folder(), "STORE": target.address, "ADDRESS": made_away.store}
    if "deltalake" in text:
        namespace["LAKE"] = tmp_path / "lake"
    if "SCORES" in text:
        scored = [{"episode_id": row["episode_id"], "success": 1.0} for row in rows(target, "SELECT * FROM episodes")]
        namespace["SCORES"] = tmp_path / "scores.jsonl"
        namespace["SCORES"].write_text("".join(json.dumps(row) + "\n" for row in scored))
    exec(compile(text, f"cookbook block {at}", "exec"), namespace)
    assert len(namespace["answer"]), "a recipe in Python leaves its rows in `answer`"


def test_the_cookbook_shows_every_named_query_and_view(target: Target) -> None:
    text = COOKBOOK.read_text(encoding="utf-8")
    assert all(f"`{name}`" in text for name in (*QUERIES, *VIEWS))
    with connect(target) as connection:
        assert connection.execute("SELECT count(*) FROM leaves").fetchone() is not None


@pytest.mark.parametrize(
    "sql",
    [
        "-- all episodes\nSELECT count(*) AS n FROM episodes",
        "--all=of them\nSELECT count(*) AS n FROM episodes",
        "-- ref = main, out\n-- json\nSELECT count(*) AS n FROM episodes -- all",
        "/* all */ SELECT count(*) AS n FROM episodes",
        "--json \nSELECT count(*) AS n FROM episodes",
    ],
)
@pytest.mark.parametrize("end", [True, False], ids=["options before", "options after"])
def test_sql_may_begin_with_a_comment(made_run: tuple[Config, Report], snapshot: Snapshot, sql: str, end: bool) -> None:
    words = [str(made_run[0].store), *([sql, "--json"] if end else ["--json", sql])]
    result = CliRunner().invoke(app, ["query", *words])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["rows"] == [[snapshot.manifest.tables["episodes"].rows]]


def test_an_unknown_option_is_still_an_error(made_run: tuple[Config, Report]) -> None:
    result = CliRunner().invoke(app, ["query", str(made_run[0].store), "SELECT 1", "--jsn"])
    assert result.exit_code == 2
    assert "No such option" in result.output
