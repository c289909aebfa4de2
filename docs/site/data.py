"""Write ``docs/data.md``, every column of every table: ``python docs/site/data.py``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import pyarrow as pa

from schemas.generate import inner_fields
from schemas.tables import ABOUT, EXPORT_TABLES, SORT_KEYS, TABLES, TRAJECTORY_TABLES, description

FILE = Path(__file__).resolve().parents[1] / "data.md"


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
        "snapshot's folder, and `.read views.sql`.",
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


def _type(kind: pa.DataType) -> str:
    if pa.types.is_list(kind):
        return f"list of {_type(kind.value_type)}"
    return "struct" if pa.types.is_struct(kind) else str(kind)


if __name__ == "__main__":
    FILE.write_text(data_page(), encoding="utf-8")
