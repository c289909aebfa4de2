"""Episode records: an instruction placed on a navmesh, with the goals and paths of every leaf."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from schemas.base import Document, Finite, Vec3
from schemas.program import Category

__all__ = ["Composition", "EpisodeLeaf", "EpisodeRecord", "Evidence", "Observability", "Subgoal"]

Composition = Literal["C0", "C1", "C2"]
"""C0: one room for everything. C2: condition, then-leaf and else-leaf of some branch are in three rooms. C1: the
rest."""

Observability = Literal["O0", "O1", "O2"]
"""Where the evidence is visible. O0: from the start. O1: on the common prefix of all paths. O2: only after a detour."""


class Evidence(Document):
    """Where the evidence for one condition is visible. Only conditions on the gold route have an entry."""

    condition: int = Field(ge=0)
    observability: Observability
    in_view: bool = Field(
        description="whether the evidence is visible from the start without turning, in a view 90° wide (O0f)"
    )


class Subgoal(Document):
    """A point on the way to the goal, snapped to the navmesh, and the object that it belongs to."""

    object_id: str
    position: Vec3


class EpisodeLeaf(Document):
    """One leaf, placed as if it were gold: object, goal points (nearest to the start first), subgoals and path."""

    leaf: int = Field(ge=0)
    object_id: str
    goals: tuple[Vec3, ...] = Field(min_length=1)
    subgoals: tuple[Subgoal, ...] = ()
    reference_path: tuple[Vec3, ...] = Field(min_length=2)
    geodesic_distance: Finite = Field(
        description="distance from the start to the nearest goal point, metres, as Habitat computes it"
    )
    route_length: Finite = Field(
        description="length of the route from the start through the subgoals to the goal, metres"
    )


class EpisodeRecord(Document):
    """One row of the episodes table; its program is in the instructions table under ``instruction_id``."""

    scene_id: str
    episode_id: int = Field(
        ge=0, lt=2**53, description="integer made from `episode_hash`; stock loaders call int() on it"
    )
    episode_hash: str = Field(description="hash of scene, instruction and start pose")
    instruction_id: str
    group_id: str | None = None
    category: Category
    composition: Composition
    observability: Observability | None = Field(None, description="worst observability of all entries of `evidence`")
    evidence_in_view: bool | None = Field(None, description="whether all evidence is in the first view, 90° wide (O0f)")
    observability_approximate: bool | None = Field(
        None, description="whether visibility was decided with boxes because surfaces are missing"
    )
    evidence: tuple[Evidence, ...] | None = None
    gold_leaf: int = Field(ge=0)
    n_leaves: int = Field(ge=2)
    gold_label: str
    moves: int = Field(ge=1, le=3, description="number of moves of the gold leaf")
    start_position: Vec3
    start_rotation: tuple[Finite, Finite, Finite, Finite] = Field(description="quaternion [x, y, z, w]")
    start_heading_degrees: Finite = Field(ge=0, lt=360, description="compass heading, clockwise from north")
    geodesic_distance: Finite = Field(
        description="distance from the start to the nearest goal point of the gold leaf, metres"
    )
    route_length: Finite = Field(
        description="length of the route from the start through the gold leaf's subgoals to its goal, metres"
    )
    leaves: tuple[EpisodeLeaf, ...] = Field(min_length=2)
    success_distance: Finite
    ground_truth_steps: int = Field(description="number of actions of the longest walk to any leaf, STOP included")
    actions: tuple[int, ...] | None = Field(
        None, description="actions of the walk to the gold leaf: STOP 0, FORWARD 1, LEFT 2, RIGHT 3"
    )
    locations: tuple[Vec3, ...] | None = Field(None, description="the start and the position after each forward step")
    words: int
    max_steps: int
    instruction_text: str
    navmesh_sha256: str
