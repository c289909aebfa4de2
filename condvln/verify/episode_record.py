"""Compare a VLN-CE record with the manifest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import PurePosixPath
from typing import Any, Final

from condvln.verify.certificate import Certificate
from condvln.verify.heading import heading_of, yaw_of
from schemas.evaluation import ManifestEpisode

__all__ = ["check_record"]

MISSING: Final = "missing"
"""Marks a missing key, as opposed to a null value."""
_BASIS: Final = ".basis"
"""End of the names of HM3D's meshes with compressed textures, before the last suffix."""
HEADING: Final = 1e-3
"""Tolerance in degrees between a stated heading and its rotation."""


def check_record(row: ManifestEpisode, record: Mapping[str, Any] | None, certificate: Certificate) -> None:
    """Check that the VLN-CE record of an episode agrees with the manifest row of the episode."""
    if record is None:
        certificate.holds("record", False, row.episode_id, "no record")
        return
    gold = row.leaves[row.gold_leaf] if 0 <= row.gold_leaf < len(row.leaves) else row.leaves[0]
    claimed: dict[str, Any] = {
        "episode_id": row.episode_id,
        "trajectory_id": row.episode_id,
        "start_position": list(row.start_position),
        "start_rotation": list(row.start_rotation),
        "goals": [{"position": list(goal), "radius": row.success_distance} for goal in gold.goals],
        "instruction_text": row.instruction_text,
        "reference_path": [list(point) for point in gold.reference_path],
    }
    info: dict[str, Any] = {
        "geodesic_distance": gold.geodesic_distance,
        "route_length": gold.route_length,
        "subgoals": [list(subgoal.position) for subgoal in gold.subgoals],
        "success_distance": row.success_distance,
        "max_steps": row.max_steps,
        "category": row.category,
        "depth": row.depth,
        "chain": row.chain,
        "composition": row.composition,
        "observability": row.observability,
        "evidence_in_view": row.evidence_in_view,
        "observability_approximate": row.observability_approximate,
        "moves": row.moves,
        "words": row.words,
        "instruction_id": row.instruction_id,
        "group_id": row.group_id,
        **({} if row.episode_hash == row.episode_id else {"episode_hash": row.episode_hash}),
        "navmesh_sha256": row.navmesh_sha256,
    }
    instruction, said = record.get("instruction"), record.get("info")
    found = {
        **record,
        "instruction_text": instruction.get("instruction_text") if isinstance(instruction, dict) else None,
    }
    said = said if isinstance(said, dict) else {}
    wrong: list[tuple[str, Any, Any]] = []
    if not (claimed.items() <= found.items() and info.items() <= said.items()):
        wrong = [(name, value, own) for name, value in claimed.items() if value != (own := found.get(name, MISSING))]
        wrong += [
            (f"info.{name}", value, own) for name, value in info.items() if value != (own := said.get(name, MISSING))
        ]
    certificate.held("record", len(claimed) + len(info) - len(wrong))
    for name, manifest, own in wrong:
        certificate.holds("record", False, own, manifest, name)
    certificate.same("record", *_scene_names(str(record.get("scene_id", "")), row.scene_id), "scene_id")
    yaw = yaw_of(row.start_rotation)
    if yaw is not None:
        heading, stated = heading_of(yaw), said.get("start_heading_degrees")
        off = (float(stated) - heading + 180.0) % 360.0 - 180.0 if isinstance(stated, (int, float)) else math.inf
        certificate.holds("record", abs(off) <= HEADING, stated, heading, "info.start_heading_degrees")


@lru_cache(maxsize=64)
def _scene_names(file: str, scene_id: str) -> tuple[str, str]:
    """Return the name of a scene by its file, and by its id."""
    scene, name = PurePosixPath(file), PurePosixPath(scene_id).name
    # HM3D numbers the folder of a scan, and its file has the scan's name alone.
    return scene.parent.name if scene.stem == f"{name.partition('-')[2]}{_BASIS}" else scene.stem, name
