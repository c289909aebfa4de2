"""The navmeshes that a run built, as the units of what is published keep them."""

from __future__ import annotations

from condvln.export.rows import Row
from condvln.export.scene_table import NavmeshBytes
from factory.snapshot import Snapshot
from jobs.pipeline import build_pipeline
from schemas.config import Config

__all__ = ["built_navmeshes"]


def built_navmeshes(config: Config, snapshot: Snapshot) -> NavmeshBytes:
    """The navmeshes that the units of a snapshot were built with, by source and row of the scenes table.

    Asking for one raises ``CorruptShardError`` where the unit's file is missing or damaged: leaving its scene out would
    shrink an export silently.
    """
    pipeline = build_pipeline(config)

    def navmesh(source: str, row: Row) -> bytes | None:
        if not row["navmesh_built"]:
            return None
        kept = snapshot.unit_table(f"{source}/{row['scene_id']}", pipeline, "navmeshes")
        return kept["data"][0].as_py() if kept.num_rows else None

    return navmesh
