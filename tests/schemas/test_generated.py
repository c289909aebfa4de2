"""The generated JSON Schema files are those of the models, and the models refuse what the schemas refuse."""

from __future__ import annotations

import json

import pytest
from jsonschema import Draft202012Validator

from schemas.generate import DOCUMENTS, FOLDER, generated_files
from schemas.tables import SORT_KEYS, TABLES


def test_files_are_up_to_date() -> None:
    on_disk = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.json")}
    assert on_disk == generated_files(), "run: python -m schemas.generate"


@pytest.mark.parametrize("name", sorted(DOCUMENTS))
def test_every_schema_is_a_valid_schema_and_closed(name: str) -> None:
    schema = json.loads((FOLDER / f"{name}.schema.json").read_text(encoding="utf-8"))
    Draft202012Validator.check_schema(schema)
    assert schema["additionalProperties"] is False


def test_sort_keys_are_columns() -> None:
    for name, schema in TABLES.items():
        assert set(SORT_KEYS[name]) <= set(schema.names)
