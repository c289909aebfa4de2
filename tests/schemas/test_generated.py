"""The generated JSON Schema files are those of the models, and the models refuse what the schemas refuse."""

from __future__ import annotations

import json
import re

import pyarrow as pa
import pytest
from jsonschema import Draft202012Validator

from condvln.explorer.rejected import REASONS
from jobs.query import VIEWS
from schemas.generate import DOCUMENTS, FOLDER, generated_files
from schemas.tables import ABOUT, QUATERNION, SORT_KEYS, TABLES, VEC3, description
from tests.site_parts import part


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


def test_the_data_page_is_up_to_date() -> None:
    page = part("data")
    assert page.FILE.read_text(encoding="utf-8") == page.data_page(), "run: python docs/site/data.py"
    assert page.VIEWS_FILE.read_text(encoding="utf-8") == page.views_page(), "run: python docs/site/data.py"


def test_every_reason_of_rejection_is_explained() -> None:
    page = part("data").VIEWS_FILE.read_text(encoding="utf-8")
    assert {*REASONS} == {"programs", "episodes"}
    for reasons in REASONS.values():
        for name, meaning in reasons.items():
            assert f"| `{name}` | {meaning} |" in page


@pytest.mark.parametrize("name", VIEWS)
def test_every_column_of_a_view_is_described(name: str) -> None:
    columns = part("data").view_columns(name)
    assert columns
    assert [column for column, _, meaning in columns if not meaning] == []
    described = re.findall(r"^-- (\w+): ", VIEWS[name].sql, re.MULTILINE)
    assert {*described} <= {column for column, _, _ in columns}, "a column is described that is not there"


def _undescribed(fields: object, path: str) -> list[str]:
    """Columns and fields below them that nobody described; coordinates speak for themselves."""
    found = []
    for field in fields:  # type: ignore[attr-defined]
        name, kind = f"{path}.{field.name}", field.type
        if not description(field):
            found.append(name)
        while pa.types.is_list(kind):
            kind = kind.value_type
        if pa.types.is_struct(kind) and kind not in (VEC3, QUATERNION) and {f.name for f in kind} != {"x", "z"}:
            found += _undescribed(kind, name)
    return found


@pytest.mark.parametrize("name", sorted(TABLES))
def test_every_column_is_described(name: str) -> None:
    assert name in ABOUT
    assert _undescribed(TABLES[name], name) == []
