"""``condvln query``: DuckDB over the published tables."""

from __future__ import annotations

import datetime
import decimal
import hashlib
import json
import re
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import duckdb

from condvln.export.contents import exported_snapshot, file_hashes
from condvln.export.tables import SPLITS_TABLE
from condvln.formats.streams import atomic_path
from jobs.report import Report, Section
from jobs.workspace import Target
from schemas.errors import UsageError
from schemas.tables import TABLES

__all__ = ["QUERIES", "VIEWS", "connect", "list_queries", "query_target", "views_sql"]


class Statement(NamedTuple):
    """A view over the published tables, or a query that ``condvln query TARGET NAME`` runs.

    about : one line; tables : the published tables that a view reads
    """

    about: str
    sql: str
    tables: tuple[str, ...] = ()


def _statements(kind: str) -> dict[str, Statement]:
    """Return the statements of ``queries.sql`` of one kind, by name."""
    text = Path(__file__).with_name("queries.sql").read_text(encoding="utf-8")
    found = re.findall(rf"^-- {kind}: (\S+)(?: of (.+))?\n-- (.*)\n([^;]*);", text, re.MULTILINE)
    return {name: Statement(about, sql, tuple(tables.split(", "))) for name, tables, about, sql in found}


VIEWS: Final = _statements("view")
QUERIES: Final = _statements("query")

WIDE: Final = 12
"""Columns up to which a result is printed as one table."""
LONGEST: Final = 200
"""Characters of an id or a nested value that are printed; ``--json`` and ``--out`` give all."""

_VIEWS_HEAD: Final = """\
-- The tables of this snapshot and the views of `condvln query`, for DuckDB started in this folder: .read views.sql
-- Started elsewhere, it finds the files after: SET file_search_path = 'this folder';
"""
_SPLITS_NEED: Final = "The table splits is there for a configuration whose export is in place: condvln export CONFIG."

_WRITERS: Final = {".parquet": "PARQUET", ".csv": "CSV", ".json": "JSON", ".jsonl": "JSON"}
"""Formats of ``--out``, by the suffix of the file."""


def connect(target: Target, sql: str = "") -> duckdb.DuckDBPyConnection:
    """Open an in-memory database that holds a view of each published table, over exactly the files of the snapshot, the
    views of VIEWS and, where the configuration's export is in place, its table `splits`.

    sql : what will be asked; where the store is elsewhere, only the tables that it reads are fetched. All by default.
    """
    snapshot = target.snapshot()
    wanted = _tables_of(sql) if sql else None
    folder = target.folder(wanted)
    connection = duckdb.connect(":memory:")
    paths: dict[str, list[str]] = {}
    for name in TABLES:
        if name in snapshot.manifest.tables and (wanted is None or name in wanted):
            partitions = snapshot.manifest.tables[name].partitions
            paths[name] = [str(folder / part.path) for p in sorted(partitions) for part in partitions[p].parts]
    splits = _splits_of(target)
    # A query may read these files; others, the network and the settings are not its business.
    everything = [path for found in (*paths.values(), splits) for path in found]
    connection.execute(f"SET allowed_paths = [{_quoted(everything)}]")
    connection.execute("SET enable_external_access = false")
    for name, found in paths.items():
        if found:
            connection.execute(
                f"CREATE VIEW {name} AS SELECT * FROM read_parquet([{_quoted(found)}], hive_partitioning = true)"
            )
    for name, view in VIEWS.items():
        if all(paths.get(table) for table in view.tables):
            connection.execute(f"CREATE VIEW {name} AS {view.sql}")
    if not sql or "reasons" in sql:
        from condvln.explorer.rejected import REASONS  # loads the science

        told = ", ".join(f"({_quoted((stage, *one))})" for stage, own in REASONS.items() for one in own.items())
        connection.execute(f"CREATE VIEW reasons AS SELECT * FROM (VALUES {told}) AS t(stage, reason, meaning)")
    if splits:
        connection.execute(f"CREATE VIEW splits AS SELECT * FROM read_parquet([{_quoted(splits)}])")
    connection.execute("SET lock_configuration = true")
    return connection


def _splits_of(target: Target) -> list[str]:
    """Return the path of the table `splits` in the configuration's export; none without a file there."""
    export = None if target.config is None else target.config.export
    path = None if export is None else export / SPLITS_TABLE
    return [str(path)] if path is not None and path.is_file() else []


def views_sql(folder: str = "") -> str:
    """Return statements that make the views over a snapshot's folder in DuckDB's own shell. `folder` is the address of
    one that is not on this machine's disk, with a slash at its end.
    """
    tables = {
        name: f"SELECT * FROM read_parquet('{folder}{name}/*/*.parquet', hive_partitioning = true)" for name in TABLES
    }
    made = [f"CREATE OR REPLACE VIEW {name} AS\n{sql};" for name, sql in tables.items()]
    made += [f"-- {view.about}\nCREATE OR REPLACE VIEW {name} AS\n{view.sql};" for name, view in VIEWS.items()]
    return "\n".join((_VIEWS_HEAD, *made)) + "\n"


def _quoted(paths: Iterable[str]) -> str:
    return ", ".join("'" + path.replace("'", "''") + "'" for path in paths)


def _tables_of(sql: str) -> set[str]:
    """Return the published tables that a query reads, directly or through views; all of them if that can't be
    determined.
    """
    try:
        with duckdb.connect(":memory:") as connection:
            named = {name.lower() for name in connection.get_table_names(sql)}
    except duckdb.Error:
        return {*TABLES}
    named = named.union(*(VIEWS[name].tables for name in named & VIEWS.keys()))
    return named & {*TABLES} or {*TABLES}


def query_target(target: Target, sql: str, out: Path | None = None) -> Report:
    """Run an SQL query or a named query, and write its rows to `out` if given (Parquet, CSV or JSON by its suffix).

    Raises UsageError with DuckDB's own message.
    """
    if sql in QUERIES:
        sql = QUERIES[sql].sql
    with connect(target, sql) as connection:
        try:
            result = connection.sql(sql)
            if result is None:
                raise UsageError("the statement gives no rows", place="SQL", remedy="Use a SELECT statement.")
            if out is not None:
                written = _write(result, out)
                written.lines += _outdated(target, sql)
                return written
            columns, rows = result.columns, result.fetchall()
        except duckdb.Error as error:
            remedy = f"Tables: {', '.join(TABLES)}. Views: {', '.join(VIEWS)}. Named queries: --list. {_SPLITS_NEED}"
            if "file system operations are disabled" in str(error):
                remedy = "Query other files beside the tables in DuckDB's own Python: docs/cookbook.md shows how."
            raise UsageError(str(error).strip(), place="SQL", remedy=remedy) from None
    plain = [[_plain(value) for value in row] for row in rows]
    lines = [*_outdated(target, sql), *([] if plain else ["0 rows"])]
    return Report({"columns": columns, "rows": plain}, lines, _sections(columns, plain))


def _outdated(target: Target, sql: str) -> list[str]:
    """Return a line that says so if a query asks for `splits` and the export is that of another snapshot, or its table
    is not what the export wrote.
    """
    found = _splits_of(target) if "splits" in sql.lower() else []
    if not found:
        return []
    path = Path(found[0])
    exported, published = exported_snapshot(path.parent), target.snapshot().snapshot_id
    if exported != published:
        return [
            f"splits is of the export of snapshot {exported}, the other tables of {published}: "
            "run condvln export CONFIG"
        ]
    if hashlib.sha256(path.read_bytes()).hexdigest() != file_hashes(path.parent).get(SPLITS_TABLE):
        return [f"{path} is not what the export wrote: run condvln export CONFIG"]
    return []


def _sections(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[Section]:
    """Return the table of a result; of a wide one a table for each row, with a line for each column."""
    shown = [[_shown(name, value) for name, value in zip(columns, row, strict=True)] for row in rows]
    if len(columns) <= WIDE:
        return [Section("", columns, [*shown])]
    return [
        Section(f"row {number}", ("column", "value"), [*zip(columns, row, strict=True)])
        for number, row in enumerate(shown, start=1)
    ]


def _shown(name: str, value: Any) -> Any:
    """Return a value as people read it: ids without thousands separators, long nested values cut."""
    if name.endswith("id") or isinstance(value, list | dict):
        return textwrap.shorten(str(value), LONGEST, placeholder=" …")
    return value


def list_queries() -> Report:
    """List tables, views and named queries."""
    document: dict[str, Any] = {
        kind: {name: {"about": one.about, "sql": one.sql} for name, one in found.items()}
        for kind, found in (("queries", QUERIES), ("views", VIEWS))
    }
    document["tables"] = {name: schema.names for name, schema in TABLES.items()}
    sections = [
        Section("Named queries: condvln query TARGET NAME", ("name", "answer"), _abouts(QUERIES)),
        Section("Views", ("name", "rows"), _abouts(VIEWS)),
        Section(
            "Tables, each with the column source",
            ("name", "columns"),
            [(name, ", ".join(schema.names)) for name, schema in TABLES.items()],
        ),
    ]
    return Report(document, [], sections)


def _abouts(statements: dict[str, Statement]) -> list[Sequence[Any]]:
    return [(name, one.about) for name, one in statements.items()]


def _write(result: duckdb.DuckDBPyRelation, out: Path) -> Report:
    """Write the rows to `out` through Arrow, since the database itself is not allowed to open files."""
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    kind = _WRITERS.get(out.suffix.lower())
    if kind is None:
        raise UsageError(
            f"{out.suffix!r} is not a format of query results", where=out, remedy=f"Write to {', '.join(_WRITERS)}."
        )
    table = result.to_arrow_table()
    with atomic_path(out) as part:
        if kind == "PARQUET":
            pa.parquet.write_table(table, part, compression="zstd")
        elif kind == "CSV":
            try:
                pa.csv.write_csv(table, part)
            except pa.ArrowException as error:
                raise UsageError(f"CSV holds no nested columns: {error}", where=out, remedy="Write Parquet.") from None
        else:
            with part.open("w", encoding="utf-8") as handle:
                for batch in table.to_batches():
                    for row in batch.to_pylist():
                        handle.write(json.dumps(row, ensure_ascii=False, default=str) + "\n")
    return Report({"rows": table.num_rows, "out": str(out)}, [f"{table.num_rows} rows in {out}"])


def _plain(value: Any) -> Any:
    if isinstance(value, decimal.Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, datetime.date | datetime.datetime):
        return value.isoformat()
    return value
