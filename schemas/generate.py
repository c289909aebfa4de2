"""JSON Schema files of every document and a plain description of every table: ``python -m schemas.generate``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
from pydantic import BaseModel

from schemas.config import Config
from schemas.episode import EpisodeRecord
from schemas.evaluation import ManifestEpisode
from schemas.program import Program
from schemas.relation import RelationRecord
from schemas.scene import SceneRecord
from schemas.snapshot import SnapshotManifest
from schemas.tables import SORT_KEYS, TABLES
from schemas.unit import UnitCommit
from schemas.version import SCHEMA_VERSION
from schemas.vlnce import GroundTruth, VlnCeDocument

__all__ = ["DOCUMENTS", "FOLDER", "generated_files", "write"]

FOLDER: Final = Path(__file__).parent / "json"

DOCUMENTS: Final[dict[str, type[BaseModel]]] = {
    "config": Config,
    "episode": EpisodeRecord,
    "evaluation-manifest": ManifestEpisode,
    "ground-truth": GroundTruth,
    "program": Program,
    "relation": RelationRecord,
    "scene": SceneRecord,
    "snapshot-manifest": SnapshotManifest,
    "unit": UnitCommit,
    "vlnce": VlnCeDocument,
}
"""Name of the file → its model."""


def generated_files() -> dict[str, str]:
    """File name → text, as they must stand in ``schemas/json``."""
    files = {}
    for name, model in DOCUMENTS.items():
        schema = {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "$comment": f"schema version {SCHEMA_VERSION}",
            **model.model_json_schema(),
        }
        files[f"{name}.schema.json"] = _text(schema)
    files["tables.json"] = _text({"schema_version": SCHEMA_VERSION, "tables": {k: _table(k) for k in TABLES}})
    return files


def _table(name: str) -> dict[str, Any]:
    return {"sorted_by": list(SORT_KEYS[name]), "columns": [_field(f) for f in TABLES[name]]}


def _field(field: pa.Field) -> dict[str, Any]:
    return {"name": field.name, "type": str(field.type), "nullable": field.nullable}


def _text(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def write(folder: Path = FOLDER) -> None:
    """Write all generated files, removing those of documents that are gone."""
    folder.mkdir(exist_ok=True)
    files = generated_files()
    for old in folder.glob("*.json"):
        if old.name not in files:
            old.unlink()
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write()
