"""Write the JSON Schema of every document and the description of every table: ``python -m schemas.generate``.

The tables are described for programs in ``schemas/json/tables.json``; for people ``docs/site/data.py`` does it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
from pydantic import BaseModel

from schemas.base import SCHEMA_VERSION
from schemas.benchmark import BenchmarkPack, Leaderboard
from schemas.config import Config
from schemas.evaluation import ManifestEpisode
from schemas.program import Program
from schemas.snapshot import SnapshotManifest
from schemas.tables import ABOUT, SORT_KEYS, TABLES, TRAJECTORY_TABLES, description
from schemas.unit import UnitCommit
from schemas.vlnce import GroundTruth, VlnCeDocument

__all__ = ["DOCUMENTS", "FOLDER", "generated_files", "inner_fields", "write"]

FOLDER: Final = Path(__file__).parent / "json"

DOCUMENTS: Final[dict[str, type[BaseModel]]] = {
    "benchmark-pack": BenchmarkPack,
    "config": Config,
    "evaluation-manifest": ManifestEpisode,
    "ground-truth": GroundTruth,
    "leaderboard": Leaderboard,
    "program": Program,
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
            **_on_one_line(model.model_json_schema()),
        }
        files[f"{name}.schema.json"] = _text(schema)
    for kind, schemas in (("tables", TABLES), ("trajectory-tables", TRAJECTORY_TABLES)):
        tables = {name: _table(name, schema) for name, schema in schemas.items()}
        files[f"{kind}.json"] = _text({"schema_version": SCHEMA_VERSION, "tables": tables})
    return files


def _on_one_line(document: Any) -> Any:
    """Return a JSON Schema whose descriptions of fields, which are docstrings, have no line breaks."""
    if isinstance(document, list):
        return [_on_one_line(item) for item in document]
    if not isinstance(document, dict):
        return document
    found = {name: _on_one_line(value) for name, value in document.items()}
    if isinstance(found.get("description"), str):
        found["description"] = " ".join(found["description"].split())
    return found


def _table(name: str, schema: pa.Schema) -> dict[str, Any]:
    return {"description": ABOUT[name], "sorted_by": list(SORT_KEYS[name]), "columns": [_field(f) for f in schema]}


def _field(field: pa.Field) -> dict[str, Any]:
    document = {
        "name": field.name,
        "type": str(field.type),
        "nullable": field.nullable,
        "description": description(field),
    }
    inner = {name: about for name, about in inner_fields(field.type) if about}
    return document | ({"fields": inner} if inner else {})


def inner_fields(kind: pa.DataType, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield (dotted path, description) of each field of a struct, or of a list of structs, at every depth."""
    if pa.types.is_list(kind):
        yield from inner_fields(kind.value_type, path)
    elif pa.types.is_struct(kind):
        for field in kind:
            name = f"{path}.{field.name}" if path else field.name
            yield name, description(field)
            yield from inner_fields(field.type, name)


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


if __name__ == "__main__":
    write()
