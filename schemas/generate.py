"""Write the JSON Schema of every document and the description of every table: ``python -m schemas.generate``.

The tables are described twice: for programs in ``schemas/json/tables.json``, for people in ``docs/data.md``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, TypeAlias

import pyarrow as pa
from pydantic import BaseModel

from schemas.benchmark import BenchmarkFile, BenchmarkRecord, Leaderboard
from schemas.config import Config
from schemas.episode import EpisodeRecord
from schemas.evaluation import ManifestEpisode
from schemas.program import Program
from schemas.relation import RelationRecord
from schemas.scene import SceneRecord
from schemas.snapshot import SnapshotManifest
from schemas.tables import ABOUT, SORT_KEYS, TABLES, description
from schemas.trajectory_tables import TRAJECTORY_ABOUT, TRAJECTORY_SORT_KEYS, TRAJECTORY_TABLES
from schemas.unit import UnitCommit
from schemas.version import SCHEMA_VERSION
from schemas.vlnce import GroundTruth, VlnCeDocument

__all__ = ["DATA_PAGE", "DOCUMENTS", "FOLDER", "data_page", "generated_files", "write"]

FOLDER: Final = Path(__file__).parent / "json"

DATA_PAGE: Final = Path(__file__).parents[1] / "docs" / "data.md"

DOCUMENTS: Final[dict[str, type[BaseModel]]] = {
    "benchmark": BenchmarkFile,
    "benchmark-record": BenchmarkRecord,
    "config": Config,
    "episode": EpisodeRecord,
    "evaluation-manifest": ManifestEpisode,
    "ground-truth": GroundTruth,
    "leaderboard": Leaderboard,
    "program": Program,
    "relation": RelationRecord,
    "scene": SceneRecord,
    "snapshot-manifest": SnapshotManifest,
    "unit": UnitCommit,
    "vlnce": VlnCeDocument,
}
"""The model behind each JSON Schema, by file name."""


def generated_files() -> dict[str, str]:
    """Return the text of every file in ``schemas/json``, by file name."""
    files = {}
    for name, model in DOCUMENTS.items():
        schema = {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "$comment": f"schema version {SCHEMA_VERSION}",
            **model.model_json_schema(),
        }
        files[f"{name}.schema.json"] = _text(schema)
    for kind, (about, keys, schemas) in _KINDS.items():
        tables = {name: _table(schema, about[name], keys[name]) for name, schema in schemas.items()}
        files[f"{kind}.json"] = _text({"schema_version": SCHEMA_VERSION, "tables": tables})
    return files


_Described: TypeAlias = tuple[dict[str, str], dict[str, tuple[str, ...]], dict[str, pa.Schema]]

_KINDS: Final[dict[str, _Described]] = {
    "tables": (ABOUT, SORT_KEYS, TABLES),
    "trajectory-tables": (TRAJECTORY_ABOUT, TRAJECTORY_SORT_KEYS, TRAJECTORY_TABLES),
}
"""Descriptions, sort keys and columns of tables, by the name of their file in ``schemas/json``."""


def _table(schema: pa.Schema, about: str, keys: tuple[str, ...]) -> dict[str, Any]:
    return {
        "description": about,
        "sorted_by": list(keys),
        "columns": [_field(f) for f in schema],
    }


def _field(field: pa.Field) -> dict[str, Any]:
    document = {
        "name": field.name,
        "type": str(field.type),
        "nullable": field.nullable,
        "description": description(field),
    }
    inner = {name: about for name, about in _inner(field.type) if about}
    return document | ({"fields": inner} if inner else {})


def _inner(kind: pa.DataType, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield (dotted path, description) of each field of a struct, or of a list of structs, at every depth."""
    if pa.types.is_list(kind):
        yield from _inner(kind.value_type, path)
    elif pa.types.is_struct(kind):
        for field in kind:
            name = f"{path}.{field.name}" if path else field.name
            yield name, description(field)
            yield from _inner(field.type, name)


def data_page() -> str:
    """Return the text of ``docs/data.md``: every column of every table."""
    parts = [
        "# The tables",
        "Made from the descriptions in `schemas/tables.py` by `python -m schemas.generate`. "
        "`schemas/json/tables.json` has the same for programs.",
        "A snapshot is a folder of Parquet files, `snapshots/<id>/<table>/source=<family>/part-*.parquet`; the family "
        "is the name of the folder, not a column of the files. Coordinates are metres in Habitat's frame: +Y up, "
        "−Z forward, east = +X, north = −Z. Positions are rounded to 1 mm. A struct of coordinates has the fields "
        "`x`, `y`, `z`.",
    ]
    parts += _sections(_KINDS["tables"])
    parts.append(
        "# Tables of trajectories\n\n`condvln trajectories` writes them as one file each, with the family in a last "
        "column `source`; see [training data](training.md). Positions are not rounded: replayed actions give them "
        "again bit for bit. `schemas/json/trajectory-tables.json` has the same for programs."
    )
    parts += _sections(_KINDS["trajectory-tables"])
    return "\n\n".join(parts) + "\n"


def _sections(described: _Described) -> Iterator[str]:
    """Yield a section for each table."""
    abouts, sort_keys, schemas = described
    for name, schema in schemas.items():
        keys = ", ".join(f"`{key}`" for key in sort_keys[name])
        rows = [f"| `{f.name}` | {_type(f.type)} | {'yes' if f.nullable else ''} | {description(f)} |" for f in schema]
        table = "\n".join(["| column | type | may be null | meaning |", "|---|---|---|---|", *rows])
        yield f"## {name}\n\n{abouts[name]} Sorted by {keys}.\n\n{table}"
        inner = [f"| `{f.name}.{path}` | {about} |" for f in schema for path, about in _inner(f.type) if about]
        if inner:
            yield "\n".join(["| inside | meaning |", "|---|---|", *inner])


def _type(kind: pa.DataType) -> str:
    if pa.types.is_list(kind):
        return f"list of {_type(kind.value_type)}"
    return "struct" if pa.types.is_struct(kind) else str(kind)


def _text(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def write(folder: Path = FOLDER) -> None:
    """Write all generated files, and remove those of documents that no longer exist."""
    folder.mkdir(exist_ok=True)
    files = generated_files()
    for old in folder.glob("*.json"):
        if old.name not in files:
            old.unlink()
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    if folder == FOLDER and DATA_PAGE.parent.is_dir():
        DATA_PAGE.write_text(data_page(), encoding="utf-8")


if __name__ == "__main__":
    write()
