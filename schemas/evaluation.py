"""The evaluation manifest: one JSON line per episode, with what an evaluator needs and an agent must not see."""

from __future__ import annotations

from pydantic import Field

from schemas.base import Finite, Vec3, VersionedDocument
from schemas.episode import Composition, EpisodeLeaf, Evidence, Observability
from schemas.program import Category, Program

__all__ = ["ManifestEpisode"]


class ManifestEpisode(VersionedDocument):
    """One row of ``manifest/<split>.jsonl``."""

    episode_id: int = Field(strict=True)
    """an integer below 2^53, made from `episode_hash`"""
    episode_hash: str
    """hash of scene, instruction and start pose"""
    instruction_id: str
    group_id: str | None = None
    source: str
    scene_id: str
    split: str
    category: Category
    depth: int
    chain: int
    composition: Composition
    oddness: int | None = None
    """how little the parts of the instruction have to do with each other, see `sampling.most_odd`"""
    observability: Observability | None = None
    evidence_in_view: bool | None = None
    observability_approximate: bool | None = None
    evidence: tuple[Evidence, ...] | None = None
    moves: int
    """number of moves of the gold leaf"""
    leads: int = 0
    """number of leads on the way to it"""
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
    looking_path: tuple[Vec3, ...] | None = None
    """corners of the looking path, the shortest walk found that sees the evidence of each condition before it acts on
    it; null, as all fields of the looking path, where the format has no headings"""
    looking_length: Finite | None = None
    """length of the looking path, metres"""
    looking_actions: tuple[int, ...] | None = None
    """actions of the walk along the looking path: 0 STOP, 1 forward 0.25 m, 2 left 15°, 3 right 15°"""
    looking_decided: tuple[int, ...] | None = None
    """for each condition on the gold route, in order of evaluation, the number of actions after which it is decided"""
    navmesh: str
    """path of the navmesh, as the export or the source ships it"""
    navmesh_sha256: str
    snapshot: str
