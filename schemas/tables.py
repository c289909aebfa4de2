"""Arrow schemas of the nine published tables, of tables in exports and of those of ``condvln trajectories``, read from
``tables.yaml``.

Every column carries its description, from which ``docs/data.md`` is made. Every nested value is a typed struct, so that
DuckDB, Polars and pyarrow read them unaided. Positions of published tables are rounded to 1 mm; those of trajectories
are not, since replayed actions give them again bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import yaml

__all__ = [
    "ABOUT",
    "EPISODES",
    "EXPORT_TABLES",
    "FUNNEL",
    "INSTRUCTIONS",
    "LEFT_OUT",
    "OBJECTS",
    "POSES",
    "QUATERNION",
    "REJECTIONS",
    "RELATIONS",
    "ROOMS",
    "SCENES",
    "SORT_KEYS",
    "STEPS",
    "TABLES",
    "TRAJECTORIES",
    "TRAJECTORY_TABLES",
    "VEC3",
    "VISIBILITY",
    "description",
]

_DOCUMENT: Final[dict[str, Any]] = yaml.load(
    Path(__file__).with_suffix(".yaml").read_bytes(), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)
)
_STRUCTS: Final[dict[str, pa.DataType]] = {}


def _type(name: str) -> pa.DataType:
    if name.startswith("list of "):
        return pa.list_(_type(name.removeprefix("list of ")))
    return _STRUCTS.get(name) or pa.type_for_alias(name)


def _fields(columns: Mapping[str, Sequence[str]]) -> list[pa.Field]:
    return [
        pa.field(
            name,
            _type(kind.removesuffix("!")),
            nullable=not kind.endswith("!"),
            metadata={"description": about[0]} if about else None,
        )
        for name, (kind, *about) in columns.items()
    ]


def _schemas(kind: str) -> dict[str, pa.Schema]:
    return {name: pa.schema(_fields(table["columns"])) for name, table in _DOCUMENT[kind].items()}


def description(field: pa.Field) -> str:
    """Return the description of a column or of a struct's field; empty if there is none."""
    about: bytes = (field.metadata or {}).get(b"description", b"")
    return about.decode()


for _name, _inside in _DOCUMENT["structs"].items():
    _STRUCTS[_name] = pa.struct(_fields(_inside))

VEC3: Final = _STRUCTS["vec3"]
QUATERNION: Final = _STRUCTS["quaternion"]

TABLES: Final = _schemas("tables")
"""The published tables, by name."""

SCENES: Final = TABLES["scenes"]
ROOMS: Final = TABLES["rooms"]
OBJECTS: Final = TABLES["objects"]
RELATIONS: Final = TABLES["relations"]
VISIBILITY: Final = TABLES["visibility"]
INSTRUCTIONS: Final = TABLES["instructions"]
EPISODES: Final = TABLES["episodes"]
REJECTIONS: Final = TABLES["rejections"]
FUNNEL: Final = TABLES["funnel"]

EXPORT_TABLES: Final = _schemas("export_tables")
"""Tables beside the manifests of an export, by name."""

TRAJECTORY_TABLES: Final = _schemas("trajectory_tables")
"""The tables of ``condvln trajectories``, by name."""

STEPS: Final = TRAJECTORY_TABLES.pop("steps")
"""Poses of the walks without cameras; kept in the unit and not published."""

TRAJECTORIES: Final = TRAJECTORY_TABLES["trajectories"]
POSES: Final = TRAJECTORY_TABLES["poses"]
LEFT_OUT: Final = TRAJECTORY_TABLES["left_out"]

_KINDS: Final = ("tables", "export_tables", "trajectory_tables")

ABOUT: Final[dict[str, str]] = {name: table["about"] for kind in _KINDS for name, table in _DOCUMENT[kind].items()}
"""Description of the rows of each table."""

SORT_KEYS: Final[dict[str, tuple[str, ...]]] = {
    name: tuple(table["sorted_by"]) for kind in _KINDS for name, table in _DOCUMENT[kind].items()
}
"""Columns that order the rows of each table; together they are unique."""
