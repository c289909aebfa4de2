"""Rows of ``manifest/<split>.jsonl``: the whole truth about each episode, for evaluators and never for agents."""

from __future__ import annotations

from typing import Any

from condvln.export.rows import Row
from schemas.version import SCHEMA_VERSION

__all__ = ["manifest_row"]


def manifest_row(
    episode: Row, instruction: Row, *, source: str, split: str, navmesh: str, snapshot: str
) -> dict[str, Any]:
    """A :class:`schemas.evaluation.ManifestEpisode` as a plain dictionary."""
    return {
        "schema_version": SCHEMA_VERSION,
        "episode_id": episode["episode_id"],
        "instruction_id": episode["instruction_id"],
        "group_id": episode["group_id"],
        "source": source,
        "scene_id": episode["scene_id"],
        "split": split,
        "category": episode["category"],
        "depth": instruction["depth"],
        "chain": instruction["chain"],
        "composition": episode["composition"],
        "observability": episode["observability"],
        "evidence_in_view": episode["evidence_in_view"],
        "observability_approximate": episode["observability_approximate"],
        "evidence": episode["evidence"],
        "moves": episode["moves"],
        "words": episode["words"],
        "instruction_text": episode["instruction_text"],
        "program": {
            "category": instruction["category"],
            "conditions": instruction["conditions"],
            "branches": instruction["branches"],
            "leaves": instruction["leaves"],
        },
        "gold_leaf": episode["gold_leaf"],
        "start_position": episode["start_position"],
        "start_rotation": episode["start_rotation"],
        "leaves": episode["leaves"],
        "success_distance": episode["success_distance"],
        "max_steps": episode["max_steps"],
        "geodesic_distance": episode["geodesic_distance"],
        "route_length": episode["route_length"],
        "navmesh": navmesh,
        "navmesh_sha256": episode["navmesh_sha256"],
        "snapshot": snapshot,
    }
