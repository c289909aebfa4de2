"""Manifest rows of a made snapshot: every category, and text that is not in the grammar."""

from __future__ import annotations

from typing import Any

from condvln.export.tables import rows_of
from condvln.manifest import manifest_row
from tests.made_snapshot import made_snapshot


def made_manifest(per_category: int = 8, split: str = "test") -> list[dict[str, Any]]:
    """Rows of one scene, as the tables give them."""
    tables = made_snapshot({"replicacad": ["apt_0"]}, per_category).tables["replicacad"]
    instructions = {row["instruction_id"]: row for row in rows_of(tables["instructions"])}
    named = {"source": "replicacad", "split": split, "navmesh": "a.navmesh", "snapshot": "s"}
    return [manifest_row(row, instructions[row["instruction_id"]], **named) for row in rows_of(tables["episodes"])]


def no_rooms() -> dict[str, Any]:
    """The plan of a scene of which nothing is known."""
    return {"rooms": [], "objects": [], "floor": []}
