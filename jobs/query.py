"""``condvln query``: DuckDB over the published tables."""

from __future__ import annotations

import datetime
import decimal
from typing import Any

import duckdb

from jobs.report import Report, Section
from jobs.workspace import published
from schemas.config import Config
from schemas.errors import UsageError
from schemas.tables import TABLES

__all__ = ["connect", "run_query"]


def connect(config: Config) -> duckdb.DuckDBPyConnection:
    """An in-memory database with one view a table over exactly the files of the published snapshot."""
    snapshot = published(config)
    connection = duckdb.connect(":memory:")
    for name in TABLES:
        paths = [str(path) for path in snapshot.local_paths(name)]
        if paths:
            listed = ", ".join("'" + path.replace("'", "''") + "'" for path in paths)
            connection.execute(
                f"CREATE VIEW {name} AS SELECT * FROM read_parquet([{listed}], hive_partitioning = true)"
            )
    # A query may read the views; files beyond them and settings are not its business.
    connection.execute("SET lock_configuration = true")
    return connection


def run_query(config: Config, sql: str) -> Report:
    """Rows of one query. Raises UsageError with DuckDB's own message."""
    with connect(config) as connection:
        try:
            result = connection.execute(sql)
            columns = [column[0] for column in result.description or ()]
            rows = result.fetchall()
        except duckdb.Error as error:
            raise UsageError(str(error).strip(), place="SQL", remedy=f"Tables: {', '.join(TABLES)}.") from None
    plain = [[_plain(value) for value in row] for row in rows]
    return Report({"columns": columns, "rows": plain}, [], [Section("", columns, [*plain])])


def _plain(value: Any) -> Any:
    if isinstance(value, decimal.Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, datetime.date | datetime.datetime):
        return value.isoformat()
    return value
