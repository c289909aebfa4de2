"""Write ``docs/data.md`` and ``docs/views.md``, every column of every table and view: ``python docs/site/data.py``."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import duckdb
import pyarrow as pa

from condvln.explorer.rejected import REASONS
from jobs.query import QUERIES, VIEWS
from schemas.generate import inner_fields
from schemas.tables import ABOUT, EXPORT_TABLES, SORT_KEYS, TABLES, TRAJECTORY_TABLES, description

FILE = Path(__file__).resolve().parents[1] / "data.md"
VIEWS_FILE = FILE.with_name("views.md")


def data_page() -> str:
    """Return the text of ``docs/data.md``: every column of every table."""
    parts = [
        "# The tables",
        "Made from the descriptions in `schemas/tables.yaml` by `python docs/site/data.py`. "
        "`schemas/json/tables.json` has the same for programs.",
        "A snapshot is a folder of Parquet files, `snapshots/<id>/<table>/source=<family>/part-*.parquet`; the family "
        "is the name of the folder, not a column of the files. Coordinates are metres in Habitat's frame: +Y up, "
        "−Z forward, east = +X, north = −Z. Positions are rounded to 1 mm. A struct of coordinates has the fields "
        "`x`, `y`, `z`.",
        "Until a run publishes, the rows of finished scenes are in the store already: a file a table and scene, "
        "`units/<stage>/…/<table>.parquet`, with the same columns.",
        "The published files carry these descriptions: `pyarrow.parquet.read_schema(FILE).field(NAME).metadata`. "
        "`views.sql` beside the tables makes the views of `condvln query` in DuckDB's own shell: start it in the "
        "snapshot's folder, and `.read views.sql`; [Views](views.md) has their columns.",
    ]
    parts += _sections(TABLES)
    parts.append(
        "# Tables of exports\n\nOne file each in the export's folder; `condvln query CONFIG` has them as tables."
    )
    parts += _sections(EXPORT_TABLES)
    parts.append(
        "# Tables of trajectories\n\n`condvln trajectories` writes them as one file each, with the family in a last "
        "column `source`; see [training data](training.md). Positions are not rounded: replayed actions give them "
        "again bit for bit. `schemas/json/trajectory-tables.json` has the same for programs."
    )
    parts += _sections(TRAJECTORY_TABLES)
    return "\n\n".join(parts) + "\n"


def _sections(schemas: Mapping[str, pa.Schema]) -> Iterator[str]:
    """Yield a section for each table."""
    for name, schema in schemas.items():
        keys = ", ".join(f"`{key}`" for key in SORT_KEYS[name])
        rows = [f"| `{f.name}` | {_type(f.type)} | {'yes' if f.nullable else ''} | {description(f)} |" for f in schema]
        table = "\n".join(["| column | type | may be null | meaning |", "|---|---|---|---|", *rows])
        yield f"## {name}\n\n{ABOUT[name]} Sorted by {keys}.\n\n{table}"
        inner = [f"| `{f.name}.{path}` | {about} |" for f in schema for path, about in inner_fields(f.type) if about]
        if inner:
            yield "\n".join(["| inside | meaning |", "|---|---|", *inner])


def view_columns(name: str) -> list[tuple[str, str, str]]:
    """Return the columns of a view: name, type and meaning, empty where neither `queries.sql` nor a table has it."""
    view = VIEWS[name]
    told = {"source": "family of the dataset"}
    for table in reversed(view.tables):
        told |= {field.name: description(field) for field in TABLES[table]}
    told |= dict(re.findall(r"^-- (\w+): (.*)$", view.sql, re.MULTILINE))
    with duckdb.connect() as connection:
        for table in view.tables:
            rows = TABLES[table].append(pa.field("source", pa.string())).empty_table()
            connection.register(table, rows)
        found = connection.execute(f"DESCRIBE {view.sql}").fetchall()
    return [(column, kind.lower(), told.get(column, "")) for column, kind, *_ in found]


def views_page() -> str:
    """Return the text of ``docs/views.md``: views with their columns, named queries, and reasons of rejections."""
    parts = [
        "# Views and named queries",
        "Made from `jobs/queries.sql` by `python docs/site/data.py`. `condvln query CONFIG SQL` reads views as it does "
        "the [tables](data.md).",
    ]
    for name, view in VIEWS.items():
        tables = ", ".join(f"`{table}`" for table in view.tables)
        rows = [f"| `{column}` | {kind} | {meaning} |" for column, kind, meaning in view_columns(name)]
        table = "\n".join(["| column | type | meaning |", "|---|---|---|", *rows])
        parts.append(f"## {name}\n\n{view.about[0].upper()}{view.about[1:]}, from {tables}.\n\n{table}")
    queries = [f"| `{name}` | {query.about} |" for name, query in QUERIES.items()]
    parts.append("\n".join(["## Named queries\n", "| name | answer |", "|---|---|", *queries]))
    parts.append(
        "## Reasons\n\nWhat the column `reason` of `rejections` says, and so the funnel. Draws of programs (stage "
        "`programs`) fail before there is a candidate; candidates (stage `episodes`) are rejected when they are "
        "placed. Queries have it as a table: `JOIN reasons USING (stage, reason)` adds the column `meaning`."
    )
    parts += [_reasons(stage, reasons) for stage, reasons in REASONS.items()]
    return "\n\n".join(parts) + "\n"


def _reasons(stage: str, reasons: Mapping[str, str]) -> str:
    """Return the table of the reasons of a stage."""
    return "\n".join(
        [f"| {stage} | reason |", "|---|---|", *(f"| `{name}` | {why} |" for name, why in reasons.items())]
    )


def _type(kind: pa.DataType) -> str:
    if pa.types.is_list(kind):
        return f"list of {_type(kind.value_type)}"
    return "struct" if pa.types.is_struct(kind) else str(kind)


if __name__ == "__main__":
    FILE.write_text(data_page(), encoding="utf-8")
    VIEWS_FILE.write_text(views_page(), encoding="utf-8")
