"""The evaluation manifest: one JSON line per episode, with what an evaluator needs and an agent must not see."""

from __future__ import annotations

from pydantic import Field, model_validator

from schemas.base import Finite, Vec3, VersionedDocument
from schemas.episode import Composition, EpisodeLeaf, Evidence, Observability
from schemas.program import Category, Program

__all__ = ["ManifestEpisode"]


class ManifestEpisode(VersionedDocument):
    """One row of ``manifest/<split>.jsonl``."""

    episode_id: int | str = Field(description="an integer below 2^53; in exports of former releases the episode's hash")
    episode_hash: str = Field(
        "", description="hash of scene, instruction and start pose; empty where this hash is the episode id"
    )
    instruction_id: str
    group_id: str | None = None
    source: str
    scene_id: str
    split: str
    category: Category
    depth: int
    chain: int
    composition: Composition
    observability: Observability | None = None
    evidence_in_view: bool | None = None
    observability_approximate: bool | None = None
    evidence: tuple[Evidence, ...] | None = None
    moves: int = Field(description="number of moves of the gold leaf")
    words: int
    instruction_text: str
    program: Program
    gold_leaf: int
    start_position: Vec3
    start_rotation: tuple[Finite, Finite, Finite, Finite]
    leaves: tuple[EpisodeLeaf, ...]
    success_distance: Finite
    max_steps: int
    geodesic_distance: Finite
    route_length: Finite
    navmesh: str = Field(description="path of the navmesh, as the export or the source ships it")
    navmesh_sha256: str
    snapshot: str

    @model_validator(mode="after")
    def _with_hash(self) -> ManifestEpisode:
        if not self.episode_hash:
            self.episode_hash = str(self.episode_id)
        return self
